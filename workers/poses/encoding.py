"""A pose as the autoencoder sees it, and back.

144 numbers: the centres of mass of the twelve bodies beside the root and the places of their joints, relative to the
root and in its frame (m), then the joints' rotations as the first two columns of their matrices, which is continuous
where angles are not (Zhou et al. 2019, "On the Continuity of Rotation Representations in Neural Networks").
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.physics import rotations
from workers.physics.athlete import JOINTS, REVOLUTE, SPHERICAL
from workers.physics.kinematics import joint_rotations, skeleton
from workers.physics.rotations import Array

SIZE = len(JOINTS) * (3 + 3 + 6)
"""Numbers of an encoded pose: 144."""
_ROTATIONS = len(JOINTS) * 6


def encode(pose: NDArray[Any]) -> Array:
    """Poses ``[n, 28]`` as ``[n, 144]``."""
    body = skeleton()
    n = len(pose)
    found = body.forward(pose, np.zeros((n, 3)), np.tile(rotations.IDENTITY, (n, 1)))
    turns = joint_rotations(pose, body.hinges)
    columns = [rotations.rotate(turns, axis) for axis in np.eye(3)[:2]]
    parts = (found.position[:, 1:], found.joint[:, 1:], np.concatenate(columns, -1))
    return np.concatenate([part.reshape(n, -1) for part in parts], 1)


def decode(encoded: NDArray[Any]) -> Array:
    """The poses ``[..., 28]`` of ``[..., 144]``: from the rotations alone, made orthonormal (Gram and Schmidt)."""
    six = np.asarray(encoded, np.float64)[..., -_ROTATIONS:]
    six = six.reshape(*six.shape[:-1], len(JOINTS), 6)
    x = six[..., :3] / (np.linalg.norm(six[..., :3], axis=-1, keepdims=True) + 1e-12)
    y = six[..., 3:] - (x * six[..., 3:]).sum(-1, keepdims=True) * x
    y = y / (np.linalg.norm(y, axis=-1, keepdims=True) + 1e-12)
    turned = rotations.to_rotation_vector(
        quaternions_of(np.stack([x, y, np.cross(x, y)], -1)[..., : len(SPHERICAL), :, :])
    )
    hinge = slice(len(SPHERICAL), len(SPHERICAL) + len(REVOLUTE))
    angles = np.arctan2(x[..., hinge, 1], x[..., hinge, 0])  # all hinges turn about z
    return np.concatenate([turned.reshape(*turned.shape[:-2], -1), angles], -1)


def quaternions_of(m: Array) -> Array:
    """Quaternions ``[..., 4]`` of rotation matrices ``[..., 3, 3]`` (Bar-Itzhack 2000, for exact ones).

    The four products of the largest component with all of them are written down without a division by what may be 0.
    """
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    a, b, c = m[..., 2, 1], m[..., 0, 2], m[..., 1, 0]
    d, e, f = m[..., 1, 2], m[..., 2, 0], m[..., 0, 1]
    rows = np.stack(
        [
            np.stack([1 + xx - yy - zz, c + f, b + e, a - d], -1),
            np.stack([c + f, 1 - xx + yy - zz, a + d, b - e], -1),
            np.stack([b + e, a + d, 1 - xx - yy + zz, c - f], -1),
            np.stack([a - d, b - e, c - f, 1 + xx + yy + zz], -1),
        ],
        -2,
    )
    largest = np.argmax(np.linalg.norm(rows, axis=-1), axis=-1)
    row = np.take_along_axis(rows, largest[..., None, None], -2)[..., 0, :]
    return np.asarray(row / np.linalg.norm(row, axis=-1, keepdims=True))


def latent_dimension(encoded: Array, share: float = 0.85) -> int:
    """How many principal components hold `share` of the variance of encoded poses ``[n, 144]``."""
    values = np.linalg.eigvalsh(np.cov(encoded.T))[::-1]
    explained = np.cumsum(np.maximum(values, 0)) / values.sum()
    return int(np.searchsorted(explained, share) + 1)
