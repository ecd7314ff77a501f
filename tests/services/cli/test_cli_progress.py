"""Progress is read from the trial database; its figures are those of the rows."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from services.admission import admit
from services.cli.progress import Observer, picture, progress_line, running_line
from services.driver import this_process
from services.spec_check import parse_study
from services.states import TrialState
from services.store.open import open_store
from services.store.port import NewTrial, Result


@pytest.fixture
def store(tmp_path):
    opened = open_store(tmp_path / "halma.db")
    yield opened
    opened.close()


@pytest.fixture
def running(store, hill):
    """A driven study with two running trials, and their attempts."""
    row = admit(store, parse_study(hill, name="hill.yaml"))
    with store.transaction() as change:
        token = change.drive("hill", this_process())
        trials = change.propose(
            row.id, token, strategy="random", history=0, pending=[], rng_key=[1], seconds=0.0,
            trials=[NewTrial({"x": 0.1 + 0.5 * n}, seed=n) for n in range(2)],
        )  # fmt: skip
        return [change.start(trial.id, token, worker="w") for trial in trials]


def report(store, attempt, iteration, samples, seconds):
    with store.transaction() as change:
        change.report(
            attempt.id, attempt.token, iteration=iteration, metrics={"level": 0.3 + 0.01 * iteration},
            samples=samples, seconds=seconds,
        )  # fmt: skip


def finish(store, attempt, place):
    result = Result(TrialState.COMPLETE, value=place, features=(place,), samples=1000, seconds=20.0)
    with store.transaction() as change:
        change.finish(attempt.id, attempt.token, result)


def test_figures_follow_the_rows(store, running):
    observer = Observer(store, "hill")
    first = observer.look(0.0)
    assert (first.done, first.distinct, first.rate, first.left) == (0, 0, None, None)
    assert progress_line(first) == "0 of 4 trials, 0 distinct strategies, 0 samples"
    assert [running_line(*each) for each in first.running] == ["trial 0: starting", "trial 1: starting"]

    report(store, running[0], 1, 700, 5.0)
    second = observer.look(10.0)
    assert second.rate == pytest.approx(70.0)
    assert running_line(*second.running[0]) == "trial 0: iteration 1, 700 samples, level 0.31"

    finish(store, running[0], 0.9)
    report(store, running[1], 4, 500, 8.0)
    third = observer.look(20.0)
    assert third.done == 1
    assert third.distinct == 1
    # 1,500 samples in 20 s; three trials of 20 s to go, of which one has run for 8 s, one at a time.
    assert third.rate == pytest.approx(75.0)
    assert third.left == pytest.approx(52.0)
    assert progress_line(third) == (
        "1 of 4 trials, best 0.9, 1 distinct strategy, 1,500 samples (75/s), about 52 s left"
    )

    finish(store, running[1], 0.2)
    assert observer.look(30.0).distinct == 2


def test_the_rate_forgets_what_is_long_ago(store, running):
    observer = Observer(store, "hill")
    for at, samples in ((0.0, 0), (10.0, 6000), (50.0, 6100), (80.0, 6400)):
        if samples:
            report(store, running[0], int(at) + 1, samples, at)
        last = observer.look(at)
    assert last.rate == pytest.approx(10.0)


def test_a_study_that_waits_says_why(store, running):
    row = store.study("hill")
    with store.transaction() as change:
        change.remark(row.id, row.drive_token, "No space left on device")
    snapshot = Observer(store, "hill").look(0.0)
    assert progress_line(snapshot).endswith(", No space left on device")
    console = Console(width=80, file=io.StringIO())
    console.print(picture(snapshot))
    assert "No space left on device" in console.file.getvalue()


def test_the_picture_in_a_terminal_has_a_bar_and_a_line_for_each_running_trial(store, running):
    finish(store, running[0], 0.9)
    console = Console(width=120, force_terminal=True, color_system=None, file=io.StringIO())
    console.print(picture(Observer(store, "hill").look(0.0)))
    lines = console.file.getvalue().splitlines()
    assert lines[0].startswith("━" * 30 + "  1 of 4 trials")
    assert lines[1] == "best 0.9, 1 distinct strategy, 1,000 samples"
    assert lines[2] == "  trial 1: starting"
