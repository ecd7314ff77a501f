"""`bds` and `cmfbo` with one repair taken away, where no setting does it. For the benchmarks: studies can't name them.

Each is a subclass that overrides one thing. What is put in its place is what the published algorithm does there, or
nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from search import Angle, Candidate, Features, Float, Observation, Space, registry
from search.bds.default import DiversityModel
from search.bds.strategy import BayesianDiversitySearch
from search.quality.budget import CostModel
from search.quality.cmfbo import CMFBO, LEVELS
from search.quality.cmfbo_published import BETA, EPSILON
from search.quality.model import ValueModel
from search.record import Record
from search.space import Array
from search.strategy import Strategy
from search.surrogate.fit import Prior, flat


class NoTrend(CMFBO):
    """Neither the kernel nor the mean knows that values fall with the difficulty."""

    trend = 0.0


class NoPriors(CMFBO):
    """Hyperparameters of maximum likelihood, within the same bounds and from the same start."""

    believed = staticmethod(flat)


class NoReserve(CMFBO):
    """The end of the budget is not kept for z = 1."""

    reserve = 0.0


class AnyParent(CMFBO):
    """A policy is handed on however unlike the evaluation it comes from (Algorithm 4)."""

    likeness = 0.0


class PriorCosts(CMFBO):
    """Costs are not learnt: a difficulty costs what is thought beforehand, in the mean of what was paid."""

    def _costs(self, record: Record) -> CostModel:
        costs = CostModel(record)
        paid = record.cost > 0
        costs.b = 1.0
        if paid.any():
            costs.a = float(np.log(np.mean(record.cost[paid] / CostModel._prior(record.z[paid]))))
        return costs


class AnyAnswer(CMFBO):
    """The answer is the best value of whatever difficulty, as printed."""

    def recommend(self, history: Sequence[Observation]) -> int | None:
        values = [-math.inf if o.value is None or o.status != "complete" else o.value for o in history]
        return int(np.argmax(values)) if values and max(values) > -math.inf else None


class PublishedWhere(CMFBO):
    """x maximises mu + sqrt(beta_t) sigma, by L-BFGS from the best evaluation (Algorithm 3)."""

    def _where(self, model: ValueModel, record: Record, z: float, rng: np.random.Generator) -> tuple[Array, float]:
        root = math.sqrt(BETA * self.space.d * math.log(2 * len(record.asked) + 1))
        rows = np.flatnonzero(record.complete & ~np.isnan(record.value))
        start = record.X[rows[int(np.argmax(record.value[rows]))]] if len(rows) else rng.random(self.space.d)

        def negative(u: Array) -> tuple[float, Array]:
            mean, sigma, dmean, dsigma = model.gradient(u, z)
            return -mean - root * sigma, -dmean - root * dsigma

        found = minimize(negative, start, jac=True, method="L-BFGS-B", bounds=[(0, 1)] * self.space.d)
        return self.space.snap(np.clip(found.x, 0, 1)[None, :])[0], -float(found.fun)


class PublishedHowHard(CMFBO):
    """z is the lowest difficulty whose predictive deviation at x is above epsilon, in units of values (Algorithm 3)."""

    def _how_hard(self, model: ValueModel, u: Array, costs: CostModel) -> float:  # noqa: ARG002  # as printed: no costs
        sigma = model.posterior(np.tile(u, (len(LEVELS), 1)), LEVELS)[1]
        noise = model.noise * model.gp.amplitude[0] ** 2
        above = np.flatnonzero(model.scale.spread * np.sqrt(sigma**2 + noise) > EPSILON)
        return float(LEVELS[above[0]]) if len(above) else 1.0


class PublishedAcquisition(PublishedWhere, PublishedHowHard):
    """Both: the published progressive acquisition on the repaired surrogate, start and budget."""


class NoBehaviourPriors(BayesianDiversitySearch):
    """Hyperparameters of maximum likelihood, within the same bounds and from the same start."""

    believed = staticmethod(flat)


def _exact(prior: Prior) -> Prior:
    return replace(prior, noise=1e-6, noise_spread=1e-2)


class NoNoise(BayesianDiversitySearch):
    """Outcomes are taken to be exact."""

    believed = staticmethod(_exact)


class Unbelieving(DiversityModel):
    """Nothing is thought of trials whose outcome is not known yet."""

    def believe(self, U: Array) -> None:
        """Nothing."""


class NoBelief(BayesianDiversitySearch):
    """Of pending trials and of the rest of a batch only the weight against near points knows."""

    model = Unbelieving


class DeviationOnly(DiversityModel):
    """The acquisition of the published exploring turns."""

    def expected_novelty(self, E: Array, normals: Array, cap: float, known: Array) -> Array:  # noqa: ARG002  # blind to them
        """The posterior standard deviation over all outputs together, ``m``."""
        return np.asarray(np.sqrt(self.behaviour.posterior(E)[1]) * np.linalg.norm(self.behaviour.amplitude))


class _Exploring(BayesianDiversitySearch):
    model = DeviationOnly


class Alternating(BayesianDiversitySearch):
    """Three turns of largest deviation, three of largest expected distance, in turn (Algorithm 1). One at a time."""

    def __init__(
        self, space: Space, features: Features | None = None, settings: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__(space, features, settings)
        self._explorer = _Exploring(space, features, settings)

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:
        """One point by the acquisition whose turn it is."""
        if len(record.asked) % (self.settings.n_exp + self.settings.n_opt) < self.settings.n_exp:
            return self._explorer.propose_from(record, count, rng)
        return super().propose_from(record, count, rng)


class PlainGeometry(BayesianDiversitySearch):
    """Angles and rotations are numbers: in [-pi, pi], and rotation vectors; with the distances of plain vectors.

    Meant for histories whose angles lie in [-pi, pi], as those of its own proposals do.
    """

    def __init__(
        self, space: Space, features: Features | None = None, settings: Mapping[str, Any] | None = None
    ) -> None:
        plain = {n: Float(-math.pi, math.pi) if isinstance(p, Angle) else p for n, p in space.parameters.items()}
        self._rotations = features is not None and features.kind == "rotation"
        if features is not None and features.kind != "euclidean":
            features = Features.euclidean(3 if self._rotations else 1, low=-math.pi, high=math.pi)
        super().__init__(Space(plain), features, settings)

    def propose(
        self, history: Sequence[Observation], pending: Sequence[Candidate], count: int, rng: np.random.Generator
    ) -> list[Candidate]:
        """As its parent, of flattened behaviours."""
        if self._rotations:
            history = [
                o
                if o.features is None
                else replace(o, features=Rotation.from_quat(np.asarray(o.features)).as_rotvec().tolist())
                for o in history
            ]
        return super().propose(history, pending, count, rng)


ABLATED: dict[str, type[Strategy]] = {
    "cmfbo without trend": NoTrend,
    "cmfbo without priors": NoPriors,
    "cmfbo without reserve": NoReserve,
    "cmfbo with any parent": AnyParent,
    "cmfbo with prior costs": PriorCosts,
    "cmfbo with any answer": AnyAnswer,
    "cmfbo with the published x": PublishedWhere,
    "cmfbo with the published z": PublishedHowHard,
    "cmfbo with the published acquisition": PublishedAcquisition,
    "bds without priors": NoBehaviourPriors,
    "bds without noise": NoNoise,
    "bds without belief": NoBelief,
    "bds alternating": Alternating,
    "bds with plain geometry": PlainGeometry,
}
"""Name in the benchmarks' tables of configurations -> class."""


def strategy_class(name: str) -> type[Strategy]:
    """The class behind a name: of a strategy, or of one with a repair taken away."""
    return ABLATED[name] if name in ABLATED else registry.strategy_class(name)
