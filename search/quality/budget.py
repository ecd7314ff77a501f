"""What evaluations cost, learnt from what they have cost."""

from __future__ import annotations

import math

import numpy as np

from search.record import Record

PRIOR_FLOOR = 0.2
"""Before anything is known, difficulty z is thought to cost PRIOR_FLOOR + (1 - PRIOR_FLOOR) z of the real task."""


class CostModel:
    """The cost of an evaluation as a function of its difficulty: log cost = a + b log prior(z), by ridge regression.

    Args:
        record: what is known. Costs of zero tell nothing. Without any, costs are in units of the real task.
    """

    def __init__(self, record: Record) -> None:
        rows = record.cost > 0
        self.a, self.b = 0.0, 1.0
        if rows.any():
            x, y = np.log(self._prior(record.z[rows])), np.log(record.cost[rows])
            gap = x - x.mean()
            # the slope 1 of the prior counts as much as one observation a unit away
            self.b = float(np.clip((gap @ (y - y.mean()) + 1.0) / (gap @ gap + 1.0), 0.0, 4.0))
            # costs of one difficulty vary (a warm start saves some): plan with their mean, not their median
            self.a = float(np.log(np.mean(np.exp(y - self.b * x))))

    @staticmethod
    def _prior(z: np.ndarray) -> np.ndarray:
        return np.asarray(PRIOR_FLOOR + (1 - PRIOR_FLOOR) * z)

    def at(self, z: float) -> float:
        """Expected cost at a difficulty, in the unit of the observations."""
        return math.exp(self.a + self.b * math.log(PRIOR_FLOOR + (1 - PRIOR_FLOOR) * z))


def spent(record: Record, costs: CostModel) -> float:
    """What has been paid, and what the pending trials are expected to cost."""
    return float(record.cost.sum()) + sum(costs.at(float(z)) for z in record.pending_z)
