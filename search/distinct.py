"""Which of many outcomes are different strategies, and which one stands for each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from search.errors import BadFeatures
from search.features import Features


@dataclass(frozen=True, slots=True)
class Cluster:
    """Outcomes that count as one strategy.

    Args:
        representative: index of the member with the highest value.
        members: indices of all members, ascending; the representative among them.
    """

    representative: int
    members: tuple[int, ...]


def distinct(
    features: Any, values: Sequence[float] | NDArray[np.float64], metric: Features, threshold: float
) -> list[Cluster]:
    """Group outcomes into distinct strategies.

    The best outcome leads the first cluster and takes everything within `threshold` of it; the best of the rest leads
    the next, and so on. So representatives are more than `threshold` apart from each other, every member is within
    it of its representative, and nobody in a cluster is better than its representative. Linkage clusterings give
    none of the three: single linkage chains a whole circle of slightly different outcomes into one strategy.

    The order of the outcomes doesn't matter: equal values are ordered by their features, and only outcomes equal in
    both by their index.

    Args:
        features: ``n x d`` behaviours.
        values: ``n``, higher is better; NaN counts as the lowest.
        metric: the feature space.
        threshold: in the metric's unit, at least 0.

    Returns:
        The clusters, best representative first.

    Raises:
        BadFeatures: wrong shapes, NaN features, a threshold below 0.
    """
    value = np.asarray(values, dtype=float).reshape(-1)
    rows = list(features)
    if len(rows) != len(value):
        raise BadFeatures(f"expected one value for each of the {len(rows)} behaviours, found {len(value)}")
    if not threshold >= 0:
        raise BadFeatures(f"expected a threshold of at least 0, found {threshold!r}")
    if not rows:
        return []
    Y = np.stack([metric.check(row) for row in rows])
    value = np.where(np.isnan(value), -np.inf, value)
    order = np.lexsort((*Y.T[::-1], -value))
    free = np.ones(len(Y), dtype=bool)
    clusters = []
    for leader in order:
        if not free[leader]:
            continue
        mine = free & (metric.distance(Y, Y[leader]) <= threshold)
        mine[leader] = True
        free &= ~mine
        clusters.append(Cluster(int(leader), tuple(int(i) for i in np.flatnonzero(mine))))
    return clusters


def cluster_joined(
    features: Any,
    value: float,
    leaders: Sequence[Any],
    leading: Sequence[float],
    metric: Features,
    threshold: float,
) -> int | None:
    """Which cluster of `distinct` one more outcome joins, where it changes no other: most of them do.

    Whoever is no representative takes nobody from anybody. So an outcome that comes after the first representative
    within `threshold` joins it, and the rest stands; any other is a representative itself, and what lies around it
    may become its own.

    Args:
        features: ``d``, its behaviour.
        value: its value; NaN counts as the lowest.
        leaders: ``k x d``, the behaviours of the representatives, in the order of `distinct`.
        leading: ``k``, their values.
        metric: the feature space.
        threshold: in the metric's unit.

    Returns:
        Place of the cluster; None where all have to be grouped anew.

    Raises:
        BadFeatures: features that are none.
    """
    mine = metric.check(features)

    def place(worth: float, at: NDArray[np.float64]) -> tuple[float, ...]:
        return (math.inf if math.isnan(worth) else -worth, *at.tolist())

    for index, (leader, worth) in enumerate(zip(leaders, leading, strict=True)):
        other = metric.check(leader)
        if float(metric.distance(mine, other)) <= threshold:
            # of equal ones the earlier comes first, and this one is the last of all
            return index if place(worth, other) <= place(value, mine) else None
    return None
