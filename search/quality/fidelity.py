"""A Gaussian process over parameters and difficulty, and its hyperparameters by maximum a posteriori.

Glossary: ``XZ`` ``n x (e + 1)`` model coordinates, the difficulty last; ``w`` inverse length scales likewise; zbar the
mean difficulty of the data. The kernel, relative to the squared amplitude, is

    k((x, z), (x', z')) = M(x, x') M(z, z') + TREND (z - zbar) (z' - zbar)

with M the Matern 5/2 correlation. The product says how much of what is seen at one difficulty holds at another; the
second part, that values rise or fall with the difficulty by an unknown amount that is the same everywhere. Without it,
the first observation of the real task, lower than the easy ones as values of real tasks are, would look like bad luck
with these parameters.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Self

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.optimize import minimize

from search.surrogate.fit import Fit, Prior, squared_gaps
from search.surrogate.gp import ROOT5, Array, GaussianProcess, matern52, scaled_distance

TREND = 4.0
"""Prior variance of the slope over the difficulty, relative to the squared amplitude."""


class ProductProcess(GaussianProcess):
    """A Gaussian process with k_X(x, x') k_Z(z, z'), the difficulty being the last coordinate."""

    def correlation_between(self, A: Array, B: Array) -> Array:
        """The product of the two Matern kernels, ``n x m``."""
        x = matern52(scaled_distance(A[:, :-1], B[:, :-1], self.w[:-1]))
        return np.asarray(x * matern52(scaled_distance(A[:, -1:], B[:, -1:], self.w[-1:])))

    def gradient(self, s: Array) -> tuple[Array, float, Array, Array]:
        """At one point ``e``: mean ``k``, relative variance, and their gradients in x (zero in z)."""
        if not len(self.X):
            return super().gradient(s)
        k = self.correlation(s[None, :])[0]
        r = scaled_distance(s[None, :-1], self.X[:, :-1], self.w[:-1])[0]
        kz = matern52(scaled_distance(s[None, -1:], self.X[:, -1:], self.w[-1:]))[0]
        slope = -(5 / 3) * (1 + ROOT5 * r) * np.exp(-ROOT5 * r) * kz
        dk = np.zeros((len(self.X), len(s)))
        dk[:, :-1] = slope[:, None] * (s[:-1] - self.X[:, :-1]) * self.w[:-1] ** 2
        beta = self._solve(k[:, None])[:, 0]
        variance = max(float(self.prior_variance(s[None, :])[0]) - float(k @ beta), 1e-12)
        return self.mean + k @ self.alpha, variance, self.alpha.T @ dk, -2 * beta @ dk


class FidelityProcess(ProductProcess):
    """The product kernel with a trend over the difficulty; arguments as of `GaussianProcess`.

    Args:
        centre: the mean difficulty zbar of the data that hyperparameters were fitted to; the rest as its parent.
        trend: prior variance of the slope over the difficulty; 0 leaves the product alone.
    """

    def __init__(
        self,
        X: Array,
        Y: Array,
        w: Array,
        amplitude: Array,
        noise: float | Array,
        mean: Array,
        centre: float = 1.0,
        trend: float = TREND,
    ) -> None:
        self.centre, self.trend = centre, trend
        super().__init__(X, Y, w, amplitude, noise, mean)

    def kinship(self, A: Array, B: Array) -> Array:
        """The product part alone, ``n x m``: how alike two evaluations are, in [0, 1]."""
        return super().correlation_between(A, B)

    def correlation_between(self, A: Array, B: Array) -> Array:
        """Both parts, ``n x m``."""
        a, b = A[:, -1] - self.centre, B[:, -1] - self.centre
        return np.asarray(super().correlation_between(A, B) + self.trend * a[:, None] * b[None, :])

    def prior_variance(self, S: Array) -> Array:
        """1 and the trend's share, ``m``."""
        return np.asarray(1 + self.trend * (S[:, -1] - self.centre) ** 2)

    def given(self, X: Array, Y: Array, noise: float | Array) -> Self:
        """The same hyperparameters with other data, ``p x (e + 1)`` and ``p x k``."""
        return type(self)(X, Y, self.w, self.amplitude, noise, self.mean, self.centre, self.trend)


def _matern_and_slope(square: Array) -> tuple[Array, Array]:
    """Matern 5/2 of squared scaled distances, and its derivative by them."""
    a = ROOT5 * np.sqrt(np.maximum(square, 0.0))
    decay = np.exp(-a)
    return (1 + a + a * a / 3) * decay, -(5 / 6) * (1 + a) * decay


