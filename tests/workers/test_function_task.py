import math

import numpy as np
import pytest

from tests.workers.toy_environments import job
from workers.contracts import BadJob, BadSetting
from workers.local_context import LocalContext
from workers.tasks.features import mean_behaviour
from workers.tasks.function import FunctionTask, Infeasible

PLANE = {"features": {"kind": "euclidean", "names": ["a", "b"], "low": [0, 0], "high": [1, 2], "distinct": 0.1}}
CIRCLE = {"features": {"kind": "circle", "names": ["facing"], "distinct": 0.5}}
ROTATION = {"features": {"kind": "rotation", "distinct": 0.5}}


def outcome(function, tmp_path, settings=None, **fields):
    context = LocalContext(tmp_path)
    task = FunctionTask("m:f", function)
    return task.run(job(**({"params": {"x": 0.5}, "task_settings": settings or {}} | fields)), context)


@pytest.mark.parametrize(
    ("function", "value", "features", "samples"),
    [
        (lambda params: params["x"], 0.5, None, 1),
        (lambda params, z: (params["x"] * z,), 0.125, None, 1),
        (lambda params, z: (1, [0.1, 0.2]), 1.0, (0.1, 0.2), 1),
        (lambda params, z: (np.float32(2), np.array([0.1, 0.2]), 40), 2.0, (0.1, 0.2), 40),
        (lambda params, z: (np.array(2.0), None, 1.5), 2.0, None, 2),
    ],
)
def test_value_features_and_cost_are_read_in_every_form_they_may_have(tmp_path, function, value, features, samples):
    found = outcome(function, tmp_path, PLANE if features else None, z=0.25)
    assert (found.status, found.value, found.features, found.cost.samples) == ("complete", value, features, samples)
    assert found.cost.seconds >= 0


def test_a_function_has_a_difficulty_where_it_takes_z():
    assert FunctionTask("m:f", lambda params, z: 0.0).info({}).has_difficulty
    assert not FunctionTask("m:f", lambda params: 0.0).info({}).has_difficulty
    assert not FunctionTask("m:f", lambda params, rng: 0.0).info({}).has_difficulty


def test_a_function_that_takes_rng_gets_the_jobs_own(tmp_path):
    def noisy(params, rng):
        return rng.random()

    values = [outcome(noisy, tmp_path / str(i), seed=s).value for i, s in enumerate([1, 1, 2])]
    assert values[0] == values[1] != values[2]


def test_a_function_cannot_change_the_job(tmp_path):
    subject = job(params={"x": 1.0})

    def greedy(params):
        params["x"] = 2.0
        return 0.0

    FunctionTask("m:f", greedy).run(subject, LocalContext(tmp_path))
    assert subject.params == {"x": 1.0}


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (math.nan, "value became NaN"),
        (-math.inf, "value became infinite"),
        ((1.0, [0.0, math.nan]), "features became NaN"),
    ],
)
def test_a_number_that_is_none_is_a_divergence(tmp_path, result, message):
    found = outcome(lambda params: result, tmp_path, PLANE if isinstance(result, tuple) else None)
    assert (found.status, found.value, found.message) == ("diverged", None, message)


def test_an_exception_fails_the_trial_with_the_users_traceback_alone(tmp_path):
    def f(params):
        return params["y"]

    found = outcome(f, tmp_path)
    assert found.status == "failed"
    assert found.message.startswith("KeyError: 'y' (test_function_task.py, line ")
    assert "in f\n" in found.details["traceback"]
    assert "workers/tasks/function.py" not in found.details["traceback"]
    assert found.details["traceback"] in (tmp_path / "log.txt").read_text()


def test_an_infeasible_candidate_is_an_outcome(tmp_path):
    def f(params):
        raise Infeasible("the foot is under the ground")

    found = outcome(f, tmp_path)
    assert (found.status, found.message) == ("infeasible", "the foot is under the ground")


