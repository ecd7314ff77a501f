"""A record as an Optuna study."""

from __future__ import annotations

import math

import optuna
import pytest

from search import Angle, Categorical, Float, Int, Space
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
