"""The rules of the high jump and its reward, as published (Yin et al. 2021)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from workers.physics.world import WALL_HALF_THICKNESS, Contacts

Verdict = Literal["landed", "wall", "ground", "time", "fall"]
Landing = Literal["any", "feet"]

TIME_LIMIT = 2.0
"""s; a jump that takes longer has failed."""
HEAD_FIRST = 0.7
"""Factor of the reward for landing on the head (safety)."""
BEYOND = 0.2
"""Factor of the reward for a jump that asks more of a body than it can do: it must not pay, and still tell the way."""
SPIN_PENALTY = 0.02
"""s/rad, in exp(-0.02 |omega|)."""
OFFSET_EASY, OFFSET_HARD = 48.0, 15.0
"""Mean offset (L1 norm, rad) at which naturalness is 0, for low and for high bars."""
OFFSETS = (OFFSET_EASY, OFFSET_HARD)
OFFSET_EASY_BAR, OFFSET_HARD_BAR = 0.6, 1.6
"""Bars between which the bound falls, m."""


@dataclass(frozen=True, slots=True)
class Rules:
    """Judges a jump frame by frame.

    Args:
        foot: Bullet link of the take-off foot, the only part that may touch the ground.
        head: Bullet link of the head.
        may_land_on: links that may touch the mat before the jump has landed; None for all.
        edge: x behind which a jump has got over, m.
    """

    foot: int
    head: int
    may_land_on: frozenset[int] | None = None
    edge: float = WALL_HALF_THICKNESS

    def verdict(self, contacts: Contacts, time: float, rear: float | None) -> Verdict | None:
        """What ends the jump now, or None.

        Args:
            contacts: of this frame.
            time: since the start, s.
            rear: lowest x of all that must have got over (m), only needed where the mat is touched: of all parts for a
                bar, of the centre of mass for an obstacle, since who lands in a long jump lands feet first. The jump
                has landed once the mat is touched and this is behind the edge.
        """
        if contacts.wall:
            return "wall"
        if contacts.ground - {self.foot}:
            return "ground"
        if self.may_land_on is not None and contacts.mat - self.may_land_on:
            return "fall"
        if contacts.mat and rear is not None and rear > self.edge:
            return "landed"
        if time >= TIME_LIMIT:
            return "time"
        return None


Hardness = Callable[[float], float]
"""How hard a level is, from 0 to 1: what control rate and naturalness are scheduled by."""


def hardness_of_bar(bar: float) -> float:
    """How hard a bar (m) is."""
    return float(np.clip((bar - OFFSET_EASY_BAR) / (OFFSET_HARD_BAR - OFFSET_EASY_BAR), 0, 1))


def offset_bound(bar: float, hardness: Hardness = hardness_of_bar, bounds: tuple[float, float] = OFFSETS) -> float:
    """c_offset of equation 4 for a level (m); `bounds` are those of the easiest and of the hardest."""
    easy, hard = bounds
    return easy + (hard - easy) * hardness(bar)


def naturalness(
    offset: float, bar: float, hardness: Hardness = hardness_of_bar, bounds: tuple[float, float] = OFFSETS
) -> float:
    """1 - min((offset / c_offset)^2, 1), equation 4; `offset` is the mean L1 norm of the actions, rad."""
    return 1.0 - min((offset / offset_bound(bar, hardness, bounds)) ** 2, 1.0)


def rate_at(level: float, easy: int, hard: int, hardness: Hardness = hardness_of_bar) -> int:
    """Actions a second at a level: from `easy` to `hard`, each a divisor of 120, the highest that is due."""
    due = easy + (hard - easy) * hardness(level)
    return max((rate for rate in range(easy, hard + 1) if 120 % rate == 0 and rate <= due + 1e-9), default=easy)


def reward(
    *,
    landed: bool,
    head_first: bool,
    spin: float,
    offset: float,
    bar: float,
    hardness: Hardness = hardness_of_bar,
    bounds: tuple[float, float] = OFFSETS,
) -> float:
    """Reward of a finished jump, in [0, 1]: completion x exp(-0.02 |omega|) x safety x naturalness. Sparse.

    Args:
        landed: whether the jump was completed; without it there is nothing.
        head_first: whether the head touched the mat as it landed.
        spin: mean magnitude of the root's angular velocity, rad/s.
        offset: mean L1 norm of the actions, rad.
        bar: height of the bar, or whatever the level is, m.
        hardness: of a level.
        bounds: of the offset, at the easiest and at the hardest levels, rad.
    """
    if not landed:
        return 0.0
    safety = HEAD_FIRST if head_first else 1.0
    return float(np.exp(-SPIN_PENALTY * spin) * safety * naturalness(offset, bar, hardness, bounds))
