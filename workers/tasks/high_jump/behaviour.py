"""What kind of jump it was: how the athlete was turned as its centre of mass passed the bar."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from workers.contracts import FeatureSpec
from workers.physics import rotations
from workers.physics.rotations import Array
from workers.replay import Replay

FeatureName = Literal["facing", "rotation"]

FEATURES: dict[FeatureName, FeatureSpec] = {
    # Three trainings of one take-off state with different seeds differed by up to 0.3 rad: what counts as another
    # strategy must be further apart than that. 0.4 rad, 23 degrees, is also what a person sees at once.
    "facing": FeatureSpec("euclidean", ("facing",), distinct=0.4, low=(0.0,), high=(math.pi,), unit="rad"),
    # Jumps from one published take-off state, trained with five seeds, are turned 0.17 rad apart (median; nine of ten
    # pairs less than 0.48), those from two states 1.04 (`python -m benchmarks.jumps --compare evaluation --print`).
    "rotation": FeatureSpec("rotation", ("x", "y", "z", "w"), distinct=0.6, unit="rad"),
}


def facing(orientation: Array) -> float:
    """Angle in [0, pi] between the root's forward axis and world up.

    0 is face up, pi/2 upright or sideways, pi face down.
    """
    forward = rotations.rotate(orientation, np.array([1.0, 0.0, 0.0]))
    return float(np.arccos(np.clip(forward[1], -1.0, 1.0)))


def behaviour_of(orientation: Array, spec: FeatureSpec) -> tuple[float, ...]:
    """The behaviour of a jump whose root was turned so ``[4]`` over the bar, in the coordinates of `spec`."""
    if spec.kind == "rotation":
        return tuple(float(v) for v in orientation)
    return (facing(orientation),)


@dataclass(slots=True)
class Passing:
    """Watches the centre of mass come to the bar's plane: `over_the_bar` for a jump that isn't recorded.

    `orientation` is the root's as it passed ``[4]``, w >= 0; None before.
    """

    orientation: Array | None = None
    _x: float = math.nan
    _turned: Array | None = None

    def look(self, x: float, orientation: Array) -> None:
        """Take a frame: where the centre of mass is (m from the plane), and how the root is turned ``[4]``."""
        if x >= 0 and self._turned is not None:
            self.orientation = between(self._turned, orientation, -self._x / (x - self._x))
        self._x, self._turned = x, orientation


def between(a: Array, b: Array, fraction: float) -> Array:
    """The unit quaternion at a fraction of the way from `a` to `b` ``[4]``, w >= 0."""
    orientation = rotations.interpolate(a, b, fraction)
    orientation = orientation / np.linalg.norm(orientation)
    return -orientation if orientation[3] < 0 else orientation


def over_the_bar(replay: Replay) -> tuple[float, Array] | None:
    """When the centre of mass passes the bar's plane (s), and the root's orientation then ``[4]``; None if it doesn't.

    Between two frames the orientation is interpolated, so that the feature does not jump with the frame. The
    quaternion's sign is chosen so that w >= 0.
    """
    x = replay.arrays["com"][:, 0]
    behind = np.flatnonzero(x >= 0)
    if len(behind) == 0 or behind[0] == 0:
        return None
    after = int(behind[0])
    fraction = float(-x[after - 1] / (x[after] - x[after - 1]))
    a, b = replay.arrays["orientation"][after - 1 : after + 1, 0].astype(np.float64)
    return (after - 1 + fraction) * float(replay.header["frame_seconds"]), between(a, b, fraction)
