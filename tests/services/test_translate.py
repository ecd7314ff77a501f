"""Between the search's and the workers' vocabularies."""

from __future__ import annotations

import math

import pytest

from search import Angle, Categorical, Features, Float, Int
from services.spec import ResolvedSpec, StudySpec
from services.translate import (
    build_strategy,
    job_of,
    parameter_of,
    resolve,
    search_features,
    search_space,
    strategy_settings,
)
from workers.contracts import FeatureSpec, ParameterSpec, TaskInfo

PARAMETERS = {
    "b_rate": ParameterSpec("float", 1e-4, 1.0, log=True, unit="1/s"),
    "a_turn": ParameterSpec("angle", unit="rad"),
    "c_layers": ParameterSpec("int", 1, 4),
    "d_kind": ParameterSpec("categorical", choices=("x", "y")),
}
INFO = TaskInfo("t", "a task", PARAMETERS, FeatureSpec("circle", ("facing",), 0.5, unit="rad"), has_difficulty=True)


def spec(**fields):
    return StudySpec.from_json({"name": "s", "task": "t", "search": {"strategy": "random", "trials": 3}, **fields})


def test_a_study_without_a_space_takes_the_tasks():
    resolved = resolve(spec(), INFO)
    assert search_space(resolved).parameters == {
        "a_turn": Angle(),
        "b_rate": Float(1e-4, 1.0, log=True),
        "c_layers": Int(1, 4),
        "d_kind": Categorical(("x", "y")),
    }
    assert resolved.units == {"b_rate": "1/s", "a_turn": "rad"}
    assert (resolved.has_difficulty, resolved.trains) == (True, True)


def test_a_study_with_a_space_keeps_it_and_only_its_units():
    resolved = resolve(spec(space={"a_turn": "angle", "mine": {"type": "int", "low": 1, "high": 2}}), INFO)
    assert search_space(resolved).parameters == {"a_turn": Angle(), "mine": Int(1, 2)}
    assert resolved.units == {"a_turn": "rad"}


def test_the_order_in_which_a_file_lists_its_parameters_changes_no_proposal():
    one = resolve(spec(space={"x": "angle", "y": {"type": "float", "low": 0, "high": 1}}), INFO)
    other = resolve(spec(space={"y": {"type": "float", "low": 0, "high": 1}, "x": "angle"}), INFO)
    assert search_space(one) == search_space(other)


def test_a_resolved_study_survives_the_database_and_needs_its_task_no_more():
    resolved = resolve(spec(), INFO)
    back = StudySpec.from_json(resolved.to_json())
    assert isinstance(back, ResolvedSpec)
    assert back == resolved
    assert build_strategy(resolved.to_json()).space == search_space(resolved)


def test_features_keep_their_metric():
    assert search_features(resolve(spec(), INFO).behaviour) == Features.circle()
    euclidean = FeatureSpec("euclidean", ("a", "b"), 0.1, low=(-1.0, 0.0), high=(1.0, 2.0))
    found = resolve(spec(), TaskInfo("t", "", PARAMETERS, euclidean)).behaviour
    assert search_features(found) == Features.euclidean(2, low=(-1.0, 0.0), high=(1.0, 2.0))
    rotation = FeatureSpec("rotation", ("x", "y", "z", "w"), math.pi / 4)
    assert search_features(resolve(spec(), TaskInfo("t", "", PARAMETERS, rotation)).behaviour) == Features.rotation()
    assert search_features(resolve(spec(), TaskInfo("t", "", PARAMETERS)).behaviour) is None


def test_no_space_at_all_is_refused():
    with pytest.raises(ValueError, match="expected a space, because t has none of its own, found nothing"):
        resolve(spec(), TaskInfo("t", ""))


def test_a_parameter_without_bounds_is_a_mistake_of_the_task():
    with pytest.raises(ValueError, match="expected a float parameter with low and high"):
        parameter_of(ParameterSpec("float", low=0.0))


def test_a_cost_budget_is_not_forced_on_a_strategy_that_plans_none():
    study = spec(search={"strategy": "random", "cost": 1000.0})
    assert strategy_settings(study) == {}


def test_a_job_holds_all_that_a_training_depends_on(tmp_path):
    from services.driver import this_process
    from services.store.open import open_store
    from services.store.port import NewTrial

    resolved = resolve(spec(training={"budget": {"samples": 10}}), INFO)
    store = open_store(tmp_path / "a.db")
    with store.transaction() as change:
        row = change.create_study("s", resolved.to_json(), seed=1)
        token = change.drive("s", this_process())
        new = NewTrial({"a_turn": 1.0}, seed=2**64 - 1, z=0.5, warm_start=None)
        (trial,) = change.propose(
            row.id, token, strategy="random", history=0, pending=[], rng_key=[1], seconds=0.0, trials=[new]
        )
    store.close()
    job = job_of(resolved, trial)
    assert (job.study, job.trial, job.task, job.params, job.z, job.seed, job.parent) == (
        "s", 0, "t", {"a_turn": 1.0}, 0.5, 2**64 - 1, None,
    )  # fmt: skip
    assert job.training == {"budget": {"samples": 10}}
