"""How studies are doing, as the list of them shows it."""

from __future__ import annotations

from datetime import UTC, datetime
from types import SimpleNamespace

import pytest

from services.api.distinct import Distinct
from services.api.pulse import POINTS, pace, spark
from services.api.tables import FinishedTrials
from services.report import distinct_trials
from services.states import StudyState, TrialState
from tests.record import Record


def trial(value=1.0, *, state=TrialState.COMPLETE, started=0, finished=10, samples=100, z=None):
    moment = datetime.fromtimestamp
    return SimpleNamespace(
        value=value,
        state=state,
        samples=samples,
        z=z,
        started_at=moment(started, UTC),
        finished_at=moment(finished, UTC),
    )


def test_the_course_is_the_best_so_far_and_failures_are_no_part_of_it():
    history = [trial(0.5), trial(None, state=TrialState.FAILED), trial(0.3), trial(0.9), trial(0.8)]
    assert spark(history) == [0.5, 0.5, 0.9, 0.9]


def test_values_of_easier_versions_are_no_part_of_the_course():
    assert spark([trial(0.5, z=1.0), trial(0.9, z=0.2), trial(0.6, z=1.0)]) == [0.5, 0.6]


def test_a_long_course_keeps_its_ends():
    found = spark([trial(float(i)) for i in range(1000)])
    assert (len(found), found[0], found[-1]) == (POINTS, 0.0, 999.0)


def test_rate_and_time_left_by_hand():
    """Four trials of 100 samples in 40 s: 10 samples/s; six are missing, at 10 s each."""
    history = [trial(started=10 * i, finished=10 * i + 10) for i in range(4)]
    study = SimpleNamespace(state=StudyState.RUNNING, target_trials=10, target_cost=None, samples=400, spec={})
    assert pace(study, history, now=40.0) == pytest.approx((10.0, 60.0))


def test_the_nearer_end_counts_and_a_study_that_waits_has_none():
    history = [trial(started=10 * i, finished=10 * i + 10) for i in range(4)]
    study = SimpleNamespace(state=StudyState.RUNNING, target_trials=10, target_cost=500, samples=400, spec={})
    assert pace(study, history, now=40.0) == pytest.approx((10.0, 10.0))
    study.state = StudyState.PAUSED
    assert pace(study, history, now=40.0) == (None, None)


def test_several_studies_in_one_request(client, store, artifacts, record):
    record.one(value=0.5, features=(0.0,))
    record.one(value=0.75, features=(2.0,))
    record.one(value=0.6, features=(2.1,))
    Record(store, artifacts, "quality", behaviour=None).begin().one(value=0.25)
    found = client.get("/api/v1/pulse", params={"study": ["jump", "quality", "unknown", "jump"]}).json()["pulses"]
    assert [(one["study"], one["best"], one["distinct"]) for one in found] == [
        ("jump", [0.5, 0.75, 0.75], 2),
        ("quality", [0.25], None),
    ]
    record.one(value=0.9, features=(-2.0,))
    (again,) = client.get("/api/v1/pulse", params={"study": "jump"}).json()["pulses"]
    assert (again["best"][-1], again["distinct"]) == (0.9, 3)


def test_strategies_that_grow_trial_by_trial_are_those_of_all_trials(store, record):
    """In every step the same as grouping all of them: joining one, leading one, refused by the audit, failed."""
    distinct, trials = Distinct(store), FinishedTrials(store)
    angles = [0.0, 0.1, 3.0, 2.9, -3.1, 0.3, 1.5, 0.45, 0.2]
    values = [0.5, 0.4, 0.3, 0.6, 0.1, 0.9, 0.2, 0.8, None]
    for angle, value in zip(angles, values, strict=True):
        if value is None:
            record.one(iterations=1, files=(), state=TrialState.FAILED, message="broke")
        else:
            record.one(iterations=1, files=(), value=value, features=(angle,))
        study = store.study("jump")
        history = trials.history(study)
        assert distinct.of(study, history) == distinct_trials(study, history)
    assert [finding.trial.value for finding in distinct.of(study, history)] == [0.9, 0.6, 0.2]
    # Somebody who read the record a moment earlier gets what was true of it.
    assert distinct.of(study, history[:2]) == distinct_trials(study, history[:2])


def test_strategies_of_equal_value_have_one_order_on_the_page_and_in_the_terminal(client, store, record):
    for angle in (2.5, -2.5, 0.0, 1.2):
        record.one(value=0.5, features=(angle,))
    listed = client.get("/api/v1/studies/jump/strategies").json()["strategies"]
    study = store.study("jump")
    assert [one["number"] for one in listed] == [0, 1, 2, 3]
    assert [finding.trial.number for finding in distinct_trials(study, FinishedTrials(store).history(study))] == [
        0,
        1,
        2,
        3,
    ]
