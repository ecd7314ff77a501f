"""CMA-ES, from the package behind Optuna's own CMA-ES sampler."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from search.baselines.generations import replay
from search.errors import MissingExtra
from search.quality.model import imputed
from search.record import Candidate, Record
from search.settings import setting
from search.space import Array
from search.strategy import Strategy


@dataclass(frozen=True, slots=True)
class CMASettings:
    """Settings of `cmaes`."""

    sigma: float = setting(0.3, "first step size, in ranges", low=1e-6)
    seed: int = setting(0, "seed of the evolution: generations are played again from it", low=0)


class CMAES(Strategy):
    """Covariance matrix adaptation in unit coordinates, all parameters relaxed to numbers."""

    name = "cmaes"
    summary = "CMA-ES (the `cmaes` package, as in Optuna)"
    uses_values = True
    extra = "cmaes"
    Settings = CMASettings

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:  # noqa: ARG002  # see the seed
        """What is left of the present generation, and more of it."""
        try:
            from cmaes import CMA  # noqa: PLC0415  # optional
        except ImportError:
            raise MissingExtra("strategy 'cmaes' needs the package `cmaes`: pip install cmaes") from None
        d, s = self.space.d, self.settings
        bounds = np.array([[0.0, 1.0]] * d)
        value = imputed(record)
        if d == 1:  # the package refuses one dimension; a second, idle one does no harm
            bounds = np.array([[0.0, 1.0]] * 2)
        optimiser = CMA(mean=np.full(len(bounds), 0.5), sigma=s.sigma, bounds=bounds, seed=s.seed)
        drawn: list[Array] = []

        def draw() -> Array:
            drawn[:] = [np.asarray(optimiser.ask()) for _ in range(optimiser.population_size)]
            return np.stack(drawn)[:, :d]

        def tell(rows: list[int]) -> None:
            optimiser.tell([(x, -float(value[r])) for x, r in zip(drawn, rows, strict=True)])

        return [self.candidate(u, mode="cmaes") for u in replay(self.space, record, count, draw, tell)]
