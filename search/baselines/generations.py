"""Evolution strategies as functions of the record: their generations are played again from the seed.

An evolution strategy carries a mean and a covariance from one generation to the next. Nothing of that is kept: each
generation is drawn again from its seed, recognised in the record by its points, and told what came of it. A generation
counts as finished when all its points have finished; while some are still running, further points are drawn from the
same distribution and not told.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from search.record import Record
from search.space import Array, Space

SAME = 1e-7


def _find(points: Array, u: Array) -> int | None:
    """The first row equal to a point, or None."""
    if not len(points):
        return None
    hits = np.flatnonzero(np.abs(points - u).max(axis=1) < SAME)
    return int(hits[0]) if len(hits) else None


def replay(
    space: Space,
    record: Record,
    count: int,
    draw: Callable[[], Array],
    tell: Callable[[list[int]], None],
) -> list[Array]:
    """Play the generations of the record again, and draw what comes next.

    Args:
        space: for snapping.
        record: what is known.
        count: how many points are wanted.
        draw: one generation from the present distribution, ``B x d`` unit coordinates, unsnapped.
        tell: given the history rows of the last drawn generation, in its order.

    Returns:
        `count` points ``d``.
    """
    while True:
        generation = space.snap(draw())
        rows = [_find(record.X, u) for u in generation]
        if all(r is not None for r in rows):
            tell([r for r in rows if r is not None])
            continue
        fresh = [u for u, r in zip(generation, rows, strict=True) if r is None and _find(record.pending, u) is None]
        while len(fresh) < count:
            more = space.snap(draw())
            fresh += [u for u in more if _find(record.asked, u) is None] or list(more)
        return fresh[:count]
