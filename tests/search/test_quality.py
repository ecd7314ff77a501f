"""Acquisitions, fidelities and budgets of the value searches, against hand-worked values and slow obvious versions."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

from search import Candidate, Float, Int, Observation, Space, make_strategy
from search.quality.acquisition import log_ei_gradient, log_expected_improvement, log_h, maximise
from search.quality.budget import CostModel, spent
from search.quality.fidelity import TREND, FidelityProcess, ProductProcess, negative_log_posterior
from search.quality.model import ValueModel, standardise
from search.record import read_record
from search.surrogate import fit as plain
from search.surrogate.fit import Fit, Prior, fit_map, squared_gaps

BOX = Space({"x": Float(0, 1), "y": Float(0, 1)})


def record_of(points, pending=()):
    history = [Observation(Candidate({"x": x, "y": y}, z=z), value=v, cost=c) for x, y, z, v, c in points]
    return read_record(BOX, None, history, [Candidate({"x": x, "y": y}, z=z) for x, y, z in pending])


@pytest.mark.parametrize(("mean", "sigma", "best"), [(0.3, 0.5, 0.4), (-1.0, 0.3, 0.0), (2.0, 0.1, 1.0)])
def test_expected_improvement_agrees_with_quadrature(mean, sigma, best):
    slow, _ = quad(lambda f: (f - best) * norm.pdf(f, mean, sigma), best, mean + 12 * sigma, epsabs=1e-14)
    fast = float(log_expected_improvement(np.array([mean]), np.array([sigma]), best)[0])
    assert fast == pytest.approx(math.log(slow), abs=1e-6)


def test_log_expected_improvement_stays_finite_and_rising_where_the_plain_form_is_zero():
    u = np.array([-1e6, -1e4, -1000.0, -999.0, -100.0, -37.0, -5.001, -4.999, -1.0, 0.0, 5.0])
    h = log_h(u)
    assert np.isfinite(h).all()
    assert (np.diff(h) > 0).all()
    assert h[-2] == pytest.approx(math.log(norm.pdf(0)))


@given(st.floats(-30, 5), st.floats(0.05, 2))
def test_the_gradient_of_log_expected_improvement_agrees_with_finite_differences(mean, sigma):
    step = 1e-6
    _, slope_mean = log_ei_gradient(mean, sigma, 0.0, np.array([1.0]), np.array([0.0]))
    _, slope_sigma = log_ei_gradient(mean, sigma, 0.0, np.array([0.0]), np.array([1.0]))

    def value(m, s):
        return float(log_expected_improvement(np.array([m]), np.array([s]), 0.0)[0])

    assert slope_mean[0] == pytest.approx(
        (value(mean + step, sigma) - value(mean - step, sigma)) / (2 * step), rel=1e-3, abs=1e-3
    )
    assert slope_sigma[0] == pytest.approx(
        (value(mean, sigma + step) - value(mean, sigma - step)) / (2 * step), rel=1e-3, abs=1e-3
    )


@given(st.integers(0, 2**32 - 1))
def test_the_gradient_of_the_posterior_of_hyperparameters_agrees_with_finite_differences(seed):
    rng = np.random.default_rng(seed)
    X, Y, theta = rng.random((8, 3)), rng.standard_normal((8, 2)), rng.uniform(-1, 1, 3)
    D, prior = squared_gaps(X, [0, 1, 1]), Prior()
    _, gradient = plain.negative_log_posterior(theta, D, Y, prior)
    for i in range(3):
        up, down = theta.copy(), theta.copy()
        up[i] += 1e-6
        down[i] -= 1e-6
        slow = (
            plain.negative_log_posterior(up, D, Y, prior)[0] - plain.negative_log_posterior(down, D, Y, prior)[0]
        ) / 2e-6
        assert gradient[i] == pytest.approx(slow, rel=1e-3, abs=1e-4)


@given(st.integers(0, 2**32 - 1))
def test_the_gradient_over_hyperparameters_of_parameters_and_difficulty_agrees_with_finite_differences(seed):
    rng = np.random.default_rng(seed)
    XZ, y, theta = rng.random((8, 4)), rng.standard_normal(8), rng.uniform(-1, 1, 4)
    D, z, prior = squared_gaps(XZ, [0, 1, 1, 2]), XZ[:, -1] - XZ[:, -1].mean(), Prior()
    others = (D, TREND * np.outer(z, z), y, prior, Prior(length=2.0))
    _, gradient = negative_log_posterior(theta, *others)
    for i in range(4):
        up, down = theta.copy(), theta.copy()
        up[i] += 1e-6
        down[i] -= 1e-6
        slow = (negative_log_posterior(up, *others)[0] - negative_log_posterior(down, *others)[0]) / 2e-6
        assert gradient[i] == pytest.approx(slow, rel=1e-3, abs=1e-4)


def test_the_kernel_is_a_product_over_parameters_and_difficulty_and_a_trend():
    w = np.array([2.0, 0.5])
    gp = FidelityProcess(np.empty((0, 2)), np.empty((0, 1)), w, np.ones(1), 1e-3, np.zeros(1), 0.4)
    a, b = np.array([[0.1, 0.2]]), np.array([[0.6, 1.0]])

    def matern(r):
        return (1 + math.sqrt(5) * r + 5 * r * r / 3) * math.exp(-math.sqrt(5) * r)

    product = matern(2.0 * 0.5) * matern(0.5 * 0.8)
    assert gp.kinship(a, b)[0, 0] == pytest.approx(product)
    assert gp.correlation_between(a, b)[0, 0] == pytest.approx(product + 4.0 * -0.2 * 0.6)
    assert gp.prior_variance(b)[0] == pytest.approx(1 + 4.0 * 0.36)


def test_the_first_low_value_of_the_real_task_counts_against_the_difficulty_and_not_against_its_parameters():
    easy = [(x, 0.5, 0.1, math.exp(-((x - 0.6) ** 2) / 0.02), 0.2) for x in np.linspace(0, 1, 11)]
    model = ValueModel(BOX, record_of([*easy, (0.6, 0.5, 1.0, 0.2, 1.0)]), Fit(np.array([4.0, 4.0, 0.3]), 1e-4, 1.0))
    mean, _ = model.posterior(np.array([[0.6, 0.5], [0.1, 0.5]]), 1.0)
    assert mean[0] > mean[1] + 1.0


def test_the_fit_finds_the_parameter_that_matters_and_the_noise():
    rng = np.random.default_rng(0)
    X = rng.random((60, 2))
    y = np.sin(6 * X[:, [0]]) + 0.1 * rng.standard_normal((60, 1))
    found = fit_map(X, y, [0, 1], Prior())
    assert found.w[0] > 2 * found.w[1]
    assert 0.05 < found.amplitude * math.sqrt(found.noise) < 0.2


def test_leave_one_out_agrees_with_leaving_one_out():
    rng = np.random.default_rng(0)
    record = record_of([(*rng.random(2), z, rng.random(), 1.0) for z in (0.2, 1, 1, 0.5, 1, 1)])
    fitted = Fit(np.array([2.0, 2.0, 1.0]), 0.01, 1.0)
    mean, variance = ValueModel(BOX, record, fitted).gp.leave_one_out()
    gp = ValueModel(BOX, record, fitted).gp
    for i in range(6):
        rest = np.arange(6) != i
        slow = type(gp)(gp.X[rest], gp.Y[rest], gp.w, gp.amplitude, 0.01, gp.mean, gp.centre)
        m, v = slow.posterior(gp.X[[i]])
        assert mean[i] == pytest.approx(m[0])
        assert variance[i] == pytest.approx(v[0] + 0.01)


def test_the_maximum_of_a_known_function_is_found_in_a_mixed_space():
    space = Space({"a": Float(0, 1), "n": Int(0, 9), "b": Float(0, 1)})
    goal = np.array([0.31, 0.65, 0.87])  # the middle of the cell of n = 6

    found, value = maximise(
        space,
        lambda U: -np.square(space.snap(U) - goal).sum(1),
        lambda u: (-float(np.square(u - goal).sum()), -2 * (u - goal)),
        np.empty((0, 3)),
        np.random.default_rng(0),
    )
    assert found == pytest.approx(goal, abs=1e-4)
    assert value == pytest.approx(0, abs=1e-8)


def test_a_linear_trend_in_the_difficulty_is_taken_off():
    z = np.array([0.1, 0.4, 0.7, 1.0] * 5)
    scale = standardise(3 - 2 * z, z)
    assert scale.middle == pytest.approx(1.0, abs=0.05)
    assert scale.trend * scale.spread == pytest.approx(-2, abs=0.1)


def test_costs_are_learnt_from_observations():
    points = [(0.1 * i, 0.5, z, 0.0, 50 * (0.2 + 0.8 * z) ** 2) for i, z in enumerate((0.1, 0.3, 0.5, 0.8, 1.0, 0.2))]
    costs = CostModel(record_of(points))
    assert costs.at(1.0) == pytest.approx(50, rel=0.25)
    assert costs.at(0.1) == pytest.approx(50 * 0.28**2, rel=0.6)
    record = record_of(points, pending=[(0.5, 0.5, 1.0)])
    assert spent(record, costs) == pytest.approx(sum(p[4] for p in points) + costs.at(1.0))


def test_without_observations_costs_are_relative_to_the_real_task():
    assert CostModel(record_of([])).at(1.0) == pytest.approx(1.0)
    assert CostModel(record_of([])).at(0.0) == pytest.approx(0.2)


def test_an_observation_at_full_difficulty_tells_most_and_one_already_made_nothing_new():
    record = record_of([(0.5, 0.5, 0.2, 1.0, 0.3), (0.1, 0.9, 1.0, 0.2, 1.0)])
    model = ValueModel(BOX, record, Fit(np.array([2.0, 2.0, 1.0]), 1e-4, 1.0))
    far = model.informed(np.array([0.9, 0.1]), np.array([0.2, 0.6, 1.0]))
    assert far[0] < far[1] < far[2]
    assert far[2] == pytest.approx(1.0, abs=0.01)
    seen = model.informed(np.array([0.5, 0.5]), np.array([0.2, 0.6, 1.0]))
    assert seen[0] < 0.05 < seen[1]


@given(st.integers(0, 2**32 - 1))
def test_product_kernel_gradients_agree_with_finite_differences(seed):
    rng = np.random.default_rng(seed)
    gp = ProductProcess(
        rng.random((6, 3)), rng.standard_normal((6, 1)), rng.uniform(0.5, 3, 3), np.ones(1), 1e-3, np.zeros(1)
    )
    s, step = rng.random(3), 1e-6
    _, _, dm, dv = gp.gradient(s)
    for i in range(2):
        up, down = s.copy(), s.copy()
        up[i] += step
        down[i] -= step
        (mu, vu), (md, vd) = gp.posterior(up[None]), gp.posterior(down[None])
        assert (mu - md)[0, 0] / (2 * step) == pytest.approx(dm[0, i], abs=1e-4)
        assert (vu - vd)[0] / (2 * step) == pytest.approx(dv[i], abs=1e-4)


def hill(params, z):
    """Easy versions: higher values, broader, nearly the same place."""
    gap = (params["x"] - 0.7 + 0.05 * (1 - z)) ** 2 + (params["y"] - 0.2) ** 2
    return (1 + 0.5 * (1 - z)) * math.exp(-gap / (0.05 * (2 - z)))


def study(strategy, seed=0, batch=1, budget=12.0):
    made = make_strategy(strategy, BOX, settings={"cost_budget": budget})
    history = []
    while True:
        candidates = made.propose(history, [], batch, np.random.default_rng((seed, len(history))))
        if not candidates:
            return made, history
        history += [Observation(c, value=hill(c.params, c.z), cost=0.1 + 0.9 * c.z) for c in candidates]


@pytest.mark.parametrize("strategy", ["cmfbo", "boca", "top_k", "tpe_hyperband"])
def test_a_cost_budget_is_spent_and_not_much_overspent(strategy):
    _, history = study(strategy)
    assert 9 < sum(o.cost for o in history) < 13.1
    assert all(0 <= o.candidate.z <= 1 for o in history)


def test_cmfbo_answers_with_what_was_evaluated_at_full_difficulty_though_easy_values_are_higher():
    made, history = study("cmfbo")
    answer = history[made.recommend(history)]
    assert answer.candidate.z == 1
    assert max(o.value for o in history) > answer.value
    assert answer.value > 0.9


def test_cmfbo_starts_easy_and_ends_hard():
    _, history = study("cmfbo")
    z = [o.candidate.z for o in history]
    assert np.mean(z[:6]) < 0.6
    assert z[-3:] == [1.0, 1.0, 1.0]


def test_a_warm_start_comes_from_an_observation_that_is_complete_and_no_harder():
    _, history = study("cmfbo")
    parents = [(i, o.candidate.warm_start) for i, o in enumerate(history) if o.candidate.warm_start is not None]
    assert parents
    for i, parent in parents:
        assert parent < i
        assert history[parent].candidate.z <= history[i].candidate.z


def test_in_a_batch_no_point_is_asked_twice():
    _, history = study("cmfbo", batch=4)
    asked = {(o.candidate.params["x"], o.candidate.params["y"], o.candidate.z) for o in history}
    assert len(asked) == len(history)


@pytest.mark.parametrize("budget", [0.7, 1.5, 3.0, 6.0])
@pytest.mark.parametrize("batch", [1, 4])
def test_however_small_the_budget_cmfbo_ends_with_an_answer_at_full_difficulty(budget, batch):
    space = Space({f"x{i}": Float(0, 1) for i in range(12)})  # the start alone would cost 13 easy evaluations
    made = make_strategy("cmfbo", space, settings={"cost_budget": budget})
    history = []
    while found := made.propose(history, [], batch, np.random.default_rng(len(history))):
        history += [Observation(c, value=-c.params["x0"] - c.z, cost=0.1 + 0.9 * c.z) for c in found]
        assert len(history) < 40
    assert history[made.recommend(history)].candidate.z == 1
    assert sum(o.cost for o in history) < budget + batch


def test_pending_trials_count_against_the_budget_and_are_not_asked_again():
    made, history = study("cmfbo", budget=12.0)
    history = history[:8]
    pending = made.propose(history, [], 3, np.random.default_rng(0))
    more = made.propose(history, pending, 3, np.random.default_rng(0))
    asked = {(c.params["x"], c.params["y"], c.z) for c in [*pending, *more]}
    assert len(asked) == 6
    left = 12.0 - sum(o.cost for o in history)
    running = [Candidate({"x": 0.1 + i / 40, "y": 0.5}, z=1.0) for i in range(math.ceil(left) + 1)]
    assert made.propose(history, running, 1, np.random.default_rng(0)) == []


def test_published_cmfbo_answers_over_all_difficulties_as_printed():
    made = make_strategy("cmfbo", BOX, settings={"variant": "published"})
    history = [
        Observation(Candidate({"x": 0.1, "y": 0.1}, z=0.1), value=1.4, cost=0.2),
        Observation(Candidate({"x": 0.2, "y": 0.1}, z=1.0), value=0.9, cost=1.0),
    ]
    assert made.recommend(history) == 0
    assert make_strategy("cmfbo", BOX).recommend(history) == 1


def test_hyperband_promotes_the_best_third_with_the_very_same_parameters():
    _, history = study("tpe_hyperband", budget=20.0)
    promoted = [o for o in history if o.candidate.info["mode"] == "promote"]
    assert promoted
    for o in promoted:
        parent = history[o.candidate.warm_start].candidate
        assert parent.params == o.candidate.params
        assert parent.z == pytest.approx(o.candidate.z / 3)


def test_top_k_takes_the_best_of_the_short_round_to_the_end():
    _, history = study("top_k", budget=10.0)
    short = sorted((o.value for o in history if o.candidate.z < 1), reverse=True)
    ends = [history[o.candidate.warm_start].value for o in history if o.candidate.z == 1]
    assert ends == short[: len(ends)]
    assert len(ends) >= 3
