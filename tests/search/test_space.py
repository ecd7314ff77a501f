import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from search_cases import spaces_with_points

from search import Angle, BadParams, BadSpace, Categorical, Float, Int, Space


@given(spaces_with_points())
def test_unit_to_natural_to_unit_is_the_identity_on_snapped_points(case):
    space, units = case
    snapped = space.snap(units)
    back = np.stack([space.to_unit(space.from_unit(u)) for u in snapped])
    gap = np.abs(back - snapped)
    gap = np.where(space.is_periodic(), np.minimum(gap, 1 - gap), gap)
    assert gap.max() < 1e-6


@given(spaces_with_points())
def test_natural_to_unit_to_natural_is_the_identity(case):
    space, units = case
    params = space.from_unit(units[0])
    again = space.from_unit(space.to_unit(params))
    for name, value in params.items():
        if isinstance(value, float):
            scale = max(1.0, abs(value))
            assert (
                abs(math.remainder(again[name] - value, 2 * math.pi)) < 1e-6 or abs(again[name] - value) < 1e-6 * scale
            )
        else:
            assert again[name] == value


@given(spaces_with_points())
def test_snapping_twice_changes_nothing_more(case):
    space, units = case
    once = space.snap(units)
    assert np.allclose(space.snap(once), once, atol=1e-12)


@given(st.floats(-10, 10), st.integers(-5, 5))
def test_an_angle_a_full_turn_further_is_the_same_point(theta, turns):
    space = Space({"a": Angle(), "b": Float(0, 1)})
    one = space.encode(space.to_unit({"a": theta, "b": 0.5})[None])
    other = space.encode(space.to_unit({"a": theta + turns * 2 * math.pi, "b": 0.5})[None])
    assert np.allclose(one, other, atol=1e-9)


@given(spaces_with_points(count=2))
def test_no_parameter_is_further_apart_than_one_in_model_coordinates(case):
    space, units = case
    a, b = space.encode(units)
    for i in range(space.d):
        mine = np.array(space.owner) == i
        assert np.linalg.norm((a - b)[mine]) <= 1 + 1e-12


@given(spaces_with_points())
def test_the_encoding_gradient_agrees_with_finite_differences(case):
    space, units = case
    u = np.clip(units[0], 0.01, 0.99)
    direction = np.random.default_rng(0).standard_normal(space.e)
    step = 1e-6
    slow = np.zeros(space.d)
    for i in range(space.d):
        up, down = u.copy(), u.copy()
        up[i] += step
        down[i] -= step
        slow[i] = (space.encode(up[None])[0] - space.encode(down[None])[0]) @ direction / (2 * step)
    smooth = ~space.is_categorical()
    assert np.allclose(space.encode_gradient(u, direction)[smooth], slow[smooth], atol=1e-5)


def test_hand_worked_unit_coordinates():
    space = Space(
        {
            "f": Float(-3, 3),
            "l": Float(1e-5, 1e-2, log=True),
            "i": Int(1, 4),
            "c": Categorical(("x", "y")),
            "a": Angle(),
        }
    )
    unit = space.to_unit({"f": 0.0, "l": 10**-3.5, "i": 3, "c": "y", "a": math.pi / 2})
    assert unit == pytest.approx([0.5, 0.5, 0.625, 0.75, 0.75])
    assert space.from_unit(np.array([1.0, 1.0, 1.0, 1.0, 1.0])) == {
        "f": 3.0,
        "l": 1e-2,
        "i": 4,
        "c": "y",
        "a": pytest.approx(-math.pi),
    }
    assert space.owner == (0, 1, 2, 3, 3, 4, 4)
    assert space.encode(unit[None])[0] == pytest.approx(
        [0.5, 0.5, 0.625, 0, math.sqrt(0.5), 0.5 * math.cos(1.5 * math.pi), 0.5 * math.sin(1.5 * math.pi)]
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Float(1, 1), "expected low < high, found low=1, high=1"),
        (lambda: Float(0, 1, log=True), "a logarithmic scale needs low > 0, found low=0"),
        (lambda: Float(float("nan"), 1), "expected a finite number, found nan"),
        (lambda: Int(3, 2), "expected low <= high, found low=3, high=2"),
        (lambda: Int(0.5, 2), "expected a whole number, found 0.5"),
        (lambda: Categorical(()), "expected at least one choice"),
        (lambda: Categorical(("a", "a")), "expected distinct choices"),
        (lambda: Space({}), "at least one parameter with more than one value"),
        (
            lambda: Space({"a": Categorical(("only",)), "b": Int(2, 2)}),
            "at least one parameter with more than one value",
        ),
        (lambda: Space({"a": 3.0}), "parameter 'a': expected Float, Int, Categorical or Angle, found 3.0"),
        (
            lambda: Space.from_specs({"a": {"kind": "flaot"}}),
            "expected kind float, int, categorical or angle, found 'flaot'",
        ),
        (
            lambda: Space.from_specs({"a": {"kind": "float", "low": 2, "high": 1}}),
            "parameter 'a': Float: expected low < high",
        ),
        (lambda: Space.from_specs({"a": {"kind": "float"}}), "parameter 'a': Float low: expected a number, found None"),
    ],
)
def test_a_wrong_space_says_what_was_expected_and_found(make, message):
    with pytest.raises(BadSpace) as caught:
        make()
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"omega": 0.0}, "'rate' is missing"),
        ({"omega": 0.0, "raet": 1.0}, "found unknown 'raet'; did you mean 'rate'?"),
        ({"omega": 4.0, "rate": 1}, "parameter 'omega': expected a value in [-3, 3], found 4.0"),
        ({"omega": math.nan, "rate": 1}, "parameter 'omega': a float parameter: expected a finite number, found nan"),
        ({"omega": 0.0, "rate": 1.5}, "parameter 'rate': expected a whole number in 1 .. 5, found 1.5"),
        ({"omega": "fast", "rate": 1}, "expected a number, found 'fast'"),
    ],
)
def test_wrong_parameters_say_what_was_expected_and_found(params, message):
    space = Space({"omega": Float(-3, 3), "rate": Int(1, 5)})
    with pytest.raises(BadParams) as caught:
        space.to_unit(params)
    assert message in str(caught.value)


def test_a_space_is_made_from_plain_data_and_from_objects_alike():
    class Spec:
        def __init__(self, kind, low=None, high=None, log=False, choices=()):
            self.kind, self.low, self.high, self.log, self.choices = kind, low, high, log, choices

    plain = {
        "f": {"kind": "float", "low": 1e-3, "high": 1, "log": True},
        "i": {"kind": "int", "low": 1, "high": 9},
        "c": {"kind": "categorical", "choices": ["a", "b"]},
        "a": {"kind": "angle"},
    }
    objects = {
        "f": Spec("float", 1e-3, 1, log=True),
        "i": Spec("int", 1.0, 9.0),
        "c": Spec("categorical", choices=("a", "b")),
        "a": Spec("angle", low=-math.pi, high=math.pi),
    }
    ready = Space({"f": Float(1e-3, 1, log=True), "i": Int(1, 9), "c": Categorical(("a", "b")), "a": Angle()})
    assert Space.from_specs(plain) == Space.from_specs(objects) == ready