@pytest.mark.parametrize(
    ("result", "settings", "message"),
    [
        (None, {}, "expected a number as value, found None"),
        ("good", {}, "expected a number as value, found 'good'"),
        (True, {}, "expected a number as value, found True"),
        ((1.0, [0.1, 0.2], 3, 4), {}, "expected value, features and cost at most, found 4 values"),
        ((1.0, [0.1, 0.2], -1), PLANE, "expected a number of at least 0 as cost, found -1"),
        ((1.0, [0.1]), PLANE, r"expected 2 features \(a, b\), found \[0.1\]"),
        ((1.0, "ab"), PLANE, r"expected 2 features \(a, b\), found 'ab'"),
        (1.0, PLANE, r"expected 2 features \(a, b\), found none"),
        ((1.0, [0.1]), {}, r"expected no features, found \[0.1\]; declare them in the study file"),
        ((1.0, [0, 0, 0, 2]), ROTATION, r"expected a unit quaternion, found \[0, 0, 0, 2\] of length 2"),
    ],
)
def test_a_result_that_is_none_is_refused_with_what_was_expected_and_found(tmp_path, result, settings, message):
    with pytest.raises(BadJob, match=message):
        outcome(lambda params: result, tmp_path, settings)


def test_features_are_declared_in_the_settings():
    spec = FunctionTask("m:f", lambda params: 0.0).info(PLANE).features
    assert (spec.kind, spec.names, spec.low, spec.high, spec.distinct) == ("euclidean", ("a", "b"), (0, 0), (1, 2), 0.1)
    assert FunctionTask("m:f", lambda params: 0.0).info(CIRCLE).features.names == ("facing",)
    assert FunctionTask("m:f", lambda params: 0.0).info(ROTATION).features.names == ("x", "y", "z", "w")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "sphere"}, "features.kind: expected euclidean, circle or rotation, found 'sphere'"),
        ({"names": []}, r"features.names: expected a list of names, found \[\]"),
        ({"low": [0]}, r"features.low: expected a list of 2 numbers, found \[0\]"),
        ({"high": None}, "features.high: expected a list of 2 numbers, found None"),
        ({"low": [0, 2]}, "features.low: expected less than high for 'b', found 2 and 2"),
        ({"distinct": 0}, "features.distinct: expected a number above 0, found 0"),
        ({"distnict": 1}, r"features.distnict: unknown setting; did you mean 'distinct'"),
        ({"kind": "circle"}, "features.names: expected 1 for kind circle, found 2"),
        ({"kind": "circle", "names": ["a"]}, r"features.low: expected none for kind circle, found \[0, 0\]"),
    ],
)
def test_a_wrong_declaration_is_refused(change, message):
    with pytest.raises(BadSetting, match=f"task.settings.{message}"):
        FunctionTask("m:f", lambda params: 0.0).info({"features": PLANE["features"] | change})


def test_a_function_has_no_other_settings_no_training_and_no_space_of_its_own():
    task = FunctionTask("m:f", lambda params: 0.0)
    task.validate(PLANE, {}, ["x"])
    with pytest.raises(
        BadSetting, match=r"task.settings.feature: unknown setting of a function; did you mean 'features'"
    ):
        task.validate({"feature": {}}, {}, ["x"])
    with pytest.raises(BadSetting, match=r"training.budget: expected none: a function is not trained"):
        task.validate({}, {"budget": {}}, ["x"])
    with pytest.raises(BadSetting, match=r"space.: expected at least one parameter"):
        task.validate({}, {}, [])


def test_a_function_without_arguments_is_refused():
    with pytest.raises(BadJob, match=r"expected a function f\(params, z\), found one without arguments"):
        FunctionTask("m:f", lambda: 0.0)


def test_the_mean_of_behaviours_is_that_of_their_metric():
    def spec(settings):
        return FunctionTask("m:f", lambda params: 0.0).info(settings).features

    assert mean_behaviour(spec(PLANE), [(0.0, 1.0), (1.0, 2.0)]) == (0.5, 1.5)
    (angle,) = mean_behaviour(spec(CIRCLE), [(math.pi - 0.1,), (-math.pi + 0.3,)])
    assert math.isclose(math.remainder(angle - (math.pi + 0.1), 2 * math.pi), 0.0, abs_tol=1e-9)
    half = math.sqrt(0.5)
    found = mean_behaviour(spec(ROTATION), [(0.0, 0.0, half, half), (-0.0, -0.0, -half, -half)])
    np.testing.assert_allclose(found, (0.0, 0.0, half, half), atol=1e-12)
