"""What must change nothing: the order of a history, full turns of an angle. And what must be survived."""

import json
import math
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from search_cases import history_of, jump_space

from search import Angle, Candidate, Categorical, Features, Float, Int, Observation, Space, make_strategy, strategies

JUMPS = jump_space()


def turned_gap(space, one, other):
    """Largest distance of two candidates in unit coordinates, angles as what they are."""
    gap = np.abs(space.to_unit(one.params) - space.to_unit(other.params))
    return float(np.where(space.is_periodic(), np.minimum(gap, 1 - gap), gap).max())


def with_difficulties(history, rng):
    """The same observations, each at a difficulty of its own."""
    levels = rng.choice([0.1, 0.35, 1.0], len(history))
    return [
        Observation(Candidate(o.candidate.params, z=float(z)), o.value, o.features, o.cost, o.status)
        for o, z in zip(history, levels, strict=True)
    ]


@pytest.mark.parametrize("name", ["bds", "cmfbo", "gp_ucb", "sobol"])
@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_a_history_changes_no_proposal(name, seed):
    # up to 24 observations: beyond, hyperparameters stand on the first ones, so that fits can be kept
    rng = np.random.default_rng(seed)
    history = history_of(JUMPS, int(rng.integers(6, 20)), seed)
    if name == "cmfbo":
        history = with_difficulties(history, rng)
    order = rng.permutation(len(history))
    shuffled = [history[i] for i in order]
    made = make_strategy(name, JUMPS, features=Features.circle() if name == "bds" else None)
    (one,) = made.propose(history, [], 1, np.random.default_rng(seed))
    (other,) = made.propose(shuffled, [], 1, np.random.default_rng(seed))
    assert turned_gap(JUMPS, one, other) < 1e-3
    assert one.z == other.z
    if one.warm_start is not None:
        assert shuffled[other.warm_start] is history[one.warm_start]


@settings(max_examples=10)
@given(st.lists(st.integers(-3, 3), min_size=8, max_size=8))
def test_turning_angles_by_full_turns_changes_no_proposal_of_cmfbo(turns):
    space = Space({"a": Angle(), "b": Float(0, 1)})
    rng = np.random.default_rng(0)
    plain, turned = [], []
    for t in turns:
        params, z = space.from_unit(rng.random(2)), float(rng.choice([0.1, 1.0]))
        value = math.cos(params["a"]) + params["b"]
        plain.append(Observation(Candidate(params, z), value, cost=0.1 + 0.9 * z))
        further = {**params, "a": params["a"] + t * 2 * math.pi}
        turned.append(Observation(Candidate(further, z), value, cost=0.1 + 0.9 * z))
    made = make_strategy("cmfbo", space, settings={"easy": 0.0})
    (one,) = made.propose(plain, [], 1, np.random.default_rng(1))
    (other,) = made.propose(turned, [], 1, np.random.default_rng(1))
    assert turned_gap(space, one, other) < 1e-5
    assert (one.z, one.warm_start) == (other.z, other.warm_start)


NETWORK = Space(
    {"layers": Int(1, 6), "kind": Categorical(("relu", "tanh", "elu")), "rate": Float(1e-5, 1e-1, log=True)}
)


def learns(params, z):
    """Best with four layers of tanh at a rate of 1e-3; the easy task is kinder and peaks nearby."""
    gap = ((params["layers"] - 4) / 2.5) ** 2 + (params["kind"] != "tanh") * 0.5
    gap += (math.log10(params["rate"]) + 3 - 0.3 * (1 - z)) ** 2
    return (1.5 - 0.5 * z) * math.exp(-gap)


def answer(name, seed, budget=10.0):
    chosen = {"cost_budget": budget, "seed": seed} if name == "cmfbo" else {}
    made, history, paid = make_strategy(name, NETWORK, settings=chosen), [], 0.0
    while paid < budget:
        found = made.propose(history, [], 1, np.random.default_rng((seed, len(history))))
        for c in found:
            NETWORK.to_unit(c.params)  # raises where it is outside
            assert isinstance(c.params["layers"], int)
            z = 1.0 if c.z is None else c.z
            history.append(Observation(c, learns(c.params, z), cost=0.1 + 0.9 * z))
            paid += history[-1].cost
        if not found:
            break
    return learns(history[made.recommend(history)].candidate.params, 1.0)


def test_cmfbo_finds_integers_and_categories_that_random_search_misses():
    ours = np.array([answer("cmfbo", s) for s in range(6)])
    chance = np.array([answer("random", s) for s in range(6)])
    gain = ours - chance
    assert gain.mean() > 2 * gain.std(ddof=1) / math.sqrt(len(gain))
    assert np.median(ours) > 0.9


def hostile():
    """Histories that break linear algebra: name -> observations."""
    rng = np.random.default_rng(0)
    apart, values, angles = rng.random((12, 3)), rng.standard_normal(12), rng.uniform(-3, 3, 12)
    once = np.full((12, 3), 0.5)

    def told(points, values, zs=(None,) * 12, cost=1.0):
        candidates = [Candidate(JUMPS.from_unit(u), z=z) for u, z in zip(points, zs, strict=True)]
        rows = zip(candidates, values, angles, strict=True)
        return [Observation(c, float(v), [float(a)], cost) for c, v, a in rows]

    return {
        "enormous values": told(apart, rng.choice([1e300, -1e300], 12)),
        "one value": told(apart, np.ones(12)),
        "contradictions": told(once, values),
        "almost one point": told(once + 1e-13 * apart, values, cost=0.0),
        "one point at all difficulties": told(once, values, np.linspace(0, 1, 12).tolist(), cost=1e300),
    }


EVERY = [(info.name, {}) for info in strategies()] + [(name, {"variant": "published"}) for name in ("bds", "cmfbo")]


@pytest.mark.parametrize("history", hostile().values(), ids=hostile())
def test_a_hostile_history_is_survived_by_every_strategy(history):
    for name, chosen in EVERY:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            made = make_strategy(name, JUMPS, features=Features.circle(), settings=chosen)
            for c in made.propose(history, [], 2, np.random.default_rng(0)):
                assert np.isfinite(JUMPS.to_unit(c.params)).all(), name
                json.dumps(dict(c.info), allow_nan=False)


@pytest.mark.parametrize("name", ["bds", "cmfbo", "gp_ucb", "boca"])
def test_a_fit_that_breaks_falls_back_to_the_priors_with_a_warning_in_the_record(name, monkeypatch):
    import search.quality.fidelity
    import search.surrogate.fit

    def broken(*arguments, **options):
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(search.surrogate.fit, "minimize", broken)
    monkeypatch.setattr(search.quality.fidelity, "minimize", broken)
    made = make_strategy(name, JUMPS, features=Features.circle())
    for _ in range(2):  # the second time the fit is a kept one
        (c,) = made.propose(history_of(JUMPS, 12, seed=0), [], 1, np.random.default_rng(0))
        assert "surrogate not fitted, priors used: singular" in c.info["warnings"]


@pytest.mark.parametrize("name", ["bds", "cmfbo", "gp_ucb", "boca"])
def test_a_matrix_that_can_not_be_factored_is_told_in_the_record(name, monkeypatch):
    import search.surrogate.gp

    def broken(*arguments, **options):
        raise np.linalg.LinAlgError("not positive definite")

    made = make_strategy(name, JUMPS, features=Features.circle())
    monkeypatch.setattr(search.surrogate.gp, "cholesky", broken)
    (c,) = made.propose(history_of(JUMPS, 12, seed=0), [], 1, np.random.default_rng(0))
    assert "a correlation matrix could not be factored; its data are ignored" in c.info["warnings"]
