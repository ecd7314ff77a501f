"""Bayesian diversity search as a strategy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from search.bds import default, published
from search.features import Features
from search.record import Candidate, Record
from search.settings import setting
from search.space import Space
from search.strategy import Strategy
from search.surrogate.fit import Prior
from search.surrogate.milestones import milestone
from search.surrogate.threads import one_thread


@dataclass(frozen=True, slots=True)
class BDSSettings:
    """Settings of `bds`."""

    variant: Literal["default", "published"] = setting(
        "default", "`published` is Algorithm 1 of Yin et al. 2021 as printed"
    )
    samples: int = setting(64, "Monte Carlo samples of an expected distance", low=1)
    start: int = setting(4, "Sobol points before the surrogate decides", low=0)
    seed: int = setting(0, "which scrambling of the Sobol start", low=0)
    feasibility: bool = setting(True, "learn from failures where trials fail")
    interior: bool = setting(True, "keep away from the faces of the box, by distances that take turns")
    radius: float = setting(0.5, "points nearer than this (in ranges, times sqrt(d)) are worth less", low=0)
    cap: float | None = setting(None, "distance beyond which more counts for nothing; None: there is none", low=0)
    n_exp: int = setting(3, "published: proposals in a row that explore (N_exp)", low=0)
    n_opt: int = setting(3, "published: proposals in a row that diversify (N_opt)", low=1)
    direct_evaluations: int = setting(500, "published: evaluations of DIRECT for one proposal", low=1)


class BayesianDiversitySearch(Strategy):
    """Proposes what should show a behaviour unlike all known ones (after Yin et al. 2021, Algorithm 1).

    The reasons are in `candidate.info`: `acquisition` and `novelty` in the unit of the metric, `feasible` in [0, 1] and
    `predicted`, the behaviour that is expected.

    Repairs that no study would want to go without have no setting: `benchmarks.search.ablations` takes them away one by
    one in subclasses that override `believed` or `model`.
    """

    name = "bds"
    summary = "Bayesian diversity search: what should behave unlike everything known"
    uses_features = True
    Settings = BDSSettings
    model: ClassVar[type[default.DiversityModel]] = default.DiversityModel
    """The surrogates that proposals are made from."""

    def __init__(
        self, space: Space, features: Features | None = None, settings: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__(space, features, settings)
        self._fitted: tuple[bytes, default.Models] | None = None

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:
        """`count` points, each proposed as if those before it were already running."""
        with one_thread():
            if self.settings.variant == "published":
                proposals = published.propose(self.space, self.metric, record, count, rng, self.settings)
            else:
                fitted = self._models(record)
                proposals = default.propose(
                    self.space, self.metric, record, count, rng, self.settings, fitted, self.model
                )
        return [self.candidate(u, **info) for u, info in proposals]

    @staticmethod
    def believed(prior: Prior) -> Prior:
        """What is made of the priors of the hyperparameters: they are taken as they are."""
        return prior

    def _models(self, record: Record) -> default.Models:
        """Fitted hyperparameters, kept for as long as the part of the history they were fitted to is the same."""
        key = record.digest(milestone(record.n))
        if self._fitted is None or self._fitted[0] != key:
            self._fitted = (key, default.fit_models(self.space, self.metric, record, believed=self.believed))
        return self._fitted[1]
