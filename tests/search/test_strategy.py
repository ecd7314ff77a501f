"""What holds for every strategy."""

import math

import numpy as np
import pytest
from search_cases import facing, history_of, jump_space

from search import (
    Angle,
    BadCount,
    BadHistory,
    BadSetting,
    Candidate,
    Categorical,
    Features,
    Float,
    Int,
    Observation,
    Space,
    UnknownStrategy,
    make_strategy,
    strategies,
)
from search.designs import sobol_points

NAMES = [info.name for info in strategies()]


def strategy_of(name, space=None, **settings):
    info = next(i for i in strategies() if i.name == name)
    features = Features.circle() if info.uses_features else None
    return make_strategy(name, space or jump_space(), features=features, settings=settings)


@pytest.mark.parametrize("name", NAMES)
def test_equal_arguments_give_equal_proposals(name):
    space = jump_space()
    history, pending = history_of(space, 12, seed=1), [Candidate(space.from_unit(np.full(3, 0.3)))]
    one = strategy_of(name).propose(history, pending, 3, np.random.default_rng(5))
    other = strategy_of(name).propose(list(history), tuple(pending), 3, np.random.default_rng(5))
    assert one == other
    assert len(one) == 3


@pytest.mark.parametrize("name", NAMES)
def test_proposals_lie_in_a_mixed_space(name):
    space = Space(
        {"f": Float(1, 10, log=True), "i": Int(0, 3), "c": Categorical(("a", "b", "c")), "a": Angle(), "one": Int(4, 4)}
    )

    def behave(params):
        return [math.remainder(params["i"] + params["a"], 2 * math.pi)]

    history = []
    strategy = strategy_of(name, space)
    for i in range(6):
        (candidate,) = strategy.propose(history, [], 1, np.random.default_rng(i))
        space.to_unit(candidate.params)  # raises where it is outside
        assert candidate.params["one"] == 4
        history.append(Observation(candidate, value=1.0, features=behave(candidate.params), cost=1.0))


@pytest.mark.parametrize("name", NAMES)
def test_a_history_of_failures_alone_is_survived(name):
    space = jump_space()
    history = [
        Observation(Candidate(space.from_unit(u)), status="failed") for u in np.random.default_rng(0).random((5, 3))
    ]
    assert len(strategy_of(name).propose(history, [], 2, np.random.default_rng(0))) == 2


@pytest.mark.parametrize("name", NAMES)
def test_the_same_outcome_at_the_same_point_many_times_is_survived(name):
    space = jump_space()
    params = space.from_unit(np.full(3, 0.5))
    history = [Observation(Candidate(params), value=1.0, features=facing(params), cost=1.0)] * 6
    assert len(strategy_of(name).propose(history, [], 1, np.random.default_rng(0))) == 1


GOOD = {"alpha": 0.0, "omega_x": 0.0, "rate": 1e-3}


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        (Observation(Candidate({**GOOD, "speed": 1.0}), 1.0, [0.0]), "history[1]: expected parameters"),
        (
            Observation(Candidate({**GOOD, "rate": 2.0}), 1.0, [0.0]),
            "history[1]: parameter 'rate': expected a value in",
        ),
        (Observation(Candidate(GOOD), 1.0, [0.0, 1.0]), "history[1]: expected 1 numbers as circle features, found 2"),
        (Observation(Candidate(GOOD), 1.0, [math.nan]), "history[1]: expected finite circle features"),
        (Observation(Candidate(GOOD), math.nan, [0.0]), "history[1]: value: expected a finite number, found nan"),
        (Observation(Candidate(GOOD), 1.0, None), "history[1]: expected features for a complete trial, found None"),
        (Observation(Candidate(GOOD, z=1.5), 1.0, [0.0]), "history[1]: expected a difficulty z in [0, 1], found 1.5"),
        (
            Observation(Candidate(GOOD, z=math.nan), 1.0, [0.0]),
            "history[1]: expected a difficulty z in [0, 1], found nan",
        ),
        (
            Observation(Candidate({**GOOD, "omega_x": math.nan}), 1.0, [0.0]),
            "history[1]: parameter 'omega_x': a float parameter: expected a finite number, found nan",
        ),
        (
            Observation(Candidate(GOOD), 1.0, [0.0], cost=math.nan),
            "history[1]: cost: expected a finite number, found nan",
        ),
        (Observation(Candidate(GOOD), 1.0, [0.0], cost=-1.0), "history[1]: expected a cost of at least 0, found -1.0"),
        (Observation(Candidate(GOOD), 1.0, [0.0], status="done"), "found 'done'"),
        ({"params": GOOD}, "history[1]: expected an Observation, found"),
    ],
)
def test_a_wrong_observation_names_its_index_and_what_was_expected(observation, message):
    history = [Observation(Candidate(GOOD), 1.0, [0.0]), observation]
    with pytest.raises(BadHistory) as caught:
        strategy_of("bds").propose(history, [], 1, np.random.default_rng(0))
    assert message in str(caught.value)


