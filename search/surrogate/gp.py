"""Exact Gaussian-process posteriors with a Matern 5/2 kernel, in numpy.

Glossary: ``X`` ``n x e`` model coordinates of the data, ``Y`` ``n x k`` outputs that share one kernel, ``S`` ``m x e``
where to predict, ``w`` ``e`` inverse length scales, ``K`` the correlation matrix with noise, ``L`` its Cholesky factor.
Amplitudes and means are per output; the noise is relative to the amplitude.
"""

from __future__ import annotations

import math
import warnings
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

Array = NDArray[np.float64]

ROOT5 = math.sqrt(5)
JITTERS = (0.0, 1e-8, 1e-6, 1e-4, 1e-2)


class IllConditioned(UserWarning):
    """A correlation matrix needed more jitter than rounding explains, or hyperparameters could not be fitted."""


def scaled_distance(A: Array, B: Array, w: Array) -> Array:
    """Euclidean distances ``n x m`` after multiplying each coordinate by its inverse length scale."""
    A, B = A * w, B * w
    square = (A * A).sum(1)[:, None] + (B * B).sum(1)[None, :] - 2 * A @ B.T
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def matern52(r: Array) -> Array:
    """Matern 5/2 correlation of scaled distances: (1 + sqrt(5) r + 5 r^2 / 3) exp(-sqrt(5) r)."""
    a = ROOT5 * r
    return np.asarray((1 + a + a * a / 3) * np.exp(-a))


def robust_cholesky(K: Array) -> Array:
    """Lower Cholesky factor, with the least jitter from a ladder that makes it exist.

    Warns:
        IllConditioned: jitter above 1e-6 was needed.
    """
    for jitter in JITTERS:
        try:
            L = cholesky(K + jitter * np.eye(len(K)), lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            continue
        if np.isfinite(L).all():
            if jitter > 1e-6:
                warnings.warn(f"a correlation matrix needed jitter {jitter:g}", IllConditioned, stacklevel=2)
            return np.asarray(L)
    warnings.warn("a correlation matrix could not be factored; its data are ignored", IllConditioned, stacklevel=2)
    return np.eye(len(K)) * 1e6


class GaussianProcess:
    """The posterior of ``k`` outputs that share kernel and noise.

    Args:
        X: ``n x e``; n may be 0.
        Y: ``n x k``.
        w: ``e`` inverse length scales.
        amplitude: ``k`` prior standard deviations.
        noise: variance of the noise as a fraction of the amplitude's square; scalar or ``n``.
        mean: ``k`` prior means.
    """

    def __init__(self, X: Array, Y: Array, w: Array, amplitude: Array, noise: float | Array, mean: Array) -> None:
        self.X, self.Y, self.w = X, Y, w
        self.amplitude, self.mean = amplitude, mean
        self.noise = np.broadcast_to(np.asarray(noise, dtype=float), (len(X),))
        K = self.correlation_between(X, X)
        K[np.diag_indices_from(K)] = self.prior_variance(X) + self.noise
        self.L = robust_cholesky(K) if len(X) else np.empty((0, 0))
        self.alpha = self._solve(Y - mean)

    def _solve(self, B: Array) -> Array:
        """K^-1 B, ``n x k``."""
        return np.asarray(cho_solve((self.L, True), B, check_finite=False)) if len(self.X) else B

    def correlation(self, S: Array) -> Array:
        """Prior correlation with the data, ``m x n``."""
        return self.correlation_between(S, self.X)

    def correlation_between(self, A: Array, B: Array) -> Array:
        """Prior correlation of ``n x e`` with ``m x e`` points, ``n x m``."""
        return matern52(scaled_distance(A, B, self.w))

    def prior_variance(self, S: Array) -> Array:
        """Before any data, relative to the amplitude's square, ``m``."""
        return np.ones(len(S))

    def posterior(self, S: Array) -> tuple[Array, Array]:
        """Mean ``m x k`` and latent variance relative to the amplitude's square, ``m``."""
        if not len(self.X):
            return self.mean_at(S), self.prior_variance(S)
        k = self.correlation(S)
        V = solve_triangular(self.L, k.T, lower=True, check_finite=False)
        return k @ self.alpha + self.mean, np.maximum(self.prior_variance(S) - (V * V).sum(0), 1e-12)

    def mean_at(self, S: Array) -> Array:
        """The posterior's mean alone, ``m x k``: without its variance many points cost neither time nor memory."""
        if not len(self.X):
            return np.tile(self.mean, (len(S), 1))
        return np.asarray(self.correlation(S) @ self.alpha + self.mean)

    def leave_one_out(self) -> tuple[Array, Array]:
        """Each datum predicted from all the others: mean ``n x k`` and variance, noise included, relative, ``n``.

        Rasmussen and Williams 2006, equations 5.10 to 5.12.
        """
        precision = np.diag(self._solve(np.eye(len(self.X))))
        return self.Y - self.alpha / precision[:, None], 1 / precision

    def covariance(self, S: Array) -> Array:
        """Latent posterior covariance ``m x m`` relative to the amplitude's square."""
        prior = self.correlation_between(S, S)
        if not len(self.X):
            return prior
        V = solve_triangular(self.L, self.correlation(S).T, lower=True, check_finite=False)
        return np.asarray(prior - V.T @ V)

    def gradient(self, s: Array) -> tuple[Array, float, Array, Array]:
        """At one point ``e``: mean ``k``, relative variance, and their gradients ``k x e`` and ``e``."""
        if not len(self.X):
            return self.mean, 1.0, np.zeros((len(self.mean), len(s))), np.zeros(len(s))
        r = scaled_distance(s[None, :], self.X, self.w)[0]
        k = matern52(r)
        # dk/ds = -(5/3) (1 + sqrt(5) r) exp(-sqrt(5) r) w^2 (s - x)
        slope = -(5 / 3) * (1 + ROOT5 * r) * np.exp(-ROOT5 * r)
        dk = slope[:, None] * (s - self.X) * (self.w * self.w)
        beta = self._solve(k[:, None])[:, 0]
        variance = max(1 - float(k @ beta), 1e-12)
        return self.mean + k @ self.alpha, variance, self.alpha.T @ dk, -2 * beta @ dk

    def given(self, X: Array, Y: Array, noise: float | Array) -> Self:
        """The same hyperparameters with other data, ``p x e`` and ``p x k``."""
        return type(self)(X, Y, self.w, self.amplitude, noise, self.mean)

    def with_data(self, X: Array, Y: Array, noise: float | Array) -> Self:
        """The same hyperparameters with more data, ``p x e`` and ``p x k``."""
        more = np.broadcast_to(np.asarray(noise, dtype=float), (len(X),))
        return self.given(np.concatenate([self.X, X]), np.concatenate([self.Y, Y]), np.concatenate([self.noise, more]))
