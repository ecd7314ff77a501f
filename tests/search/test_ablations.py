"""The benchmarks' ablations: each takes one repair away, and only that."""

import math

import numpy as np
import pytest
from search_cases import history_of, jump_space

from benchmarks.search import ablations, diversity, quality
from search import Candidate, Features, Float, Observation, Space, make_strategy
from search.quality.budget import PRIOR_FLOOR, CostModel
from search.quality.fidelity import FidelityProcess, ProductProcess
from search.quality.model import standardise
from search.record import read_record
from search.surrogate.fit import Prior, fit_map, flat

BOX = Space({"x": Float(0, 1), "y": Float(0, 1)})
BUDGET = {"cost_budget": 12.0}


def curriculum(count=14):
    rng = np.random.default_rng(3)
    history = []
    for u, z in zip(rng.random((count, 2)), rng.choice([0.1, 0.35, 1.0], count), strict=True):
        value = (1.5 - 0.5 * z) * math.exp(-float(np.square(u - 0.4).sum()) / 0.2)
        history.append(Observation(Candidate(BOX.from_unit(u), z=float(z)), value=value, cost=0.1 + 0.9 * float(z)))
    return history


def proposals(made, history, count=1):
    found = []
    for seed in range(4):
        found += [(dict(c.params), c.z) for c in made.propose(history, [], count, np.random.default_rng(seed))]
    return found


@pytest.mark.parametrize(
    "name", ["cmfbo without trend", "cmfbo without priors", "cmfbo with the published acquisition"]
)
def test_an_ablated_cmfbo_proposes_otherwise(name):
    made = ablations.strategy_class(name)(BOX, None, BUDGET)
    assert proposals(made, curriculum()) != proposals(make_strategy("cmfbo", BOX, settings=BUDGET), curriculum())


@pytest.mark.parametrize("name", ["bds without priors", "bds without noise", "bds with plain geometry"])
def test_an_ablated_bds_proposes_otherwise_and_goes_on_proposing(name):
    space = jump_space()
    history = history_of(space, 20, seed=1)
    made = ablations.strategy_class(name)(space, Features.circle(), {})
    found = proposals(made, history)
    assert found != proposals(make_strategy("bds", space, features=Features.circle()), history)
    assert all(space.to_unit(params).shape == (3,) for params, _ in found)


def test_without_belief_a_batch_of_one_is_the_same_and_the_rest_is_not():
    space = jump_space()
    history = history_of(space, 20, seed=1)
    made = ablations.strategy_class("bds without belief")(space, Features.circle(), {})
    whole = make_strategy("bds", space, features=Features.circle())
    assert proposals(made, history) == proposals(whole, history)
    assert proposals(made, history, 4) != proposals(whole, history, 4)


def test_alternating_takes_the_larger_deviation_in_three_turns_of_six():
    space = jump_space()
    made = ablations.strategy_class("bds alternating")(space, Features.circle(), {})
    whole = make_strategy("bds", space, features=Features.circle())
    same = [
        proposals(made, history_of(space, n, seed=1)) == proposals(whole, history_of(space, n, seed=1))
        for n in range(18, 24)
    ]
    assert same == [False, False, False, True, True, True]


def test_plain_geometry_takes_rotations_as_rotation_vectors():
    made = ablations.strategy_class("bds with plain geometry")(BOX, Features.rotation(), {"start": 0})
    rng = np.random.default_rng(0)
    history = []
    for u in rng.random((6, 2)):
        q = rng.standard_normal(4)
        history.append(Observation(Candidate(BOX.from_unit(u)), 1.0, (q / np.linalg.norm(q)).tolist()))
    (c,) = made.propose(history, [], 1, np.random.default_rng(0))
    assert len(c.info["predicted"]) == 3


def test_without_a_trend_the_kernel_is_the_product_and_values_are_only_centred():
    X = np.random.default_rng(0).random((5, 3))
    plain = (X, X[:, :1], np.array([2.0, 1.0, 0.5]), np.ones(1), 1e-3, np.zeros(1))
    assert FidelityProcess(*plain, 0.4, 0.0).posterior(X + 0.1)[0] == pytest.approx(
        ProductProcess(*plain).posterior(X + 0.1)[0]
    )
    scale = standardise(np.array([1.0, 2.0, 6.0]), np.array([0.1, 0.5, 1.0]), trend=False)
    assert (scale.middle, scale.trend) == (3.0, 0.0)


def test_a_flat_prior_is_maximum_likelihood():
    rng = np.random.default_rng(0)
    X = rng.random((25, 1))
    y = np.sin(9 * X) + 0.05 * rng.standard_normal((25, 1))
    found = fit_map(X, y, [0], flat(Prior()))

    def loss(w, noise):  # minus the log likelihood, the amplitude at its best
        r = math.sqrt(5) * w * np.abs(X - X.T)
        K = (1 + r + r * r / 3) * np.exp(-r) + noise * np.eye(25)
        return 12.5 * math.log(float((y.T @ np.linalg.solve(K, y)).item())) + 0.5 * np.linalg.slogdet(K)[1]

    best = loss(found.w[0], found.noise)
    around = [loss(found.w[0] * a, found.noise * b) for a in (0.8, 0.95, 1, 1.05, 1.25) for b in (0.5, 0.9, 1, 1.1, 2)]
    assert best <= min(around) + 1e-3


def test_prior_costs_know_the_mean_of_what_was_paid_and_not_by_which_difficulty():
    history = [
        Observation(Candidate({"x": 0.1, "y": y}, z=z), value=0.0, cost=c) for y, z, c in ((0.1, 0, 5), (0.2, 1, 15))
    ]
    record = read_record(BOX, None, history, [])
    costs = ablations.PriorCosts(BOX, None, {})._costs(record)
    assert costs.at(1.0) == pytest.approx((5 / PRIOR_FLOOR + 15) / 2)
    assert costs.at(0.0) / costs.at(1.0) == pytest.approx(PRIOR_FLOOR)
    assert CostModel(record).at(0.0) / CostModel(record).at(1.0) > PRIOR_FLOOR


def test_every_arm_of_the_benchmarks_can_be_made():
    for module in (quality, diversity):
        for name, settings, *_ in [*module.CONFIGS.values(), *module.ABLATIONS.values()]:
            assert ablations.strategy_class(name)(BOX, Features.circle(), settings).info().summary


def test_an_arm_is_compared_with_what_it_was_taken_from():
    configs = ["random", "cmfbo", "cmfbo, transfer"]
    assert diversity.base_of("random", configs, "cmfbo") == "cmfbo"
    assert diversity.base_of("cmfbo - trend", configs, "cmfbo") == "cmfbo"
    assert diversity.base_of("cmfbo, transfer, any parent", configs, "cmfbo") == "cmfbo, transfer"


def test_paired_differences_are_over_the_seeds_that_both_have(capsys):
    def runs(config, values):
        return [{"config": config, "seed": s, "problem": p, "v": v} for s, v in enumerate(values) for p in "ab"]

    rows = runs("cmfbo", [1.0, 2.0, 3.0]) + runs("cmfbo - trend", [0.5, 2.5])
    diversity.paired(rows, ["cmfbo"], "cmfbo", lambda r: [r["v"]])
    assert "0.000 (0.500)   to cmfbo, 2 seeds" in capsys.readouterr().out


def test_a_seed_that_lacks_a_problem_is_left_out():
    rows = [{"config": "x", "seed": s, "problem": p} for s, p in ((0, "a"), (0, "b"), (1, "a"))]
    assert {r["seed"] for r in diversity.whole_seeds(rows, ["a", "b"])} == {0}
