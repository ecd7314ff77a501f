"""Quality-diversity from pyribs: MAP-Elites and CMA-ME, the diversity baselines (extra `pyribs`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from search.baselines.generations import replay
from search.errors import MissingExtra
from search.features import Features
from search.record import Candidate, Record
from search.settings import setting
from search.space import Array
from search.strategy import Strategy


def _ribs() -> Any:
    try:
        import ribs.archives  # noqa: PLC0415  # optional
        import ribs.emitters  # noqa: PLC0415
    except ImportError:
        raise MissingExtra("strategies 'map_elites' and 'cma_me' need pyribs: pip install 'halma[pyribs]'") from None
    return ribs


def measures(metric: Features, Y: Array) -> Array:
    """Behaviours as archive coordinates: rotations as rotation vectors, the rest as they are."""
    return np.asarray(Rotation.from_quat(Y).as_rotvec()) if metric.kind == "rotation" else Y


def make_archive(ribs: Any, metric: Features, d: int, cells: int) -> Any:
    """A grid of about `cells` cells over the declared range of behaviours."""
    turn = (-math.pi, math.pi)
    ranges = [turn] * 3 if metric.kind == "rotation" else list(zip(metric.low, metric.high, strict=True))
    a_side = max(2, round(cells ** (1 / len(ranges))))
    return ribs.archives.GridArchive(solution_dim=d, dims=[a_side] * len(ranges), ranges=ranges, seed=0)


@dataclass(frozen=True, slots=True)
class MapElitesSettings:
    """Settings of `map_elites`."""

    cells: int = setting(64, "about how many cells the archive has", low=2)
    sigma: float = setting(0.2, "mutation, in ranges", low=0)
    start: int = setting(5, "uniform points before mutation begins", low=1)


class MapElites(Strategy):
    """MAP-Elites: mutations of the elites of a grid of behaviours."""

    name = "map_elites"
    summary = "MAP-Elites (pyribs): mutations of the elites of a grid of behaviours"
    uses_features = True
    uses_values = True
    extra = "pyribs"
    Settings = MapElitesSettings

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:
        """Mutations of elites; uniform points to begin with."""
        ribs, s = _ribs(), self.settings
        archive = make_archive(ribs, self.metric, self.space.d, s.cells)
        rows = np.flatnonzero(record.known & record.complete)
        if len(record.asked) < s.start or not len(rows):
            return [self.candidate(u, mode="random") for u in rng.random((count, self.space.d))]
        archive.add(record.X[rows], record.value[rows], measures(self.metric, record.features[rows]))
        emitter = ribs.emitters.GaussianEmitter(
            archive,
            sigma=s.sigma,
            x0=np.full(self.space.d, 0.5),
            lower_bounds=np.zeros(self.space.d),
            upper_bounds=np.ones(self.space.d),
            batch_size=count,
            seed=int(rng.integers(2**31)),
        )
        return [self.candidate(u, mode="mutate") for u in self.space.snap(np.asarray(emitter.ask(), dtype=float))]


@dataclass(frozen=True, slots=True)
class CMAMESettings:
    """Settings of `cma_me`."""

    cells: int = setting(64, "about how many cells the archive has", low=2)
    sigma: float = setting(0.3, "first step size, in ranges", low=1e-6)
    batch: int = setting(5, "points of a generation", low=2)
    seed: int = setting(0, "seed of the evolution: generations are played again from it", low=0)


class CMAME(Strategy):
    """CMA-ME with an improvement emitter (Fontaine et al. 2020)."""

    name = "cma_me"
    summary = "CMA-ME (pyribs): CMA-ES towards improvement of a grid of behaviours"
    uses_features = True
    uses_values = True
    extra = "pyribs"
    Settings = CMAMESettings

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:  # noqa: ARG002  # see the seed
        """What is left of the present generation, and more of it."""
        ribs, s = _ribs(), self.settings
        d = self.space.d
        archive = make_archive(ribs, self.metric, d, s.cells)
        emitter = ribs.emitters.EvolutionStrategyEmitter(
            archive,
            x0=np.full(d, 0.5),
            sigma0=s.sigma,
            ranker="2imp",
            lower_bounds=np.zeros(d),
            upper_bounds=np.ones(d),
            batch_size=s.batch,
            seed=s.seed,
        )
        known = record.known & record.complete
        worst = float(np.nanmin(record.value[known])) if known.any() else 0.0
        drawn: list[Array] = []

        def draw() -> Array:
            drawn[:] = list(np.asarray(emitter.ask(), dtype=float))
            return np.stack(drawn)

        def tell(rows: list[int]) -> None:
            good = known[rows]
            # a failure shows the middle of the range at the worst value, and never enters the archive
            middle = np.array(self.metric.low) / 2 + np.array(self.metric.high) / 2
            if self.metric.kind == "rotation":
                middle = np.array([0.0, 0.0, 0.0, 1.0])
            Y = measures(self.metric, np.where(good[:, None], record.features[rows], middle))
            value = np.where(good, record.value[rows], worst)
            solutions = np.stack(drawn)
            status, gain = np.zeros(len(rows), dtype=np.int32), np.full(len(rows), -1e9)
            if good.any():
                added = archive.add(solutions[good], value[good], Y[good])
                status[good], gain[good] = added["status"], added["value"]
            emitter.tell(solutions, value, Y, {"status": status, "value": gain})

        return [self.candidate(u, mode="cma_me") for u in replay(self.space, record, count, draw, tell)]
