"""Designs that learn nothing: the controls every claim is measured against."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from search.record import Candidate, Record
from search.settings import setting
from search.space import Array, Space
from search.strategy import Strategy

SAME = 1e-9
"""Two points closer than this in every unit coordinate are one point."""


def sobol_points(space: Space, start: int, count: int, seed: int) -> Array:
    """Points `start` .. `start + count - 1` of the scrambled Sobol sequence of a seed, ``count x d``, snapped."""
    engine = qmc.Sobol(space.d, scramble=True, rng=np.random.default_rng(seed))
    if start:
        engine.fast_forward(start)
    with warnings.catch_warnings():
        # a sequence asked for in pieces has balanced pieces only at powers of two; nothing here relies on balance
        warnings.filterwarnings("ignore", message="The balance properties of Sobol", category=UserWarning)
        return space.snap(np.asarray(engine.random(count), dtype=float))


def next_sobol(space: Space, asked: Array, count: int, seed: int) -> Array:
    """The next `count` Sobol points that have not been asked for, ``count x d``.

    The position in the sequence is the number of points asked for so far; where a trial was cancelled, that number
    falls back, and points already asked for are passed over. In a space with fewer values than trials they repeat.
    """
    start = len(asked)
    points = sobol_points(space, start, count + len(asked) + 8, seed)
    fresh = [p for p in points if not len(asked) or not (np.abs(asked - p).max(axis=1) < SAME).any()]
    return np.stack((fresh + list(points))[:count])


class Random(Strategy):
    """Independent uniform points."""

    name = "random"
    summary = "independent uniform points"

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:  # noqa: ARG002  # learns nothing
        """Uniform in unit coordinates."""
        return [self.candidate(u, mode="random") for u in rng.random((count, self.space.d))]


@dataclass(frozen=True, slots=True)
class SobolSettings:
    """Settings of `sobol`."""

    seed: int = setting(0, "which scrambling of the sequence", low=0)


class Sobol(Strategy):
    """A scrambled Sobol sequence: evenly spread, without memory of outcomes. Randomness comes from its seed alone."""

    name = "sobol"
    summary = "an evenly spread (scrambled Sobol) sequence"
    Settings = SobolSettings

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:  # noqa: ARG002  # see the seed
        """The next points of the sequence that have not been asked for."""
        points = next_sobol(self.space, record.asked, count, self.settings.seed)
        return [self.candidate(u, mode="sobol") for u in points]


@dataclass(frozen=True, slots=True)
class EdgeSettings:
    """Settings of `edge`."""

    probability: float = setting(0.5, "chance that a coordinate is moved to a face of the box", low=0, high=1)


class Edge(Strategy):
    """Uniform points whose coordinates snap to a face of the box with probability one half.

    The control for diversity searches: maximising a surrogate's deviation mostly means living on the faces, and this
    does so without any model. Angles and categories have no faces and stay uniform.
    """

    name = "edge"
    summary = "uniform points with coordinates snapped to the faces of the box (a control without a model)"
    Settings = EdgeSettings

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:  # noqa: ARG002  # learns nothing
        """Uniform, then snapped."""
        u = rng.random((count, self.space.d))
        snapped = rng.random(u.shape) < self.settings.probability
        snapped &= ~(self.space.is_periodic() | self.space.is_categorical())
        return [self.candidate(row, mode="edge") for row in np.where(snapped, np.round(u), u)]
