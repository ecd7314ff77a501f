import math
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from search.surrogate.gp import GaussianProcess, IllConditioned, matern52, robust_cholesky


def dense(X, Y, S, w, amplitude, noise, mean):
    """The posterior by the book: explicit loops and a dense inverse."""

    def k(a, b):
        r = math.sqrt(sum(((x - y) * v) ** 2 for x, y, v in zip(a, b, w, strict=True)))
        return amplitude**2 * (1 + math.sqrt(5) * r + 5 * r * r / 3) * math.exp(-math.sqrt(5) * r)

    K = np.array([[k(a, b) for b in X] for a in X]) + noise * amplitude**2 * np.eye(len(X))
    inverse = np.linalg.inv(K)
    cross = np.array([[k(s, x) for x in X] for s in S])
    means = mean + cross @ inverse @ (Y - mean)
    return means, np.array([amplitude**2 - c @ inverse @ c for c in cross])


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 4))
def test_the_posterior_agrees_with_a_dense_solve(seed, n, e):
    rng = np.random.default_rng(seed)
    X, S, Y, w = rng.random((n, e)), rng.random((5, e)), rng.standard_normal((n, 1)), rng.uniform(0.5, 5, e)
    gp = GaussianProcess(X, Y, w, np.array([1.7]), 0.01, np.array([0.3]))
    mean, variance = gp.posterior(S)
    slow_mean, slow_variance = dense(X, Y[:, 0], S, w, 1.7, 0.01, 0.3)
    assert np.allclose(mean[:, 0], slow_mean, atol=1e-8)
    assert np.allclose(gp.mean_at(S)[:, 0], slow_mean, atol=1e-8)
    assert np.allclose(1.7**2 * variance, slow_variance, atol=1e-8)


@given(st.integers(0, 2**32 - 1))
def test_posterior_gradients_agree_with_finite_differences(seed):
    rng = np.random.default_rng(seed)
    gp = GaussianProcess(
        rng.random((7, 3)), rng.standard_normal((7, 2)), rng.uniform(0.5, 4, 3), np.ones(2), 1e-3, np.zeros(2)
    )
    s, step = rng.random(3), 1e-6
    _, _, dm, dv = gp.gradient(s)
    for i in range(3):
        up, down = s.copy(), s.copy()
        up[i] += step
        down[i] -= step
        (mu, vu), (md, vd) = gp.posterior(up[None]), gp.posterior(down[None])
        assert (mu - md)[0] / (2 * step) == pytest.approx(dm[:, i], abs=1e-4)
        assert (vu - vd)[0] / (2 * step) == pytest.approx(dv[i], abs=1e-4)


@given(st.integers(0, 2**32 - 1))
def test_the_order_of_data_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    X, Y, S = rng.random((9, 2)), rng.standard_normal((9, 1)), rng.random((4, 2))
    order = rng.permutation(9)
    one = GaussianProcess(X, Y, np.full(2, 2.0), np.ones(1), 1e-3, np.zeros(1)).posterior(S)
    other = GaussianProcess(X[order], Y[order], np.full(2, 2.0), np.ones(1), 1e-3, np.zeros(1)).posterior(S)
    assert np.allclose(one[0], other[0], atol=1e-9)
    assert np.allclose(one[1], other[1], atol=1e-9)


def test_adding_data_equals_starting_with_it():
    rng = np.random.default_rng(0)
    X, Y, S = rng.random((6, 2)), rng.standard_normal((6, 1)), rng.random((4, 2))
    settings = (np.full(2, 2.0), np.ones(1))
    whole = GaussianProcess(X, Y, *settings, 1e-3, np.zeros(1)).posterior(S)
    grown = GaussianProcess(X[:4], Y[:4], *settings, 1e-3, np.zeros(1)).with_data(X[4:], Y[4:], 1e-3).posterior(S)
    assert np.allclose(whole[0], grown[0])
    assert np.allclose(whole[1], grown[1])


def test_hand_worked_correlations():
    assert matern52(np.array([0.0, 1.0])) == pytest.approx([1.0, (1 + 5**0.5 + 5 / 3) * math.exp(-(5**0.5))])


def test_no_data_give_the_prior():
    gp = GaussianProcess(np.empty((0, 2)), np.empty((0, 1)), np.ones(2), np.ones(1), 1e-3, np.array([0.7]))
    mean, variance = gp.posterior(np.zeros((3, 2)))
    assert mean[:, 0].tolist() == [0.7] * 3
    assert variance.tolist() == [1.0] * 3


def test_a_singular_matrix_is_factored_with_jitter():
    L = robust_cholesky(np.ones((4, 4)))
    assert np.allclose(L @ L.T, np.ones((4, 4)), atol=1e-6)


def test_a_matrix_that_is_not_positive_definite_warns_and_never_raises():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        L = robust_cholesky(np.array([[1.0, 2.0], [2.0, 1.0]]))
    assert np.isfinite(L).all()
    assert [w.category for w in caught] == [IllConditioned]