def test_a_wrong_pending_candidate_names_its_index():
    with pytest.raises(BadHistory, match=r"pending\[0\]: expected parameters .*'rate' is missing"):
        strategy_of("random").propose([], [Candidate({"alpha": 0.0, "omega_x": 0.0})], 1, np.random.default_rng(0))


@pytest.mark.parametrize("count", [0, -1, 1.5, True])
def test_a_count_below_one_is_refused(count):
    with pytest.raises(BadCount, match=f"expected a count of at least 1, found {count}"):
        strategy_of("random").propose([], [], count, np.random.default_rng(0))


def test_an_unknown_strategy_names_the_nearest():
    with pytest.raises(UnknownStrategy, match="found 'sobel'; did you mean 'sobol'"):
        make_strategy("sobel", jump_space())


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"sampels": 3}, "bds: setting 'sampels': expected one of the known settings"),
        ({"sampels": 3}, "did you mean 'samples'?"),
        ({"samples": 0}, "bds: setting 'samples': expected at least 1, found 0"),
        ({"samples": "many"}, "bds: setting 'samples': expected int, found 'many'"),
        ({"samples": True}, "bds: setting 'samples': expected int, found True"),
        ({"variant": "printed"}, "found 'printed'"),
    ],
)
def test_a_wrong_setting_says_what_was_expected_and_found(settings, message):
    with pytest.raises(BadSetting) as caught:
        strategy_of("bds", **settings)
    assert message in str(caught.value)


def test_a_strategy_that_needs_behaviours_refuses_to_do_without():
    with pytest.raises(BadSetting, match=r"bds: setting 'features': expected a feature space \(Features\), found None"):
        make_strategy("bds", jump_space())


def test_every_listed_setting_has_a_meaning_and_is_accepted():
    for info in strategies():
        assert info.summary
        for s in info.settings:
            assert s.summary
        strategy_of(info.name, **{s.name: s.default for s in info.settings})


def test_sobol_goes_on_where_history_and_pending_end():
    space = jump_space()
    strategy = strategy_of("sobol")
    first = strategy.propose([], [], 4, np.random.default_rng(0))
    history = [Observation(c, status="failed") for c in first[:2]]
    then = strategy.propose(history, first[2:], 3, np.random.default_rng(9))
    expected = sobol_points(space, 0, 7, 0)
    assert np.allclose([space.to_unit(c.params) for c in first + then], expected, atol=1e-9)


def test_sobol_does_not_repeat_a_point_after_a_cancelled_trial():
    space = jump_space()
    strategy = strategy_of("sobol")
    first = strategy.propose([], [], 4, np.random.default_rng(0))
    left = [first[0], first[2], first[3]]  # the second was cancelled
    (then,) = strategy.propose([], left, 1, np.random.default_rng(0))
    assert all(np.abs(space.to_unit(then.params) - space.to_unit(c.params)).max() > 1e-6 for c in left)


def test_half_of_the_edge_controls_coordinates_lie_on_faces():
    candidates = strategy_of("edge").propose([], [], 2000, np.random.default_rng(0))
    units = np.array([jump_space().to_unit(c.params) for c in candidates])
    on_face = (units < 1e-9) | (units > 1 - 1e-9)
    assert not on_face[:, 0].any()  # an angle has no faces
    assert np.all(np.abs(on_face[:, 1:].mean(0) - 0.5) < 0.05)


def test_a_quaternion_that_is_no_rotation_names_its_index_and_its_norm():
    strategy = make_strategy("bds", jump_space(), features=Features.rotation())
    history = [Observation(Candidate(GOOD), 1.0, [0, 0, 0, 1]), Observation(Candidate(GOOD), 1.0, [1, 1, 0, 0])]
    with pytest.raises(
        BadHistory, match=r"history\[1\]: expected a unit quaternion \(x, y, z, w\), found norm 1.41421"
    ):
        strategy.propose(history, [], 1, np.random.default_rng(0))
