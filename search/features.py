"""Behaviours and how far two of them are apart: vectors, angles on a circle, rotations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from search.errors import BadFeatures

Array = NDArray[np.float64]

QUATERNION_TOLERANCE = 1e-3
"""How far the norm of a unit quaternion may be from 1: single precision and printing, not another quantity."""


def _bounds(value: float | Sequence[float], d: int, side: str) -> tuple[float, ...]:
    values = [float(value)] * d if isinstance(value, (int, float)) else [float(v) for v in value]
    if len(values) != d:
        raise BadFeatures(f"Features.euclidean: expected {d} values for {side}, found {len(values)}")
    return tuple(values)


@dataclass(frozen=True, slots=True)
class Features:
    """A feature space with its metric. Made by `euclidean`, `circle` or `rotation`.

    Args:
        kind: which metric.
        d: number of coordinates a behaviour is reported in.
        low, high: range of each coordinate. Euclidean features may leave it; it sets the prior of the surrogates.
    """

    kind: Literal["euclidean", "circle", "rotation"]
    d: int
    low: tuple[float, ...]
    high: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.kind not in {"euclidean", "circle", "rotation"}:
            raise BadFeatures(f"expected features of kind euclidean, circle or rotation, found {self.kind!r}")
        if not isinstance(self.d, int) or self.d < 1:
            raise BadFeatures(f"Features.{self.kind}: expected d >= 1, found {self.d!r}")
        if len(self.low) != self.d or len(self.high) != self.d:
            raise BadFeatures(
                f"Features.{self.kind}: expected {self.d} bounds, found {len(self.low)}, {len(self.high)}"
            )
        for i, (low, high) in enumerate(zip(self.low, self.high, strict=True)):
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise BadFeatures(f"Features.{self.kind}: expected low < high for coordinate {i}, found {low}, {high}")

    @classmethod
    def euclidean(cls, d: int, low: float | Sequence[float] = 0.0, high: float | Sequence[float] = 1.0) -> Features:
        """Vectors under the Euclidean distance in natural units.

        Args:
            d: how many coordinates, at least 1.
            low: lower end of what is expected, for all coordinates or for each; behaviours may lie beyond.
            high: upper end, likewise; above `low`.

        Raises:
            BadFeatures: no whole number of coordinates above 0, other than `d` bounds, bounds reversed or not finite.
        """
        if isinstance(d, bool) or not isinstance(d, int) or d < 1:
            raise BadFeatures(f"Features.euclidean: expected d >= 1, found {d!r}")
        return cls("euclidean", d, _bounds(low, d, "low"), _bounds(high, d, "high"))

    @classmethod
    def circle(cls) -> Features:
        """One angle in radians; the distance is the shorter way round, in [0, pi]."""
        return cls("circle", 1, (-math.pi,), (math.pi,))

    @classmethod
    def rotation(cls) -> Features:
        """Unit quaternions (x, y, z, w); q and -q are the same. The distance is the angle between them, [0, pi]."""
        return cls("rotation", 4, (-1.0,) * 4, (1.0,) * 4)

    def check(self, features: Any) -> Array:
        """One behaviour as ``d`` canonical coordinates: angles in [-pi, pi), quaternions of norm 1.

        Raises:
            BadFeatures: wrong length, not numbers, not finite, a quaternion that is not of norm 1.
        """
        try:
            y = np.asarray(features, dtype=float).reshape(-1)
        except (TypeError, ValueError):
            raise BadFeatures(f"expected {self.d} numbers as {self.kind} features, found {features!r}") from None
        if y.shape != (self.d,):
            raise BadFeatures(f"expected {self.d} numbers as {self.kind} features, found {y.size}: {features!r}")
        if not np.isfinite(y).all():
            raise BadFeatures(f"expected finite {self.kind} features, found {y.tolist()}")
        if self.kind == "rotation" and abs(float(np.linalg.norm(y)) - 1) > QUATERNION_TOLERANCE:
            raise BadFeatures(
                f"expected a unit quaternion (x, y, z, w), found norm {np.linalg.norm(y):.6g}: {y.tolist()}"
            )
        return self.canonical(y)

    def canonical(self, Y: Array) -> Array:
        """``... x d`` behaviours in their canonical coordinates."""
        if self.kind == "circle":
            # an angle that lies there already is left as it is, to the last bit
            inside = (-np.pi <= Y) & (np.pi > Y)
            return np.asarray(np.where(inside, Y, (Y + np.pi) % (2 * np.pi) - np.pi))
        if self.kind == "rotation":
            Y = Y / np.linalg.norm(Y, axis=-1, keepdims=True)
            # of q and -q the one whose last non-zero coordinate is positive, so that equal rotations are equal arrays
            sign = np.ones(Y.shape[:-1])
            for i in range(4):
                sign = np.where(Y[..., i] != 0, np.sign(Y[..., i]), sign)
            return np.asarray(Y * sign[..., None])
        return np.asarray(Y, dtype=float)

    def distance(self, A: Array, B: Array) -> Array:
        """Distance between ``... x d`` behaviours, broadcast; ``...``, in the metric's unit."""
        if self.kind == "circle":
            gap = np.abs(A - B)[..., 0] % (2 * np.pi)
            return np.asarray(np.minimum(gap, 2 * np.pi - gap))
        if self.kind == "rotation":
            # atan2 keeps its precision near 0 and pi, where arccos of the inner product loses half the digits
            near, far = np.linalg.norm(A - B, axis=-1), np.linalg.norm(A + B, axis=-1)
            return np.asarray(4 * np.arctan2(np.minimum(near, far), np.maximum(near, far)))
        return np.asarray(np.linalg.norm(A - B, axis=-1))

    def pairwise(self, A: Array, B: Array) -> Array:
        """Distances ``n x m`` between ``n x d`` and ``m x d`` behaviours."""
        return self.distance(A[:, None, :], B[None, :, :])

    @property
    def diameter(self) -> float:
        """The largest distance in the declared range: pi for circles and rotations."""
        if self.kind == "euclidean":
            return float(np.linalg.norm(np.subtract(self.high, self.low)))
        return math.pi
