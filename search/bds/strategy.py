"""Bayesian diversity search as a strategy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from search.bds import published
from search.record import Candidate, Record
from search.settings import setting
from search.strategy import Strategy
from search.surrogate.threads import one_thread


@dataclass(frozen=True, slots=True)
class BDSSettings:
    """Settings of `bds`."""

    variant: Literal["published"] = setting("published", "`published` is Algorithm 1 of Yin et al. 2021 as printed")
    n_exp: int = setting(3, "proposals in a row that explore (N_exp)", low=0)
    n_opt: int = setting(3, "proposals in a row that diversify (N_opt)", low=1)
    samples: int = setting(64, "Monte Carlo samples of an expected distance", low=1)
    direct_evaluations: int = setting(500, "evaluations of DIRECT for one proposal", low=1)


class BayesianDiversitySearch(Strategy):
    """Proposes what should show a behaviour unlike all known ones."""

    name = "bds"
    summary = "Bayesian diversity search: what should behave unlike everything known"
    uses_features = True
    Settings = BDSSettings

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:
        """`count` points, each proposed as if those before it were already running."""
        with one_thread():
            proposals = published.propose(self.space, self.metric, record, count, rng, self.settings)
        return [self.candidate(u, **info) for u, info in proposals]