def negative_log_posterior(
    theta: Array, D: Array, T: Array, y: Array, prior: Prior, link: Prior
) -> tuple[float, Array]:
    """Up to a constant, and its gradient; amplitude integrated out as in `search.surrogate.fit`.

    Args:
        theta: ``p + 2``: logarithms of the inverse length scales of parameters, of the difficulty's, and of the noise.
        D: ``(p + 1) x n x n`` squared gaps, the difficulty's last.
        T: ``n x n``, the trend's part of the kernel.
        y: ``n`` standardised values.
        prior: of the parameters' length scales, noise and amplitude.
        link: of the difficulty's length scale.
    """
    n = len(y)
    w2, noise = np.exp(2 * theta[:-1]), math.exp(theta[-1])
    Mx, dMx = _matern_and_slope(np.tensordot(w2[:-1], D[:-1], axes=1))
    Mz, dMz = _matern_and_slope(w2[-1] * D[-1])
    K = Mx * Mz + T
    K[np.diag_indices(n)] += noise + 1e-8
    L = cholesky(K, lower=True, check_finite=False)
    inverse = cho_solve((L, True), np.eye(n), check_finite=False)
    alpha = inverse @ y
    a, b = prior.amplitude_weight, prior.amplitude_weight * prior.amplitude**2
    total = b + float(y @ alpha)
    gaps = np.empty(len(theta))
    gaps[:-2] = (theta[:-2] + math.log(prior.length)) / prior.length_spread
    gaps[-2] = (theta[-2] + math.log(link.length)) / link.length_spread
    gaps[-1] = (theta[-1] - math.log(prior.noise)) / prior.noise_spread
    value = 0.5 * (a + n) * math.log(total) + float(np.log(np.diag(L)).sum()) + 0.5 * float(gaps @ gaps)
    M = inverse - (a + n) / total * np.outer(alpha, alpha)
    gradient = np.empty_like(theta)
    # d square / d log w = 2 square; the trace with M halves it again
    gradient[:-2] = np.einsum("ij,pij->p", M * dMx * Mz, D[:-1], optimize=True) * w2[:-1]
    gradient[-2] = float(np.sum(M * Mx * dMz * D[-1])) * w2[-1]
    gradient[-1] = 0.5 * float(np.trace(M)) * noise
    spreads = np.array([prior.length_spread] * (len(theta) - 2) + [link.length_spread, prior.noise_spread])
    return value, gradient + gaps / spreads


def fit_fidelity(
    XZ: Array, y: Array, owner: Sequence[int], prior: Prior, link: Prior, *, trend: float = TREND, steps: int = 40
) -> Fit:
    """The most probable hyperparameters.

    Args:
        XZ: ``n x (e + 1)`` model coordinates.
        y: ``n`` standardised values.
        owner: for each of the ``e`` coordinates the parameter it belongs to.
        prior: of the parameters' length scales, noise and amplitude.
        link: of the difficulty's length scale.
        trend: prior variance of the slope over the difficulty.
        steps: L-BFGS iterations at most.

    Returns:
        The fit; where it can't be computed, the priors' own values with a warning.
    """
    which = [*owner, max(owner) + 1]
    p = max(owner) + 1
    start = np.concatenate([np.full(p, -math.log(prior.length)), [-math.log(link.length)], [math.log(prior.noise)]])
    fallback = Fit(np.exp(start[:-1])[which], prior.noise, prior.amplitude)
    if len(XZ) < 2:
        return fallback
    D = squared_gaps(XZ, which)
    z = XZ[:, -1] - XZ[:, -1].mean()
    T = trend * np.outer(z, z)
    bounds = [(v - 4, v + 3.5) for v in start[:-1]] + [(math.log(1e-6), math.log(2.0))]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a line search may overflow on its way; it turns back
            found = minimize(
                negative_log_posterior,
                start,
                (D, T, y, prior, link),
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
                options={"maxiter": steps},
            )
        theta = np.asarray(found.x)
        amplitude = _amplitude(theta, D, T, y, prior)
    except (np.linalg.LinAlgError, ValueError) as error:
        return Fit(fallback.w, fallback.noise, fallback.amplitude, (f"surrogate not fitted, priors used: {error}",))
    if not (np.isfinite(theta).all() and math.isfinite(amplitude)):
        return Fit(fallback.w, fallback.noise, fallback.amplitude, ("surrogate not fitted, priors used: not finite",))
    return Fit(np.exp(theta[:-1])[which], math.exp(theta[-1]), amplitude)


def _amplitude(theta: Array, D: Array, T: Array, y: Array, prior: Prior) -> float:
    """The mean of the amplitude given the rest: sqrt((b + y' K^-1 y) / (a + n))."""
    w2 = np.exp(2 * theta[:-1])
    K = _matern_and_slope(np.tensordot(w2[:-1], D[:-1], axes=1))[0] * _matern_and_slope(w2[-1] * D[-1])[0] + T
    K[np.diag_indices(len(y))] += math.exp(theta[-1]) + 1e-8
    v = solve_triangular(cholesky(K, lower=True, check_finite=False), y, lower=True, check_finite=False)
    a = prior.amplitude_weight
    return math.sqrt((a * prior.amplitude**2 + float(v @ v)) / (a + len(y)))
