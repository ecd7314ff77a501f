"""Hyperparameters by maximum a posteriori: what a few points can support, and no more.

Maximum likelihood with ten points picks length scales at random; priors keep them where search spaces usually have
them. The amplitude is integrated out under an inverse-gamma prior, which leaves ``w`` and the noise to optimise:

    -log p = (a + n k) / 2 log(b + tr(Y' K^-1 Y)) + k / 2 log |K| - log p(w) - log p(noise)
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.optimize import minimize

from search.surrogate.gp import ROOT5, Array


@dataclass(frozen=True, slots=True)
class Prior:
    """Priors of a fit.

    Args:
        length: median of the length scales, in model coordinates (a parameter's range is 1).
        length_spread: standard deviation of their logarithm.
        noise: median of the noise's variance relative to the amplitude's square.
        noise_spread: standard deviation of its logarithm.
        amplitude: prior mode of the amplitude.
        amplitude_weight: how many observations' worth that mode counts.
    """

    length: float = 0.5
    length_spread: float = 0.7
    noise: float = 1e-3
    noise_spread: float = 1.5
    amplitude: float = 1.0
    amplitude_weight: float = 4.0


def keep(prior: Prior) -> Prior:
    """The prior as it is."""
    return prior


def flat(prior: Prior) -> Prior:
    """The same start and bounds without an opinion: maximum likelihood. Benchmarks measure with it what priors give."""
    return replace(prior, length_spread=1e3, noise_spread=1e3, amplitude_weight=1e-6)


@dataclass(frozen=True, slots=True)
class Fit:
    """What a fit found.

    Args:
        w: ``e`` inverse length scales, one for each model coordinate.
        noise: relative to the squared amplitude.
        amplitude: standard deviation, shared by all outputs.
        warnings: what went wrong, for the record.
    """

    w: Array
    noise: float
    amplitude: float
    warnings: tuple[str, ...] = ()


def squared_gaps(X: Array, owner: Sequence[int]) -> Array:
    """Squared distances ``p x n x n`` of each of ``p`` parameters, from ``n x e`` model coordinates."""
    groups = max(owner) + 1
    out = np.zeros((groups, len(X), len(X)))
    for j, p in enumerate(owner):
        gap = X[:, j][:, None] - X[:, j][None, :]
        out[p] += gap * gap
    return out


def negative_log_posterior(theta: Array, D: Array, Y: Array, prior: Prior) -> tuple[float, Array]:
    """Up to a constant, and its gradient.

    Args:
        theta: ``p + 1``: logarithms of the inverse length scales and of the noise.
        D: ``p x n x n`` squared gaps.
        Y: ``n x k`` centred outputs.
        prior: what is thought beforehand.
    """
    n, k = Y.shape
    w2, noise = np.exp(2 * theta[:-1]), math.exp(theta[-1])
    r = np.sqrt(np.maximum(np.tensordot(w2, D, axes=1), 0.0))
    decay = np.exp(-ROOT5 * r)
    K = (1 + ROOT5 * r + 5 / 3 * r * r) * decay
    K[np.diag_indices(n)] += noise + 1e-8
    L = cholesky(K, lower=True, check_finite=False)
    inverse = cho_solve((L, True), np.eye(n), check_finite=False)
    alpha = inverse @ Y
    a = prior.amplitude_weight
    b = a * prior.amplitude**2
    total = b + float(np.sum(Y * alpha))
    lw = (theta[:-1] + math.log(prior.length)) / prior.length_spread
    ln = (theta[-1] - math.log(prior.noise)) / prior.noise_spread
    value = (
        0.5 * (a + n * k) * math.log(total) + k * float(np.log(np.diag(L)).sum()) + 0.5 * float(lw @ lw) + 0.5 * ln * ln
    )
    M = k * inverse - (a + n * k) / total * (alpha @ alpha.T)
    G = M * (-(5 / 3) * (1 + ROOT5 * r) * decay)
    gradient = np.empty_like(theta)
    gradient[:-1] = 0.5 * np.einsum("ij,pij->p", G, D, optimize=True) * w2 + lw / prior.length_spread
    gradient[-1] = 0.5 * float(np.trace(M)) * noise + ln / prior.noise_spread
    return value, gradient


def fit_map(X: Array, Y: Array, owner: Sequence[int], prior: Prior, *, steps: int = 40) -> Fit:
    """The most probable hyperparameters of ``k`` outputs that share them.

    Args:
        X: ``n x e`` model coordinates.
        Y: ``n x k`` outputs, their prior mean taken off.
        owner: for each model coordinate the parameter it belongs to; coordinates of a parameter share a length scale.
        prior: what is thought beforehand.
        steps: L-BFGS iterations at most.

    Returns:
        The fit; where it can't be computed, the priors' own values with a warning.
    """
    owner = list(owner)
    p = max(owner) + 1
    start = np.append(np.full(p, -math.log(prior.length)), math.log(prior.noise))
    fallback = Fit(np.exp(start[:-1])[owner], prior.noise, prior.amplitude)
    if len(X) < 2:
        return fallback
    D = squared_gaps(X, owner)
    bounds = [(-math.log(prior.length) - 4, -math.log(prior.length) + 3.5)] * p + [(math.log(1e-6), math.log(2.0))]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a line search may overflow on its way; it turns back
            found = minimize(
                negative_log_posterior,
                start,
                (D, Y, prior),
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
                options={"maxiter": steps},
            )
        theta = np.asarray(found.x)
        w, noise = np.exp(theta[:-1])[owner], math.exp(theta[-1])
        amplitude = _amplitude(theta, D, Y, prior)
    except (np.linalg.LinAlgError, ValueError) as error:
        return Fit(fallback.w, fallback.noise, fallback.amplitude, (f"surrogate not fitted, priors used: {error}",))
    if not (np.isfinite(theta).all() and math.isfinite(amplitude)):
        return Fit(fallback.w, fallback.noise, fallback.amplitude, ("surrogate not fitted, priors used: not finite",))
    return Fit(w, noise, amplitude)


def _amplitude(theta: Array, D: Array, Y: Array, prior: Prior) -> float:
    """The mean of the amplitude given the rest: sqrt((b + tr(Y' K^-1 Y)) / (a + n k))."""
    n, k = Y.shape
    r = np.sqrt(np.maximum(np.tensordot(np.exp(2 * theta[:-1]), D, axes=1), 0.0))
    K = (1 + ROOT5 * r + 5 / 3 * r * r) * np.exp(-ROOT5 * r)
    K[np.diag_indices(n)] += math.exp(theta[-1]) + 1e-8
    L = cholesky(K, lower=True, check_finite=False)
    total = float(np.sum(Y * cho_solve((L, True), Y, check_finite=False)))
    a = prior.amplitude_weight
    return math.sqrt((a * prior.amplitude**2 + total) / (a + n * k))
