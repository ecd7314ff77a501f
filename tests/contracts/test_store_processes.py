"""Processes that share a database, and that are killed while they write to it."""

from __future__ import annotations

import subprocess
import sys
import textwrap
import time

import psycopg
import pytest

from services.errors import DatabaseUnavailable
from services.states import AttemptState, TrialState
from services.store.open import open_store
from services.store.port import Driver, NewTrial, Result

OPEN = """
import sys
from services.errors import HalmaError
from services.states import TrialState
from services.store.open import open_store
from services.store.port import Driver, NewTrial, Result
store = open_store(sys.argv[1])
"""


def child(body, *arguments):
    """Another Python process with an open store, told things on stdin and heard on stdout."""
    program = OPEN + textwrap.dedent(body)
    return subprocess.Popen(
        [sys.executable, "-c", program, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def end(process):
    process.kill()
    process.wait()
    process.stdin.close()
    process.stdout.close()


def driven(store, name="jump"):
    with store.transaction() as change:
        study = change.create_study(name, {}, seed=1)
        return study.id, change.drive(name, Driver("parent", "here", 1))


def test_a_fenced_writer_in_another_process_is_refused(store, database):
    study_id, token = driven(store)
    writer = child(
        """
        study_id, token = int(sys.argv[2]), int(sys.argv[3])
        with store.transaction() as change:
            (trial,) = change.propose(study_id, token, strategy="s", history=0, pending=[], rng_key=[], seconds=0.0,
                                      trials=[NewTrial({}, seed=1)])
            attempt = change.start(trial.id, token, worker="child")
            change.report(attempt.id, attempt.token, iteration=1, metrics={"r": 1.0}, samples=10, seconds=1.0)
        print("started", flush=True)
        sys.stdin.readline()
        for transition, arguments in (
            ("finish", (attempt.id, attempt.token, Result(TrialState.COMPLETE, value=666.0))),
            ("beat", (attempt.id, attempt.token)),
            ("start", (trial.id, token)),
            ("beat_drive", (study_id, token)),
        ):
            try:
                with store.transaction() as change:
                    extra = {"worker": "child"} if transition == "start" else {}
                    getattr(change, transition)(*arguments, **extra)
                print("accepted", flush=True)
            except HalmaError as error:
                print(type(error).__name__, flush=True)
        """,
        database,
        study_id,
        token,
    )
    try:
        assert writer.stdout.readline() == "started\n"
        with store.transaction() as change:
            new = change.drive("jump", Driver("successor", "there", 2), take_over_from=token)
            trial = store.trial(study_id, 0)
            attempt = change.start(trial.id, new, worker="mine")
        writer.stdin.write("go on\n")
        writer.stdin.flush()
        assert [writer.stdout.readline() for _ in range(4)] == ["Refused\n"] * 4
    finally:
        end(writer)
    with store.transaction() as change:
        final = change.finish(attempt.id, attempt.token, Result(TrialState.COMPLETE, value=1.0))
    assert (final.value, final.position, final.attempts) == (1.0, 0, 2)
    assert [row.state for row in store.attempts(trial.id)] == [AttemptState.LOST, AttemptState.COMPLETE]


def test_every_commit_acknowledged_before_a_kill_is_there_after(store, database):
    """kill -9 in the middle of a loop of commits, several times over; what was told is kept, the rest is whole."""
    study_id, token = driven(store)
    told = []
    for round_ in range(3):
        writer = child(
            """
            study_id, token = int(sys.argv[2]), int(sys.argv[3])
            while True:
                with store.transaction() as change:
                    trials = change.propose(study_id, token, strategy="s", history=0, pending=[], rng_key=[],
                                            seconds=0.0, trials=[NewTrial({}, seed=i) for i in range(2)])
                    for trial in trials:
                        attempt = change.start(trial.id, token, worker="child")
                        final = change.finish(
                            attempt.id, attempt.token,
                            Result(TrialState.COMPLETE, value=float(trial.number), samples=1),
                        )
                print(final.number, flush=True)
            """,
            database,
            study_id,
            token,
        )
        try:
            told += [int(writer.stdout.readline()) for _ in range(10)]
            time.sleep(0.01 * round_)  # not always at the same place of the loop
            writer.kill()
            told += [int(line) for line in writer.stdout.read().splitlines(keepends=True) if line.endswith("\n")]
        finally:
            end(writer)
    again = open_store(database)
    rows = again.trials(study_id)
    assert len(told) >= 30
    assert set(told) <= {row.number for row in rows}
    # Two trials a commit: neither is ever there without the other, nor without its end.
    assert len(rows) % 2 == 0
    assert [row.number for row in rows] == [row.position for row in rows] == list(range(len(rows)))
    assert all(row.state is TrialState.COMPLETE and row.value == row.number for row in rows)
    assert again.study("jump").samples == len(rows)
    # At most one commit a round was made and not told any more.
    assert len(rows) / 2 - len(told) <= 3
    again.close()


def test_a_killed_writer_does_not_block_the_next_one(store, database):
    study_id, token = driven(store)
    writer = child(
        """
        with store.transaction() as change:
            change.note("warning")
            change.beat_drive(int(sys.argv[2]), int(sys.argv[3]))
            print("holding", flush=True)
            sys.stdin.readline()
        """,
        database,
        study_id,
        token,
    )
    try:
        assert writer.stdout.readline() == "holding\n"
        before = store.study("jump").drive_beat
    finally:
        end(writer)
    with store.transaction() as change:
        change.beat_drive(study_id, token)
    assert store.study("jump").drive_beat == before + 1


@pytest.mark.postgres
def test_a_server_that_was_away_is_told_and_used_again_when_it_is_back(postgres_server):
    url = postgres_server.new_database("away")
    store = open_store(url)
    study_id, token = driven(store)
    postgres_server.stop()
    try:
        with pytest.raises(DatabaseUnavailable, match="expected a PostgreSQL server that lets us in, found: "):
            store.studies()
        with pytest.raises(DatabaseUnavailable, match="check that it runs"), store.transaction() as change:
            change.beat_drive(study_id, token)
    finally:
        postgres_server.start()
    assert store.study("jump").id == study_id
    with store.transaction() as change:
        change.beat_drive(study_id, token)
    store.close()


@pytest.mark.postgres
def test_a_connection_cut_in_the_middle_of_a_transaction_undoes_it(postgres_server):
    url = postgres_server.new_database("cut")
    store = open_store(url)
    study_id, token = driven(store)
    before = store.last_event()

    def cut_in_the_middle():
        with store.transaction() as change:
            change.propose(
                study_id, token, strategy="s", history=0, pending=[], rng_key=[], seconds=0.0,
                trials=[NewTrial({}, seed=0)],
            )  # fmt: skip
            with psycopg.connect(postgres_server.url("postgres"), autocommit=True) as admin:
                admin.execute("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = 'cut'")
            change.beat_drive(study_id, token)

    with pytest.raises(DatabaseUnavailable):
        cut_in_the_middle()
    assert store.last_event() == before
    assert store.trials(study_id) == []
    store.close()
