"""Motion clips in the DeepMimic text form, as pybullet_data carries them: poses for a start, never for imitation."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pybullet_data

from workers.physics import rotations
from workers.physics.athlete import REVOLUTE, SPHERICAL
from workers.physics.rotations import Array

_ORDER = (
    "chest", "neck", "right_hip", "right_knee", "right_ankle", "right_shoulder", "right_elbow",
    "left_hip", "left_knee", "left_ankle", "left_shoulder", "left_elbow",
)  # fmt: skip
"""Joints in the order of a frame (DeepMimic, Peng et al. 2018)."""


@dataclass(frozen=True, slots=True)
class Clip:
    """A motion in the athlete's own coordinates.

    Args:
        period: seconds between two frames.
        root: positions of the root ``[frame, 3]``, m.
        pose: joint coordinates ``[frame, 28]``: rotation vectors of the spherical joints, then angles, rad.
        rates: their rates by central differences ``[frame, 28]``, in the child's frame, rad/s; 0 at both ends.
    """

    period: float
    root: Array
    pose: Array
    rates: Array

    def velocity(self, frame: int) -> Array:
        """Velocity of the root at an inner frame ``[3]``, m/s."""
        return np.asarray((self.root[frame + 1] - self.root[frame - 1]) / (2 * self.period))


@functools.cache
def load(name: str) -> Clip:
    """The clip `humanoid3d_<name>` of pybullet_data."""
    path = Path(pybullet_data.getDataPath()) / "data" / "motions" / f"humanoid3d_{name}.txt"
    frames = np.array(json.loads(path.read_text())["Frames"], np.float64)
    columns: dict[str, Array] = {}
    at = 8  # duration, root position, root orientation
    for joint in _ORDER:
        width = 1 if joint in REVOLUTE else 4
        columns[joint] = frames[:, at : at + width]
        at += width
    # the text writes w first
    quaternions = np.stack([np.roll(columns[joint], -1, axis=1) for joint in SPHERICAL], 1)
    angles = np.concatenate([columns[joint] for joint in REVOLUTE], 1)
    period = float(frames[0, 0])
    rates = np.zeros((len(frames), 3 * len(SPHERICAL) + len(REVOLUTE)))
    turn = rotations.multiply(rotations.conjugate(quaternions[:-2]), quaternions[2:])
    rates[1:-1, : 3 * len(SPHERICAL)] = rotations.to_rotation_vector(turn).reshape(len(turn), -1) / (2 * period)
    rates[1:-1, 3 * len(SPHERICAL) :] = (angles[2:] - angles[:-2]) / (2 * period)
    pose = np.concatenate([rotations.to_rotation_vector(quaternions).reshape(len(frames), -1), angles], 1)
    return Clip(period, frames[:, 1:4], pose, rates)
