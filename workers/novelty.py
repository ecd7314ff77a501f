"""How new is a behaviour? The reward's factor in trainings that are to find what is not known yet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workers.contracts import JSON, BadJob, FeatureSpec, Job

FLOOR = 0.01
"""What is left of the reward for a behaviour that is known already: it keeps a reward for doing the task at all."""


@dataclass(frozen=True, slots=True)
class Novelty:
    """Behaviours to keep away from.

    Args:
        spec: what a behaviour is and how far two of them are apart.
        avoid: ``n x D`` behaviours.
        threshold: d_threshold, in the metric's unit.
        strategies: ``m x D``, those of `avoid` that stand for a strategy; None: each for one of its own.
    """

    spec: FeatureSpec
    avoid: NDArray[np.float64]
    threshold: float
    strategies: NDArray[np.float64] | None = None

    @classmethod
    def of(cls, job: Job, spec: FeatureSpec) -> Novelty | None:
        """What a job is to keep away from, or None. Raises `BadJob` where that makes no sense."""
        if job.novelty is None:
            return None
        threshold = job.novelty.get("threshold")
        if isinstance(threshold, bool) or not isinstance(threshold, int | float) or not 0 < threshold < math.inf:
            raise BadJob(f"novelty.threshold: expected a number above 0, found {threshold!r}")
        # a trial of halma 0.1.0 was told of no strategies
        strategies = None if job.novelty.get("strategies") is None else _behaviours(job.novelty, "strategies", spec)
        return cls(spec, _behaviours(job.novelty, "avoid", spec), float(threshold), strategies)

    def distance(self, behaviour: tuple[float, ...]) -> float:
        """To the nearest known behaviour, in the metric's unit; infinite where none is known."""
        return self._nearest(self.avoid, behaviour)

    def factor(self, behaviour: tuple[float, ...]) -> float:
        """Equation 12 of Yin et al. 2021: clip(distance to the nearest known behaviour / d_threshold, 0.01, 1)."""
        return min(max(self.distance(behaviour) / self.threshold, FLOOR), 1.0)

    def is_new(self, behaviour: tuple[float, ...]) -> bool:
        """Whether it would count as another strategy: further than `spec.distinct` from what stands for each.

        Not from every policy that is known: a strategy is all that is as near as that to its best policy, and no more.
        """
        return self._nearest(self.avoid if self.strategies is None else self.strategies, behaviour) > self.spec.distinct

    def _nearest(self, known: NDArray[np.float64], behaviour: tuple[float, ...]) -> float:
        """Distance to the nearest of ``m x D`` behaviours; infinite where there is none."""
        if not len(known):
            return math.inf
        a = np.asarray(behaviour, np.float64)
        if self.spec.kind == "circle":
            gap = np.abs(known[:, 0] - a[0]) % (2 * np.pi)
            return float(np.minimum(gap, 2 * np.pi - gap).min())
        if self.spec.kind == "rotation":
            # of q and -q the nearer one; atan2 keeps its precision near 0 and pi
            near, far = np.linalg.norm(known - a, axis=1), np.linalg.norm(known + a, axis=1)
            return float(4 * np.arctan2(np.minimum(near, far), np.maximum(near, far)).min())
        return float(np.linalg.norm(known - a, axis=1).min())


def _behaviours(novelty: Mapping[str, JSON], name: str, spec: FeatureSpec) -> NDArray[np.float64]:
    """The behaviours under a name ``n x D``. Raises `BadJob` where they are none."""
    try:
        found = np.asarray(novelty.get(name), np.float64).reshape(-1, len(spec.names))
    except (TypeError, ValueError):
        found = np.full((1, 1), np.nan)
    if not np.isfinite(found).all():
        raise BadJob(
            f"novelty.{name}: expected behaviours of {len(spec.names)} numbers ({', '.join(spec.names)}), "
            f"found {novelty.get(name)!r}"
        )
    return found
