"""The surrogate of the objective over parameters and difficulty.

Glossary: ``y`` values, standardised after a linear trend in the difficulty is taken off; ``xz`` model coordinates of
the parameters followed by one for the difficulty; ``mu`` and ``sigma`` the posterior of the latent objective.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from search.quality.fidelity import TREND, FidelityProcess, fit_fidelity
from search.record import Record
from search.space import Array, Space
from search.surrogate.fit import Fit, Prior, keep
from search.surrogate.subset import farthest_first

FIT_POINTS = 200
MODEL_POINTS = 450
LENGTH = 0.6
"""Prior median of the length scales, relative to what is asked for. A shorter, narrower prior than 1 was better."""
LINK = 3.0
"""Prior median of the difficulty's length scale, likewise: an easy task is thought to tell much of the real one."""


@dataclass(frozen=True, slots=True)
class Scale:
    """How values were standardised: value = (y + trend (z - 1)) * spread + middle."""

    middle: float
    spread: float
    trend: float

    def to_y(self, value: Array, z: Array) -> Array:
        """Values -> standardised residuals."""
        return np.asarray((value - self.middle) / self.spread - self.trend * (z - 1))


def standardise(value: Array, z: Array, *, trend: bool = True) -> Scale:
    """Median-free and plain: mean and deviation after a ridge regression on the difficulty, or without a `trend`."""
    if not len(value):
        return Scale(0.0, 1.0, 0.0)
    gap = z - z.mean()
    slope = float(gap @ (value - value.mean()) / (gap @ gap + 0.1)) if trend else 0.0
    middle = float(value.mean() + slope * (1 - z.mean()))
    spread = float(np.std(value - slope * gap)) if len(value) > 1 else 0.0
    spread = spread if spread > 1e-12 else 1.0
    return Scale(middle, spread, slope / spread)


def imputed(record: Record) -> Array:
    """Values, ``n``, with failures given the worst value seen: a failed training is no better than the worst one."""
    good = record.complete & ~np.isnan(record.value)
    worst = float(record.value[good].min()) if good.any() else 0.0
    return np.where(good, record.value, worst)


def choose_rows(E: Array, value: Array, z: Array, size: int) -> NDArray[np.int64]:
    """Which observations to keep: half of them the best of the highest difficulty seen, the rest spread out."""
    if len(E) <= size:
        return np.arange(len(E))
    top = np.lexsort((np.arange(len(E)), -value, -np.round(z, 2)))[: size // 2]
    rest = np.setdiff1d(np.arange(len(E)), top)
    return np.sort(np.concatenate([top, rest[farthest_first(E[rest], size - len(top))]]))


class ValueModel:
    """Posterior of the objective given a record.

    Args:
        space: parameters.
        record: what is known.
        fitted: hyperparameters of ``e + 1`` model coordinates, the last of them the difficulty.
        trend: prior variance of the slope over the difficulty, as fitted with; 0: neither kernel nor mean has one.
    """

    def __init__(self, space: Space, record: Record, fitted: Fit, *, trend: float = TREND) -> None:
        self.space = space
        value = imputed(record)
        self.scale = standardise(value, record.z, trend=trend > 0)
        XZ = self.coordinates(record.X, record.z)
        rows = choose_rows(XZ, value, record.z, MODEL_POINTS)
        y = self.scale.to_y(value[rows], record.z[rows])[:, None]
        centre = float(record.z[rows].mean()) if len(rows) else 1.0
        self.gp = FidelityProcess(
            XZ[rows], y, fitted.w, np.array([fitted.amplitude]), fitted.noise, np.zeros(1), centre, trend
        )
        self.noise = fitted.noise

    def log_density_at_top(self) -> float:
        """Log density of the values at z = 1, each predicted from all other observations, in the values' own unit."""
        top = self.gp.X[:, -1] == 1
        mean, variance = self.gp.leave_one_out()
        sigma = self.gp.amplitude[0] * np.sqrt(variance[top])
        miss = (self.gp.Y[top, 0] - mean[top, 0]) / sigma
        return float(-0.5 * miss @ miss - np.log(sigma * self.scale.spread).sum())

    def coordinates(self, U: Array, z: Array | float) -> Array:
        """``m x d`` unit coordinates and difficulties -> ``m x (e + 1)`` model coordinates."""
        return np.concatenate(
            [self.space.encode(U), np.broadcast_to(np.asarray(z, dtype=float), (len(U),))[:, None]], 1
        )

    def posterior(self, U: Array, z: Array | float) -> tuple[Array, Array]:
        """Mean and latent deviation, ``m`` each, in standardised residuals."""
        mean, variance = self.gp.posterior(self.coordinates(U, z))
        return mean[:, 0], self.gp.amplitude[0] * np.sqrt(variance)

    def mean_at(self, U: Array, z: Array | float) -> Array:
        """Mean alone, ``m``, in standardised residuals."""
        return self.gp.mean_at(self.coordinates(U, z))[:, 0]

    def gradient(self, u: Array, z: float) -> tuple[float, float, Array, Array]:
        """Mean, deviation and their gradients ``d`` at one point ``d``."""
        at = self.coordinates(u[None, :], z)[0]
        mean, variance, dmean, dvariance = self.gp.gradient(at)
        sigma = float(self.gp.amplitude[0]) * math.sqrt(variance)
        dsigma = float(self.gp.amplitude[0]) * dvariance / (2 * math.sqrt(variance))
        e = self.space.e
        pull = self.space.encode_gradient
        return float(mean[0]), sigma, pull(u, dmean[0, :e]), pull(u, dsigma[:e])

    def believe(self, U: Array, z: Array) -> None:
        """Take ``p x d`` points at difficulties ``p`` to show what the posterior expects."""
        if len(U):
            XZ = self.coordinates(U, z)
            self.gp = self.gp.with_data(XZ, self.gp.mean_at(XZ), self.noise)

    def informed(self, u: Array, levels: Array) -> Array:
        """Share of the variance at (u, 1) that an observation at each of ``L`` difficulties takes away, in [0, 1]."""
        points = self.coordinates(np.tile(u, (len(levels) + 1, 1)), np.append(levels, 1.0))
        covariance = self.gp.covariance(points)
        top = covariance[-1, -1]
        gain = covariance[:-1, -1] ** 2 / (np.diag(covariance)[:-1] + self.noise)
        return np.asarray(np.clip(gain / max(top, 1e-12), 0, 1))


def fit_values(
    space: Space,
    record: Record,
    length: float,
    fidelity_length: float,
    *,
    trend: float = TREND,
    believed: Callable[[Prior], Prior] = keep,
) -> Fit:
    """Hyperparameters of the objective's surrogate, difficulty included as the last coordinate.

    Args:
        space: parameters.
        record: what is known.
        length: what the prior median of the parameters' length scales is relative to.
        fidelity_length: likewise, of the difficulty's.
        trend: prior variance of the slope over the difficulty.
        believed: what is made of the priors; as they are, or `flat`.
    """
    value = imputed(record)
    scale = standardise(value, record.z, trend=trend > 0)
    XZ = np.concatenate([space.encode(record.X), record.z[:, None]], 1)
    rows = choose_rows(XZ, value, record.z, FIT_POINTS)
    return fit_fidelity(
        XZ[rows],
        scale.to_y(value[rows], record.z[rows]),
        space.owner,
        believed(Prior(length=LENGTH * length, length_spread=0.5, noise=1e-3, noise_spread=1.5, amplitude=1.0)),
        believed(Prior(length=LINK * fidelity_length, length_spread=0.8)),
        trend=trend,
    )
