"""Curriculum multi-fidelity Bayesian optimisation, repaired: the default variant.

The difficulty z of a task is its fidelity: easy versions are cheap, and show roughly where good settings lie though not
how good they are. What differs from the published form (`search.quality.cmfbo_published`), and why:

- *Where*: x maximises the logarithm of the expected improvement at z = 1, over the best that was evaluated there as the
  surrogate sees it; an easy point that promises more is thereby taken to the real task. The published upper confidence
  bound is drawn into the corners of the box.
- *How hard*: z maximises the variance an observation would take away at (x, 1), for its cost, the real task counting
  `margin` times: it is an answer as well. What was informative at an easy level stops being so once observed, so the
  curriculum progresses by itself.
- *Values* are modelled with a product kernel and a trend in z of unknown slope (`search.quality.fidelity`), so that
  lower values of the real task don't count against its parameters; hyperparameters have priors.
- *Start*: Sobol points of the easiest task, then its expected improvement, for a tenth of the budget.
- *Misleading* easy levels are noticed: where the values at z = 1 are predicted better without them (leave one out),
  they are left out and no longer asked for.
- *Costs* are learnt from the observations. At least a share of the budget goes to z = 1, its end entirely.
- *The answer* is the best observation at z = 1, never an easier one (`recommend`).
- *Warm start* from the evaluation with the highest kernel correlation, if it is high enough to help.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from search.designs import next_sobol
from search.features import Features
from search.quality import cmfbo_published
from search.quality.acquisition import log_ei_gradient, log_expected_improvement, maximise
from search.quality.budget import CostModel, spent
from search.quality.fidelity import TREND
from search.quality.gp_ucb import best_points
from search.quality.model import ValueModel, fit_values
from search.record import Candidate, Observation, Record, with_warnings
from search.settings import setting
from search.space import Array, Space
from search.strategy import Strategy
from search.surrogate.fit import Fit, Prior
from search.surrogate.gp import IllConditioned
from search.surrogate.milestones import milestone
from search.surrogate.threads import one_thread

LEVELS = np.array([0.1, 0.2, 0.35, 0.5, 0.7, 1.0])
"""Difficulties to choose from."""


@dataclass(frozen=True, slots=True)
class CMFBOSettings:
    """Settings of `cmfbo`."""

    variant: Literal["default", "published"] = setting("default", "`published` is Algorithms 3 and 4 as printed")
    cost_budget: float | None = setting(None, "total cost, in the unit of the observations' costs", low=0)
    start: int | None = setting(None, "evaluations before the surrogate decides; None: d + 1", low=1)
    start_z: float = setting(0.1, "their difficulty, and that of the easy task learnt first", low=0, high=1)
    easy: float = setting(0.1, "share of the budget to learn the easy task first", low=0, high=1)
    gate: bool = setting(True, "leave easy levels out in the measure in which z = 1 is predicted better without them")
    share: float = setting(0.7, "least share of the cost after that which goes to z = 1", low=0, high=1)
    margin: float = setting(2.0, "how much more the same knowledge is worth where it comes with an answer", low=0)
    warm_start: bool = setting(True, "start from the policy of the most correlated evaluation")
    seed: int = setting(0, "which scrambling of the Sobol start", low=0)


class CMFBO(Strategy):
    """Curriculum multi-fidelity Bayesian optimisation (after Yang and Yin 2021).

    Proposes `params`, a difficulty `z` (one of `LEVELS` or `start_z`; as published a tenth of 1 or a multiple) and the
    observation to start from. With a cost budget it proposes nothing more once that is used up.

    Repairs that no study would want to go without have no setting. `benchmarks.search.ablations` takes them away one by
    one in subclasses: it overrides `trend`, `believed`, `reserve`, `likeness`, `_costs`, `_where` or `_how_hard`.
    """

    name = "cmfbo"
    summary = "curriculum multi-fidelity Bayesian optimisation: easy versions first, the real task for the answer"
    uses_values = True
    uses_z = True
    Settings = CMFBOSettings
    trend: ClassVar[float] = TREND
    """Prior variance of the slope of values over the difficulty, relative to the squared amplitude."""
    reserve: ClassVar[float] = 3.0
    """The last so many full evaluations of a budget are spent at z = 1."""
    likeness: ClassVar[float] = 0.3
    """Least kernel correlation at which a policy is worth starting from."""

    def __init__(
        self, space: Space, features: Features | None = None, settings: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__(space, features, settings)
        self._fitted: dict[str, tuple[bytes, Fit]] = {}

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:
        """`count` candidates, each pending for the next; fewer where the budget is used up."""
        with one_thread(), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", IllConditioned)
            if self.settings.variant == "published":
                found = cmfbo_published.propose(self.space, record, count, rng, self.settings)
            else:
                found = self._default(record, count, rng)
        return with_warnings(found, sorted({str(w.message) for w in caught if issubclass(w.category, IllConditioned)}))

    def recommend(self, history: Sequence[Observation]) -> int | None:
        """The best at z = 1; as published, the best at any difficulty."""
        if self.settings.variant == "default":
            return super().recommend(history)
        values = [-math.inf if o.value is None or o.status != "complete" else o.value for o in history]
        return int(np.argmax(values)) if values and max(values) > -math.inf else None

    @staticmethod
    def believed(prior: Prior) -> Prior:
        """What is made of the priors of the hyperparameters: they are taken as they are."""
        return prior

    def _fit(self, record: Record, which: str) -> Fit:
        """Hyperparameters, kept for as long as the part of the history they were fitted to is the same."""
        m = milestone(record.n)
        key = record.digest(m)
        kept = self._fitted.get(which)
        if kept is None or kept[0] != key:
            length = 0.5 * math.sqrt(max(1.0, self.space.d / 2))
            fitted = fit_values(
                self.space, record.first(m), length, FIDELITY_LENGTH, trend=self.trend, believed=self.believed
            )
            kept = self._fitted[which] = (key, fitted)
        for said in kept[1].warnings:  # told with each proposal that stands on it, kept or new
            warnings.warn(said, IllConditioned, stacklevel=2)
        return kept[1]

    def surrogates(self, record: Record) -> tuple[ValueModel, ValueModel | None, float]:
        """What the default variant proposes from, pending trials not yet believed.

        Two models stand against each other: one of all difficulties, one of z = 1 alone. Proposals are made from one
        of them, drawn with its probability given the observations at z = 1, each of which it predicts from all others
        it knows (leave one out). So misleading easy levels are dropped in the measure in which they mislead.

        Returns:
            The joint model, that of z = 1 alone or None where there is nothing to decide, the probability of the first.
        """
        joint = ValueModel(self.space, record, self._fit(record, "joint"), trend=self.trend)
        top = record.z == 1
        if not self.settings.gate or top.sum() < GATE or top.all():
            return joint, None, 1.0
        above = record.only(top)
        alone = ValueModel(self.space, above, self._fit(above, "alone"), trend=self.trend)
        odds = PRIOR_ODDS + joint.log_density_at_top() - alone.log_density_at_top()
        return joint, alone, 1 / (1 + math.exp(float(np.clip(-odds, -50, 50))))

    def _default(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:
        s = self.settings
        costs = self._costs(record)
        paid = spent(record, costs)
        at_top = self._paid_at_top(record, costs)
        budget = math.inf if s.cost_budget is None else s.cost_budget
        start = self.space.d + 1 if s.start is None else s.start
        joint, alone, probability = self.surrogates(record)
        model, informative = (joint, True) if alone is None or rng.random() < probability else (alone, False)
        free = self._easy_phase(costs) if informative else 0.0
        model.believe(record.pending, record.pending_z)
        found: list[Candidate] = []
        asked = record.asked
        while len(found) < count:
            left = budget - paid
            if left < 0.5 * costs.at(0.0) or (
                at_top > 0 and left < 0.5 * min(costs.at(1.0), costs.at(float(LEVELS[0])))
            ):
                break
            turn = len(record.asked) + len(found)
            scarce = left < self.reserve * costs.at(1.0)
            top_only = not informative or scarce or at_top < s.share * (paid - free)
            info: dict[str, Any]
            # a budget too small for the start still has to bring an answer; what is small is known once costs are
            if turn < start and not (scarce and record.cost.any()):
                u = next_sobol(self.space, asked, 1, s.seed)[0]
                z = s.start_z
                info = {"mode": "start"}
            elif paid < free and not top_only:
                u, value, z = *self._where(model, record, s.start_z, rng), s.start_z
                info = {"mode": "learn easy", "acquisition": value}
            else:
                u, value = self._where(model, record, 1.0, rng)
                z = 1.0 if top_only else self._how_hard(model, u, costs)
                info = {"mode": "improve", "acquisition": value}
            parent = self._parent(model, record, u, z) if s.warm_start else None
            found.append(Candidate(self.space.from_unit(u), z=z, warm_start=parent, info=info))
            asked = np.concatenate([asked, u[None, :]])
            paid += costs.at(z)
            at_top += costs.at(z) if z == 1.0 else 0.0
            model.believe(u[None, :], np.array([z]))
        return found

    def _costs(self, record: Record) -> CostModel:
        """What evaluations are expected to cost."""
        return CostModel(record)

    def _easy_phase(self, costs: CostModel) -> float:
        """The cost up to which the search learns the easy task first."""
        s = self.settings
        return float(s.easy * (s.cost_budget if s.cost_budget is not None else 2.0 * self.space.d * costs.at(1.0)))

    @staticmethod
    def _paid_at_top(record: Record, costs: CostModel) -> float:
        return float(record.cost[record.z == 1].sum()) + costs.at(1.0) * int((record.pending_z == 1).sum())

    def _where(self, model: ValueModel, record: Record, z: float, rng: np.random.Generator) -> tuple[Array, float]:
        """Argmax of the expected improvement at one difficulty, over the best evaluated there or above.

        Believed values count as evaluated ones do.
        """
        rows = record.asked
        mean = model.mean_at(rows, z)
        best = to_beat(model, rows, z)
        believed = rows[np.argsort(-mean, kind="stable")[:3]]
        around = np.unique(np.concatenate([best_points(record, 3), believed]), axis=0)

        def many(U: Array) -> Array:
            return log_expected_improvement(*model.posterior(U, z), best)

        def one(u: Array) -> tuple[float, Array]:
            mean, sigma, dmean, dsigma = model.gradient(u, z)
            return log_ei_gradient(mean, sigma, best, dmean, dsigma)

        return maximise(self.space, many, one, around, rng)

    def _how_hard(self, model: ValueModel, u: Array, costs: CostModel) -> float:
        """Argmax over z of the variance taken away at (u, 1) for its cost, the real task's counted `margin` times."""
        price = np.array([costs.at(float(z)) for z in LEVELS])
        worth = model.informed(u, LEVELS) / price
        worth[-1] *= self.settings.margin
        return float(LEVELS[int(np.argmax(worth))])

    def _parent(self, model: ValueModel, record: Record, u: Array, z: float) -> int | None:
        """The observation with the highest kernel correlation with (u, z), if above `likeness`; never a harder one."""
        rows = np.flatnonzero(record.complete & (record.z <= z + 1e-9))
        if not len(rows):
            return None
        here = model.coordinates(u[None, :], z)
        there = model.coordinates(record.X[rows], record.z[rows])
        correlation = model.gp.kinship(here, there)[0]
        best = int(np.argmax(correlation))
        return int(rows[best]) if correlation[best] >= self.likeness else None


def to_beat(model: ValueModel, asked: Array, z: float) -> float:
    """What expected improvement at difficulty z is over: the largest posterior mean among what was evaluated there.

    Evaluations above z count as well. Where there are none, it is so low that the highest mean wins.

    Args:
        model: the surrogate.
        asked: ``m x d`` points asked for at any difficulty.
        z: the difficulty.
    """
    done = model.gp.X[model.gp.X[:, -1] >= z - 1e-9].copy()
    done[:, -1] = z
    if len(done):
        return float(model.gp.mean_at(done).max())
    return float(model.mean_at(asked, z).max()) - 3.0 if len(asked) else 0.0


FIDELITY_LENGTH = 1.0
"""Prior median of the difficulty's length scale: neighbouring levels resemble each other."""
GATE = 3
"""From so many observations at z = 1 on it is asked whether easy levels help."""
PRIOR_ODDS = 0.5
"""Log odds, beforehand, that easy levels help."""
