"""Algorithm 1 of Yin et al. 2021 against hand-worked values and slow obvious versions."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm
from search_cases import facing, history_of, jump_space

from search import Candidate, Features, Float, Observation, Space, make_strategy
from search.bds.published import Hyperparameters, PublishedModel, diversify, explore, fit, from_outputs, to_outputs

LINE = Features.euclidean(1, low=-1, high=1)


def line_model(believed=()):
    X, F = np.array([[0.1], [0.5], [0.9]]), np.array([[-0.5], [0.2], [0.6]])
    fitted = Hyperparameters(np.array([[3.0]]), np.array([0.8]), np.array([1e-4]), ())
    return PublishedModel(LINE, fitted, X, F, np.array(believed, dtype=float).reshape(-1, 1))


def test_monte_carlo_distance_agrees_with_quadrature_in_one_dimension():
    model = line_model()
    U, known = np.array([[0.3], [0.7]]), np.array([[-0.5], [0.6]])
    mean, deviation = model.posterior(U)
    normals = np.random.default_rng(0).standard_normal((20000, 1))
    fast = model.expected_distance(U, known, normals)
    for i in range(2):
        slow, _ = quad(
            lambda y, i=i: min(abs(y + 0.5), abs(y - 0.6)) * norm.pdf(y, mean[i, 0], deviation[i, 0]), -6, 6, limit=200
        )
        assert fast[i] == pytest.approx(slow, rel=0.02)


def test_exploration_finds_the_largest_deviation_of_a_dense_grid():
    model = line_model()
    grid = np.linspace(0, 1, 2001)[:, None]
    u, value = explore(model, 1, np.random.default_rng(0))
    assert value == pytest.approx(float(model.posterior(grid)[1].max()), rel=1e-4)
    assert model.deviation(u)[0] == pytest.approx(value)


def test_diversifying_finds_the_largest_expected_distance_of_a_dense_grid():
    model, known = line_model(), np.array([[-0.5], [0.2], [0.6]])
    normals = np.random.default_rng(0).standard_normal((64, 1))
    grid = np.linspace(0, 1, 2001)[:, None]
    _, value = diversify(model, known, normals, Space({"x": Float(0, 1)}), 300)
    assert value == pytest.approx(float(model.expected_distance(grid, known, normals).max()), rel=1e-3)


def test_a_believed_point_lowers_the_deviation_and_leaves_the_mean():
    before, after = line_model(), line_model(believed=[[0.3]])
    U = np.array([[0.28], [0.7]])
    assert np.allclose(after.posterior(U)[0], before.posterior(U)[0], atol=1e-6)
    assert after.posterior(U)[1][0, 0] < 0.5 * before.posterior(U)[1][0, 0]


@pytest.mark.parametrize(
    "metric", [Features.circle(), Features.rotation(), Features.euclidean(2, low=[0, -5], high=[1, 3])]
)
def test_outputs_and_back_is_the_identity(metric):
    rng = np.random.default_rng(0)
    Y = (
        rng.standard_normal((20, 4))
        if metric.kind == "rotation"
        else rng.uniform(metric.low, metric.high, (20, metric.d))
    )
    Y = metric.canonical(Y)
    F = to_outputs(metric, Y)
    assert np.abs(F).max() <= 1 + 1e-12
    assert metric.distance(from_outputs(metric, F), Y).max() < 1e-6


def test_the_fit_finds_the_dimension_that_matters():
    rng = np.random.default_rng(0)
    X = rng.random((40, 2))
    found = fit(X, np.sin(5 * X[:, [0]]))
    assert found.w[0, 0] > 3 * found.w[0, 1]
    assert found.noise[0] < 1e-2


def test_three_explorations_alternate_with_three_diversifications():
    space = jump_space()
    strategy = make_strategy("bds", space, features=Features.circle(), settings={"variant": "published"})
    history, modes = [], []
    for i in range(13):
        (c,) = strategy.propose(history, [], 1, np.random.default_rng(i))
        modes.append(c.info["mode"])
        history.append(Observation(c, 1.0, facing(c.params), 1.0))
    assert modes == ["start"] + ["explore"] * 2 + ["diversify"] * 3 + ["explore"] * 3 + ["diversify"] * 3 + ["explore"]


def test_a_pending_trial_is_not_proposed_again():
    space = jump_space()
    strategy = make_strategy("bds", space, features=Features.circle(), settings={"variant": "published"})
    history = history_of(space, 8, seed=0)
    (first,) = strategy.propose(history, [], 1, np.random.default_rng(0))
    (second,) = strategy.propose(history, [Candidate(first.params)], 1, np.random.default_rng(0))
    assert np.abs(space.to_unit(first.params) - space.to_unit(second.params)).max() > 0.05


def test_a_fit_that_breaks_falls_back_and_says_so(monkeypatch):
    import search.bds.published as module

    def broken(X, F):
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(module, "_fit_botorch", broken)
    space = jump_space()
    strategy = make_strategy("bds", space, features=Features.circle(), settings={"variant": "published"})
    (c,) = strategy.propose(history_of(space, 8, seed=0), [], 1, np.random.default_rng(0))
    assert c.info["warnings"] == ["fit failed: singular"]
