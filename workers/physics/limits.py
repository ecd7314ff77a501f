"""What a human body can do.

One definition for two: the audit, which refuses what is beyond it, and trainings, which learn to keep within it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.physics import rotations
from workers.physics.athlete import JOINTS, RATE, SPHERICAL, Joint, ranges
from workers.physics.rotations import Array

RATE_FRAMES = 4
"""Frames (1/120 s) that a rate is measured over: human rates come from motion capture, filtered at about 15 Hz."""


@dataclass(frozen=True, slots=True)
class Limits:
    """How far a jump may go.

    Args:
        push: force of the foot over body weight, mean of 1/120 s.
        rate: largest rate of a joint over what a human reaches, mean of `RATE_FRAMES`.
        angle: that a joint may be beyond its range, rad.
    """

    push: float = math.inf
    rate: float = math.inf
    angle: float = math.inf

    def times(self, share: float) -> Limits:
        """A share of each."""
        return Limits(share * self.push, share * self.rate, share * self.angle)

    def strain(self, push: float, pose: NDArray[Any], period: float, joints: Sequence[Joint] = JOINTS) -> Strain:
        """A jump's largest values over these limits.

        Args:
            push: largest force of the foot over body weight.
            pose: of the frames up to the landing ``[frame, 28]``, rad.
            period: seconds of a frame.
            joints: of the athlete.
        """
        return Strain(
            push / self.push,
            largest(joint_rates(pose, period) / RATE) / self.rate,
            largest(beyond_range(pose, joints)) / self.angle,
        )


@dataclass(frozen=True, slots=True)
class Strain:
    """What a jump asked of a body, over the limits; above 1 it is more than a body can do."""

    push: float
    rate: float
    angle: float

    @property
    def worst(self) -> float:
        """The largest of them; NaN where one is."""
        return largest(np.array([self.push, self.rate, self.angle]))


HUMAN = Limits(push=6.0, rate=1.0, angle=0.35)
"""Elite high jumpers are measured at a push of 4 to 6. A joint's range ends in a spring, and flexible people differ by
as much as may be beyond it."""


def joint_rates(pose: Array, period: float) -> Array:
    """Mean magnitudes of the joints' rates over `RATE_FRAMES` ``[frame - RATE_FRAMES, 28]``, rad/s.

    From poses ``[frame, 28]`` rather than Bullet's rates, which a blow changes for one frame.
    """
    if len(pose) <= RATE_FRAMES:
        return np.zeros((0, pose.shape[1]))
    turned = 3 * len(SPHERICAL)
    quaternions = rotations.from_rotation_vector(pose[:, :turned].reshape(len(pose), -1, 3))
    turns = rotations.multiply(rotations.conjugate(quaternions[:-RATE_FRAMES]), quaternions[RATE_FRAMES:])
    angles = rotations.to_rotation_vector(turns).reshape(len(turns), -1)
    hinges = pose[RATE_FRAMES:, turned:] - pose[:-RATE_FRAMES, turned:]
    rates: Array = np.abs(np.concatenate([angles, hinges], 1)) / (RATE_FRAMES * period)
    return rates


def beyond_range(pose: Array, joints: Sequence[Joint] = JOINTS) -> Array:
    """How far the coordinates of poses ``[..., 28]`` are beyond the joints' ranges, rad; negative within."""
    low, high = ranges(joints)
    beyond: Array = np.maximum(pose - high, low - pose)
    return beyond


def largest(values: NDArray[np.float64]) -> float:
    """Largest value, NaN where there is any, 0 where there is none."""
    return float(np.max(values)) if values.size else 0.0
