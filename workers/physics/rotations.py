"""Rotations as unit quaternions (x, y, z, w) and as rotation vectors (axis times angle, rad).

Every function works on the last axis and broadcasts over the others. World frame: x along the jump, y up, z to the
right of an athlete who faces x; right-handed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TINY = 1e-20
IDENTITY: Array = np.array([0.0, 0.0, 0.0, 1.0])


def multiply(a: NDArray[Any], b: NDArray[Any]) -> Array:
    """Quaternion product ``[..., 4]``: first `b`, then `a`."""
    ax, ay, az, aw = np.moveaxis(np.asarray(a, np.float64), -1, 0)
    bx, by, bz, bw = np.moveaxis(np.asarray(b, np.float64), -1, 0)
    product: Array = np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        -1,
    )
    return product


def conjugate(q: NDArray[Any]) -> Array:
    """The opposite rotation ``[..., 4]``."""
    opposite: Array = np.asarray(q, np.float64) * np.array([-1.0, -1.0, -1.0, 1.0])
    return opposite


def from_rotation_vector(e: NDArray[Any]) -> Array:
    """Quaternions ``[..., 4]`` of rotation vectors ``[..., 3]``."""
    e = np.asarray(e, np.float64)
    # by numpy's plainest functions: this is called for every new target, and few numbers are turned at a time
    angle = np.sqrt(np.add.reduce(e * e, -1, keepdims=True))
    half = np.pi * (angle / (2 * np.pi))
    half[angle == 0] = np.pi * _TINY  # sin(half) / half is then exactly 1
    q = np.empty((*e.shape[:-1], 4))
    np.multiply(e, 0.5 * (np.sin(half) / half), out=q[..., :3])
    np.cos(angle / 2, out=q[..., 3:])
    return q


def to_rotation_vector(q: NDArray[Any]) -> Array:
    """Rotation vectors ``[..., 3]`` of quaternions ``[..., 4]``, angle in [0, pi]."""
    q = np.asarray(q, np.float64)
    q = np.where(q[..., 3:] < 0, -q, q)
    length = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    small = length < 1e-8
    factor = np.where(small, 2.0, 2 * np.arctan2(length, q[..., 3:]) / np.where(small, 1.0, length))
    vector: Array = q[..., :3] * factor
    return vector


def rotate(q: NDArray[Any], v: NDArray[Any]) -> Array:
    """Vectors ``[..., 3]`` turned by quaternions ``[..., 4]``."""
    q, v = np.asarray(q, np.float64), np.asarray(v, np.float64)
    u = q[..., :3]
    turned: Array = v + 2 * np.cross(u, np.cross(u, v) + q[..., 3:] * v)
    return turned


def angle_between(a: NDArray[Any], b: NDArray[Any]) -> Array:
    """Angle in [0, pi] of the rotation from `a` to `b` ``[...]``; q and -q are the same rotation."""
    return np.asarray(np.linalg.norm(to_rotation_vector(multiply(b, conjugate(a))), axis=-1))


def interpolate(a: NDArray[Any], b: NDArray[Any], fraction: float) -> Array:
    """The rotation a fraction in [0, 1] of the way from `a` to `b` ``[4]`` (slerp, the short way)."""
    return multiply(from_rotation_vector(fraction * to_rotation_vector(multiply(b, conjugate(a)))), a)
