"""GP-UCB, the single-fidelity control (Srinivas et al. 2010), and BOCA (Kandasamy et al. 2017)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from search.designs import next_sobol
from search.quality.acquisition import maximise
from search.quality.budget import CostModel, spent
from search.quality.model import ValueModel, fit_values
from search.record import Candidate, Observation, Record, read_record, with_warnings
from search.settings import setting
from search.space import Array
from search.strategy import Strategy
from search.surrogate.fit import Fit
from search.surrogate.gp import IllConditioned, matern52
from search.surrogate.threads import one_thread


@dataclass(frozen=True, slots=True)
class UCBSettings:
    """Settings of `gp_ucb`."""

    beta: float = setting(0.2, "beta_t = beta * d * log(2 t + 1): how much uncertainty is worth", low=0)
    start: int | None = setting(None, "Sobol points before the surrogate decides; None: d + 1", low=1)
    seed: int = setting(0, "which scrambling of the Sobol start", low=0)


def maximise_ucb(model: ValueModel, root_beta: float, around: Array, rng: np.random.Generator) -> tuple[Array, float]:
    """Argmax over x of mu(x, 1) + sqrt(beta) sigma(x, 1)."""

    def many(U: Array) -> Array:
        mean, sigma = model.posterior(U, 1.0)
        return mean + root_beta * sigma

    def one(u: Array) -> tuple[float, Array]:
        mean, sigma, dmean, dsigma = model.gradient(u, 1.0)
        return mean + root_beta * sigma, dmean + root_beta * dsigma

    return maximise(model.space, many, one, around, rng)


def best_points(record: Record, count: int = 5) -> Array:
    """The points of the best complete observations, ``p x d``, highest difficulty first."""
    rows = np.flatnonzero(record.complete & ~np.isnan(record.value))
    order = np.lexsort((rows, -record.value[rows], -np.round(record.z[rows], 2)))
    return record.X[rows[order[:count]]]


class GPUCB(Strategy):
    """Gaussian process with an upper confidence bound, at full difficulty."""

    name = "gp_ucb"
    summary = "Gaussian process, upper confidence bound"
    uses_values = True
    Settings = UCBSettings

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:
        """`count` points, each pending for the next."""
        s = self.settings
        start = self.space.d + 1 if s.start is None else s.start
        asked = record.asked
        if len(asked) < start:
            points = next_sobol(self.space, asked, min(count, start - len(asked)), s.seed)
        else:
            points = np.empty((0, self.space.d))
        found = [self.candidate(u, mode="start") for u in points]
        with one_thread(), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", IllConditioned)
            fitted = fit_values(self.space, record, 0.5 * math.sqrt(self.space.d / 2), 1.0)
            model = ValueModel(self.space, record, fitted)
            model.believe(np.concatenate([record.pending, points]), np.ones(len(record.pending) + len(points)))
            while len(found) < count:
                t = len(asked) + len(found) + 1
                u, value = maximise_ucb(
                    model, math.sqrt(s.beta * self.space.d * math.log(2 * t + 1)), best_points(record), rng
                )
                found.append(self.candidate(u, mode="ucb", acquisition=value))
                model.believe(u[None, :], np.ones(1))
        return with_warnings(found, _told(caught, fitted))


def _told(caught: Sequence[warnings.WarningMessage], fitted: Fit) -> list[str]:
    """What went wrong on the way to a proposal, for the record."""
    return [*sorted({str(w.message) for w in caught if issubclass(w.category, IllConditioned)}), *fitted.warnings]


@dataclass(frozen=True, slots=True)
class BOCASettings:
    """Settings of `boca`."""

    cost_budget: float | None = setting(None, "total cost, in the unit of the observations' costs", low=0)
    beta: float = setting(0.2, "beta_t = beta * d * log(2 t + 1)", low=0)
    start: int | None = setting(None, "Sobol points before the surrogate decides; None: d + 1", low=1)
    seed: int = setting(0, "which scrambling of the Sobol start", low=0)
    levels: int = setting(10, "number of difficulties to choose from, evenly spaced up to 1", low=1)


class BOCA(Strategy):
    """Bayesian optimisation with continuous approximations.

    x_t maximises the upper confidence bound at the real task. z_t is the cheapest difficulty at which the deviation is
    still above gamma(z) = sqrt(k_x(0)) xi(z) (lambda(z) / lambda(1))^q, with xi the information gap of the difficulty's
    kernel and q = 1 / (d + 3) (Kandasamy et al. 2017, equation 8); the real task where there is none.
    """

    name = "boca"
    summary = "BOCA: upper confidence bound at full difficulty, asked at the cheapest difficulty that still informs"
    uses_values = True
    uses_z = True
    Settings = BOCASettings

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:
        """`count` points, fewer where the budget is used up."""
        s = self.settings
        costs = CostModel(record)
        left = math.inf if s.cost_budget is None else s.cost_budget - spent(record, costs)
        start = self.space.d + 1 if s.start is None else s.start
        levels = (np.arange(s.levels) + 1) / s.levels
        found: list[Candidate] = []
        n = len(record.asked)
        with one_thread(), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", IllConditioned)
            fitted = fit_values(self.space, record, 0.5 * math.sqrt(self.space.d / 2), 1.0)
            model = ValueModel(self.space, record, fitted)
            model.believe(record.pending, record.pending_z)
            while len(found) < count and left > 0:
                t = n + len(found)
                if t < start:
                    u = next_sobol(self.space, record.asked, t - n + 1, s.seed)[-1]
                    z, mode = float(levels[t % len(levels)]), "start"
                else:
                    root = math.sqrt(s.beta * self.space.d * math.log(2 * t + 1))
                    u, _ = maximise_ucb(model, root, best_points(record), rng)
                    z, mode = self._difficulty(model, u, levels, costs, float(fitted.w[-1])), "ucb"
                found.append(Candidate(self.space.from_unit(u), z=z, info={"mode": mode}))
                left -= costs.at(z)
                model.believe(u[None, :], np.array([z]))
        return with_warnings(found, _told(caught, fitted))

    def recommend(self, history: Sequence[Observation]) -> int | None:
        """The observation whose parameters have the largest posterior mean at z = 1, wherever they were asked."""
        record = read_record(self.space, self.features, history, [])
        if not record.complete.any():
            return None
        with one_thread(), warnings.catch_warnings():
            warnings.simplefilter("ignore", IllConditioned)
            model = ValueModel(
                self.space, record, fit_values(self.space, record, 0.5 * math.sqrt(self.space.d / 2), 1.0)
            )
            mean = model.mean_at(record.X, 1.0)
        return int(np.argmax(np.where(record.complete, mean, -np.inf)))

    def _difficulty(self, model: ValueModel, u: Array, levels: Array, costs: CostModel, w: float) -> float:
        """Equation 8 of Kandasamy et al. 2017, with the kernel's correlation in place of the Gaussian's."""
        sigma = model.posterior(np.tile(u, (len(levels), 1)), levels)[1]
        xi = np.sqrt(np.maximum(1 - matern52(w * np.abs(1 - levels)) ** 2, 0))
        share = np.array([costs.at(float(z)) for z in levels]) / costs.at(1.0)
        gamma = model.gp.amplitude[0] * xi * share ** (1 / (self.space.d + 3))
        good = np.flatnonzero((sigma > gamma) & (levels < 1))
        return float(levels[good[0]]) if len(good) else 1.0
