"""Studies made in memory for figures: one trial for each row that a test writes."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta

import pytest

from services.figures.shown import Shown
from services.states import StudyState, TrialState
from services.store.port import MetricRow, StudyRow, TrialRow

SPACE = {
    "rate": {"type": "float", "low": 1e-4, "high": 1e-1, "log": True},
    "omega_x": {"type": "float", "low": -3.0, "high": 3.0, "log": False},
    "layers": {"type": "int", "low": 1, "high": 4, "log": False},
    "kind": {"type": "categorical", "choices": ["tanh", "relu"]},
    "turn": {"type": "angle"},
}
CIRCLE = {"kind": "circle", "names": ["facing"], "distinct": 0.5, "low": [], "high": [], "unit": "rad"}
DIAL = {"kind": "euclidean", "names": ["facing"], "distinct": 0.5, "low": [0.0], "high": [math.pi], "unit": "rad"}
PLANE = {
    "kind": "euclidean",
    "names": ["reach", "height"],
    "distinct": 0.5,
    "low": [0.0, 0.0],
    "high": [5.0, 2.0],
    "unit": "m",
}
SPHERE = {"kind": "rotation", "names": ["x", "y", "z", "w"], "distinct": 1.0, "low": [], "high": [], "unit": "rad"}
BEGIN = datetime(2026, 3, 1, 12, tzinfo=UTC)


def params(number):
    """Every kind of parameter, another value for each trial."""
    return {
        "rate": 1e-4 * 1000 ** (number * 0.381966 % 1),
        "omega_x": -3 + 6 * (number * 0.618034 % 1),
        "layers": 1 + number % 4,
        "kind": ("tanh", "relu")[number % 2],
        "turn": -3 + 6 * (number * 0.754878 % 1),
    }


def trial(number, *, value=None, state="complete", features=None, z=None, warm_start=None, samples=1000, **details):
    return TrialRow(
        id=number + 1, study_id=1, number=number, stage="search", state=TrialState(state), params=params(number), z=z,
        warm_start=warm_start, seed=number, proposal_id=None, info={}, position=number, value=value,
        features=features, details=details, message="", samples=samples, seconds=1.0, iteration=3, attempts=1,
        retries=0, created_at=BEGIN, started_at=BEGIN + timedelta(minutes=number),
        finished_at=BEGIN + timedelta(minutes=number + 1),
    )  # fmt: skip


@pytest.fixture
def shown():
    """Makes a study of trials."""

    def make(trials, behaviour=None, space=SPACE, strategy="random", metrics=None):
        spec = {
            "name": "jump", "task": {"name": "high_jump", "settings": {}}, "space": space,
            "search": {"strategy": strategy, "settings": {}, "trials": 20, "cost": None}, "training": {}, "seed": 1,
            "resources": {"parallel": 1, "cpus": 1.0, "pool": "default"}, "behaviour": behaviour,
            "units": {"omega_x": "rad/s"}, "has_difficulty": any(t.z is not None for t in trials), "trains": True,
        }  # fmt: skip
        row = StudyRow(
            id=1, name="jump", state=StudyState.COMPLETE, reason="", wanted="run", spec=spec, seed=1, priority=0,
            pool="default", target_trials=20, target_cost=None, driver=None, driven_since=None, drive_token=1,
            drive_beat=0, created_at=BEGIN, finished_at=None,
        )  # fmt: skip
        return Shown(row, trials, metrics or (lambda _: []))

    return make


def metric(iteration, **values):
    return MetricRow(iteration, 1, values)
