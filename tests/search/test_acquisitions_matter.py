"""What a search does that it wouldn't do with a broken acquisition.

Faults built in by hand, each of which was seen to fail here: the acquisition of the wrong sign, constant, blind to
doubt (no deviation), blind to what is foreseen (no mean); the difficulty chosen as the worst, always the easiest,
without its cost.
"""

import math

import numpy as np
import pytest

from search import Candidate, Features, Float, Observation, Space, make_strategy
from search.quality.budget import CostModel
from search.quality.cmfbo import LEVELS
from search.record import read_record

SQUARE = Space({"x": Float(0, 1), "y": Float(0, 1)})
REAL_TASK_ONLY = {"start": 1, "start_z": 1.0, "easy": 0.0, "share": 1.0}


def two_standard_errors_above(found, expected):
    """Whether the mean of `found` exceeds that of `expected` by more than chance explains."""
    found, expected = np.asarray(found, dtype=float), np.asarray(expected, dtype=float)
    error = math.sqrt(found.var(ddof=1) / len(found) + expected.var(ddof=1) / len(expected))
    return found.mean() - expected.mean() > 2 * error


def test_bds_goes_where_nothing_is_known_rather_than_where_one_behaviour_is_certain():
    ours, chance = [], []
    for seed in range(16):
        rng = np.random.default_rng(seed)
        known = 0.1 + 0.25 * rng.random((12, 2))
        history = [Observation(Candidate({"x": float(x), "y": float(y)}), 1.0, [0.5]) for x, y in known]
        # without the weight against near points, which alone would keep away from what was asked
        made = make_strategy("bds", SQUARE, features=Features.circle(), settings={"start": 0, "radius": 0.0})
        (c,) = made.propose(history, [], 1, rng)
        low = c.info["inset"]
        u = SQUARE.to_unit(c.params)
        ours.append(np.linalg.norm(known - u, axis=1).min())
        anywhere = low + (1 - 2 * low) * rng.random((20, 2))
        chance += np.linalg.norm(known[None] - anywhere[:, None], axis=2).min(1).tolist()
    assert two_standard_errors_above(ours, chance)


def test_bds_prefers_an_unlike_behaviour_that_it_can_foresee():
    # everywhere is known, but what lies at large x was not completed, so its behaviours are in no archive
    ours, chance = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        history = []
        for x, y in rng.random((60, 2)):
            done = x < 0.5
            behaviour = [0.0 if done else 3.0 * (float(x) - 0.5)]
            c = Candidate({"x": float(x), "y": float(y)})
            history.append(Observation(c, 1.0, behaviour, status="complete" if done else "infeasible"))
        settings = {"start": 0, "radius": 0.0, "feasibility": False}
        made = make_strategy("bds", SQUARE, features=Features.circle(), settings=settings)
        (c,) = made.propose(history, [], 1, rng)
        low = c.info["inset"]
        ours.append(c.params["x"])
        chance += (low + (1 - 2 * low) * rng.random(20)).tolist()
    assert two_standard_errors_above(ours, chance)


def hill_behind_a_hill(seed):
    """A low hill on the left, where the search begins, and a higher one on the right."""
    rng = np.random.default_rng(seed)
    low, high = np.array([0.2, 0.3]) + 0.1 * rng.random(2), np.array([0.7, 0.1]) + [0.2, 0.8] * rng.random(2)

    def value(u):
        near_low, near_high = np.square(u - low).sum(), np.square(u - high).sum()
        return 0.6 * math.exp(-near_low / 0.04) + 1.0 * math.exp(-near_high / 0.05)

    left = np.concatenate([low + 0.1 * (rng.random((3, 2)) - 0.5), [0.45, 1.0] * rng.random((7, 2))])
    return value, [Observation(Candidate(SQUARE.from_unit(u)), value(u)) for u in left]


def best_of_study(name, settings, seed, evaluations):
    value, history = hill_behind_a_hill(seed)
    made = make_strategy(name, SQUARE, settings=settings)
    for i in range(evaluations):
        (c,) = made.propose(history, [], 1, np.random.default_rng((seed, i)))
        history.append(Observation(c, value(SQUARE.to_unit(c.params)), cost=1.0))
    return max(o.value for o in history)


def test_cmfbo_leaves_a_hill_it_knows_for_a_higher_one():
    ours = [best_of_study("cmfbo", REAL_TASK_ONLY, s, 12) for s in range(12)]
    chance = [best_of_study("random", {}, s, 12) for s in range(60)]
    assert two_standard_errors_above(ours, chance)
    assert np.mean(np.array(ours) > 0.9) >= 0.5


@pytest.mark.parametrize("seed", range(6))
def test_the_difficulty_takes_away_most_variance_at_the_real_task_for_its_cost(seed):
    """Against the slow obvious way: add the observation, see how much is left."""
    rng = np.random.default_rng(seed)
    history = [
        Observation(Candidate(SQUARE.from_unit(u), z=float(z)), value=float(u.sum() - z), cost=0.1 + 0.9 * float(z))
        for u, z in zip(rng.random((14, 2)), rng.choice([0.1, 0.35, 1.0], 14, p=[0.7, 0.2, 0.1]), strict=True)
    ]
    made = make_strategy("cmfbo", SQUARE, settings={"gate": False, "share": 0.0, "easy": 0.0, "cost_budget": 100.0})
    record = read_record(SQUARE, None, history, [])
    model, _, _ = made.surrogates(record)
    (c,) = made.propose(history, [], 1, rng)
    u = SQUARE.to_unit(c.params)
    top = model.coordinates(u[None, :], 1.0)
    before = model.gp.posterior(top)[1][0]
    costs = CostModel(record)
    gains = []
    for z in LEVELS:
        there = model.coordinates(u[None, :], float(z))
        after = model.gp.with_data(there, model.gp.posterior(there)[0], model.noise).posterior(top)[1][0]
        gains.append((before - after) / before / costs.at(float(z)) * (2.0 if z == 1 else 1.0))
    assert gains[int(np.flatnonzero(c.z == LEVELS)[0])] == pytest.approx(max(gains), rel=1e-6)
