"""What every trial database has to do with numbers, transactions and events, on every engine."""

from __future__ import annotations

import math
import threading

import pytest
from store_study import DONE, kinds

from services.errors import NameTaken, Refused
from services.states import TrialState
from services.store.open import open_store
from services.store.port import Result


class TestNumbersThatAreNone:
    @pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
    def test_a_result_that_is_no_number_is_an_error_that_says_so(self, study, bad):
        _, attempt = study.running()
        for result, what in (
            (Result(TrialState.COMPLETE, value=bad), "result.value"),
            (Result(TrialState.COMPLETE, features=(0.0, bad)), "result.features"),
            (Result(TrialState.COMPLETE, details={"bar": bad}), "result.details"),
            (Result(TrialState.COMPLETE, seconds=bad), "result.seconds"),
        ):
            with pytest.raises(ValueError, match=rf"{what}.*expected .*finite"):
                study.finish(attempt, result)
        with pytest.raises(ValueError, match="metrics of iteration 1: expected numbers that are finite"):
            study.do("report", attempt.id, attempt.token, iteration=1, metrics={"r": bad}, samples=1, seconds=1.0)
        assert study.trial(0).state is TrialState.RUNNING
        assert study.store.metrics(study.trial(0).id) == []
        assert study.finish(attempt).state is TrialState.COMPLETE

    def test_text_that_a_broken_program_printed_is_kept_readably(self, study):
        _, attempt = study.running()
        final = study.finish(attempt, Result(TrialState.FAILED, message="core\0dump \udc80"))
        assert final.message == "core\\0dump \\udc80"


class TestTransactions:
    def test_an_exception_undoes_all(self, store, study):
        before = store.last_event(), store.study("jump")

        def write_and_break():
            with store.transaction() as change:
                change.create_study("other", {}, seed=1)
                change.ask("jump", "pause")
                raise KeyError

        with pytest.raises(KeyError):
            write_and_break()
        assert (store.last_event(), store.study("jump")) == before
        assert len(store.studies()) == 1

    def test_a_refused_transition_leaves_the_rest_of_the_transaction_standing(self, store, study):
        trials = study.propose(2)
        first, second = (study.start(trial) for trial in trials)
        study.do("lose", first.id, first.token, "gone")
        with store.transaction() as change:
            with pytest.raises(Refused):
                change.finish(first.id, first.token, DONE)
            change.note("refused", study_id=study.id, trial=0, what="a late result")
            change.finish(second.id, second.token, DONE)
        assert study.trial(0).state is TrialState.QUEUED
        assert study.trial(1).state is TrialState.COMPLETE
        assert [(event.kind, event.trial, event.payload) for event in store.events()[-2:-1]] == [
            ("refused", 0, {"what": "a late result"})
        ]

    def test_a_taken_name_leaves_the_rest_of_the_transaction_standing(self, store, study):
        with store.transaction() as change:
            with pytest.raises(NameTaken):
                change.create_study("jump", {}, seed=1)
            change.create_study("other", {}, seed=1)
        assert {row.name for row in store.studies()} == {"jump", "other"}

    def test_nothing_is_seen_before_the_commit(self, store):
        with store.transaction() as change:
            change.create_study("jump", {}, seed=1)
            assert store.studies() == []
            assert store.last_event() == 0
        assert len(store.studies()) == 1

    def test_a_transaction_within_one_is_an_error_and_no_deadlock(self, store):
        with store.transaction(), pytest.raises(RuntimeError, match="expected no open transaction in this thread"):
            store.transaction().__enter__()

    def test_a_change_is_of_no_use_after_its_transaction(self, store):
        with store.transaction() as change:
            change.create_study("jump", {}, seed=1)
        with pytest.raises(RuntimeError, match="this transaction has ended"):
            change.ask("jump", "pause")

    def test_writers_wait_for_each_other_and_lose_nothing(self, store, database):
        """Two stores, as two processes have them, and two threads on each."""
        other = open_store(database)
        failures = []

        def write(to, name):
            try:
                for i in range(10):
                    with to.transaction() as change:
                        change.create_study(f"{name}-{i}", {}, seed=i)
            except Exception as error:  # noqa: BLE001 - carried to the assertion below
                failures.append(error)

        threads = [threading.Thread(target=write, args=(to, f"{i}")) for i, to in enumerate([store, other] * 2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        other.close()
        assert failures == []
        assert len(store.studies()) == 40


class TestEvents:
    def test_a_cursor_sees_every_event_once_and_in_order(self, store, study):
        study.finish(study.running()[1])
        events = store.events()
        assert [event.kind for event in events] == ["created", "driven", "proposed", "started", "finished"]
        assert [event.id for event in events] == sorted({event.id for event in events})
        assert store.last_event() == events[-1].id
        assert store.events(after=events[1].id, limit=2) == events[2:4]
        assert store.events(after=events[-1].id) == []

    def test_events_of_one_study(self, store, study):
        study.do("create_study", "other", {}, seed=1)
        study.do("note", "warning", text="of nobody")
        assert kinds(store, study_id=study.id) == ["created", "driven"]
        nobody = store.events()[-1]
        assert (nobody.study_id, nobody.study, nobody.trial, nobody.payload) == (
            None,
            None,
            None,
            {"text": "of nobody"},
        )

    def test_a_cursor_skips_nothing_while_many_write(self, store, database):
        writers = [open_store(database) for _ in range(4)]

        def write(to):
            for i in range(25):
                with to.transaction() as change:
                    for _ in range(i % 3 + 1):
                        change.note("warning")

        threads = [threading.Thread(target=write, args=(to,)) for to in writers]
        for thread in threads:
            thread.start()
        seen = []
        while any(thread.is_alive() for thread in threads):
            seen += [event.id for event in store.events(after=seen[-1] if seen else 0)]
        seen += [event.id for event in store.events(after=seen[-1] if seen else 0)]
        for to in writers:
            to.close()
        assert seen == [event.id for event in store.events()]
        assert len(seen) == 4 * (8 * 6 + 1)

    def test_the_history_keeps_its_identity_over_reopening(self, store, database):
        again = open_store(database)
        assert again.history_id() == store.history_id()
        assert len(store.history_id()) == 32
        again.close()

    def test_the_history_of_another_database_is_another_one(self, store, tmp_path):
        other = open_store(tmp_path / "other.db")
        assert other.history_id() != store.history_id()
        other.close()
