"""A search that begins with points somebody has in mind: what is known to work is tried before anything is guessed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from search.errors import BadParams
from search.record import Candidate, Observation
from search.space import Scalar, Space
from search.strategy import Strategy

GIVEN = "given"
"""How such a proposal was made, in its `info`."""


@dataclass(frozen=True)
class Given:
    """A strategy whose first proposals are fixed; it learns from what came of them as from any others.

    Like every strategy it is a function of the record: the k-th trial of a study is the k-th point. To a strategy that
    chooses difficulties they are evaluations of the task itself, z = 1.

    Args:
        search: proposes what comes after them.
        points: parameters in natural units, in the order in which they are tried.

    Raises:
        BadParams: a point is none of the search's space; the message begins with its position from 0, in brackets.
    """

    search: Strategy
    points: tuple[Mapping[str, Scalar], ...]

    def __post_init__(self) -> None:
        for i, point in enumerate(self.points):
            try:
                self.space.to_unit(point)
            except BadParams as error:
                raise BadParams(f"[{i}] {error}") from None

    @property
    def space(self) -> Space:
        """What is searched over."""
        return self.search.space

    def propose(
        self, history: Sequence[Observation], pending: Sequence[Candidate], count: int, rng: np.random.Generator
    ) -> list[Candidate]:
        """What to try next: see `Strategy.propose`."""
        begun = len(history) + len(pending)
        z = 1.0 if self.search.uses_z else None
        given = [Candidate(dict(point), z, info={"mode": GIVEN}) for point in self.points[begun : begun + count]]
        if len(given) == count:
            return given
        return given + self.search.propose(history, [*pending, *given], count - len(given), rng)

    def recommend(self, history: Sequence[Observation]) -> int | None:
        """The best answer so far: see `Strategy.recommend`."""
        return self.search.recommend(history)
