"""A record as an Optuna study."""

from __future__ import annotations

import math
import sqlite3
from datetime import UTC, datetime, timedelta

import optuna
import pytest

from search import Angle, Categorical, Float, Int, Space, optuna_export
from search.optuna_export import ExportRefused, Trial, distributions, export

SPACE = Space(
    {"turn": Angle(), "rate": Float(1e-4, 1.0, log=True), "layers": Int(1, 4), "kind": Categorical(("x", "y"))}
)
PARAMS = {"turn": -3.0, "rate": 1e-4, "layers": 4, "kind": "y"}


def trial(status, value, **attributes):
    return Trial(PARAMS, status, value, None, None, attributes)


def test_every_kind_of_parameter_has_its_distribution():
    assert distributions(SPACE) == {
        "turn": optuna.distributions.FloatDistribution(-math.pi, math.pi),
        "rate": optuna.distributions.FloatDistribution(1e-4, 1.0, log=True),
        "layers": optuna.distributions.IntDistribution(1, 4),
        "kind": optuna.distributions.CategoricalDistribution(("x", "y")),
    }


def test_trials_come_back_with_values_states_and_attributes(tmp_path):
    storage = f"sqlite:///{tmp_path}/a.db"
    trials = [
        trial("complete", 0.5, number=0),
        trial("complete", 0.75, number=1, features=[0.1]),
        trial("infeasible", None, number=2),
        trial("diverged", None, number=3),
        trial("failed", None, number=4),
        trial("complete", None, number=5),
    ]
    assert export("s", SPACE, trials, storage) == 6
    study = optuna.load_study(study_name="s", storage=storage)
    assert study.direction is optuna.study.StudyDirection.MAXIMIZE
    assert [found.state.name for found in study.trials] == ["COMPLETE", "COMPLETE", "PRUNED", "FAIL", "FAIL", "FAIL"]
    assert study.best_trial.user_attrs == {"number": 1, "features": [0.1], "status": "complete"}
    assert all(found.params == PARAMS for found in study.trials)


def test_a_second_export_of_the_same_name_is_refused(tmp_path):
    storage = f"sqlite:///{tmp_path}/a.db"
    export("s", SPACE, [], storage)
    with pytest.raises(ExportRefused, match="expected no Optuna study s in sqlite"):
        export("s", SPACE, [], storage)


def cells(file):
    """Every cell of every table by table, without the time at which the file was made."""
    with sqlite3.connect(file) as database:
        tables = sorted(name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'"))
        found = {table: sorted(map(repr, database.execute(f"SELECT * FROM {table}"))) for table in tables}
    database.close()
    return found


def test_every_cell_is_what_optuna_itself_writes(tmp_path, monkeypatch):
    """Its own `add_trials`, a hundred times slower, is the obvious version."""
    begin = datetime(2026, 3, 29, 0, 30, tzinfo=UTC)
    trials = [
        Trial(PARAMS, status, value, started, finished, {"number": i, "note": "ä", "features": [0.1, None]}, curve)
        for i, (status, value, started, finished, curve) in enumerate(
            [
                ("complete", 0.5, begin, begin + timedelta(hours=1.5), {1: 0.25, 7: float("nan")}),
                ("complete", float("inf"), begin, begin, {}),
                ("complete", float("-inf"), None, begin, {2: float("-inf")}),
                ("infeasible", None, begin, begin, {}),
                ("failed", 0.5, begin, begin, {1: float("inf")}),
                ("running", None, begin, None, {1: 0.125}),
                ("queued", None, None, None, {}),
            ]
        )
    ]
    monkeypatch.setattr(optuna_export, "AT_A_TIME", 3)
    export("s", SPACE, trials, f"sqlite:///{tmp_path}/ours.db", {"task": {"name": "x"}})
    study = optuna.create_study(study_name="s", storage=f"sqlite:///{tmp_path}/theirs.db", direction="maximize")
    study.set_user_attr("task", {"name": "x"})
    study.add_trials([optuna_export._frozen(one, distributions(SPACE)) for one in trials])
    assert cells(tmp_path / "ours.db") == cells(tmp_path / "theirs.db")


def test_an_export_beside_another_study_keeps_both(tmp_path):
    storage = f"sqlite:///{tmp_path}/a.db"
    export("first", SPACE, [trial("complete", 0.5), trial("complete", 0.25)], storage)
    export("second", SPACE, [trial("complete", 0.75)], storage)
    found = [optuna.load_study(study_name=name, storage=storage) for name in ("first", "second")]
    assert [[one.value for one in study.trials] for study in found] == [[0.5, 0.25], [0.75]]
    assert [[one.number for one in study.trials] for study in found] == [[0, 1], [0]]
