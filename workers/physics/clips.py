"""Motion clips in the DeepMimic text form: those that pybullet_data carries, and captured ones in files."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pybullet_data
from numpy.typing import NDArray

from workers.contracts import BadJob
from workers.physics import rotations
from workers.physics.athlete import REVOLUTE, SPHERICAL
from workers.physics.rotations import Array

_ORDER = (
    "chest", "neck", "right_hip", "right_knee", "right_ankle", "right_shoulder", "right_elbow",
    "left_hip", "left_knee", "left_ankle", "left_shoulder", "left_elbow",
)  # fmt: skip
"""Joints in the order of a frame (DeepMimic, Peng et al. 2018)."""
_VALUES = 8 + sum(1 if joint in REVOLUTE else 4 for joint in _ORDER)
"""Numbers in a frame: duration, position and orientation of the root, then the joints."""
_UNIT = 0.5
"""Furthest that the length of a quaternion may be from 1. Clips that were blended number by number are off: the
packaged kick by 0.42. Whatever is made of them here depends on the rotation alone."""

_SHOWN = 80
"""Characters of what was found, in messages."""


class BadClip(BadJob):
    """A file holds no motion of this athlete. The message says where, what was expected, and what was found."""


@dataclass(frozen=True, slots=True)
class Clip:
    """A motion in the athlete's own coordinates.

    Args:
        period: seconds between two frames.
        root: positions of the root ``[frame, 3]``, m.
        orientation: of the root ``[frame, 4]``.
        pose: joint coordinates ``[frame, 28]``: rotation vectors of the spherical joints, then angles, rad.
        rates: their rates by central differences ``[frame, 28]``, in the child's frame, rad/s; 0 at both ends.
    """

    period: float
    root: Array
    orientation: Array
    pose: Array
    rates: Array

    def velocity(self, frame: int) -> Array:
        """Velocity of the root at an inner frame ``[3]``, m/s."""
        return np.asarray((self.root[frame + 1] - self.root[frame - 1]) / (2 * self.period))


@dataclass(frozen=True, slots=True)
class Written:
    """A motion as a text of the DeepMimic form has it; quaternions are x y z w and nearly unit ones.

    Args:
        durations: of the frames ``[frame]``, s; that of the last one plays no part.
        root: positions of the root ``[frame, 3]``, m, y up.
        orientation: of the root ``[frame, 4]``.
        quaternions: of the spherical joints ``[frame, 8, 4]``, in the order of `SPHERICAL`.
        angles: of the hinges ``[frame, 4]``, in the order of `REVOLUTE`, rad.
    """

    durations: Array
    root: Array
    orientation: Array
    quaternions: Array
    angles: Array


def packaged() -> list[Path]:
    """The clips of this athlete that pybullet_data carries, by name."""
    return sorted((Path(pybullet_data.getDataPath()) / "data" / "motions").glob("humanoid3d_*.txt"))


@functools.cache
def load(name: str) -> Clip:
    """The clip `humanoid3d_<name>` of pybullet_data."""
    return read(Path(pybullet_data.getDataPath()) / "data" / "motions" / f"humanoid3d_{name}.txt")


def read(path: Path) -> Clip:
    """The clip in a file of the DeepMimic form. Raises `BadClip`."""
    try:
        text = path.read_text()
    except OSError as error:
        raise BadClip(f"{path}: expected a motion clip, found nothing to read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise BadClip(f"{path}: expected a motion clip, found bytes that are no text") from None
    written = parse(text, str(path))
    return from_joints(
        float(written.durations[0]), written.root, written.orientation, written.quaternions, written.angles
    )


def parse(text: str, name: str) -> Written:
    """The motion that a text of the DeepMimic form holds.

    Args:
        text: the text.
        name: what messages call it.

    Raises:
        BadClip: it holds none.
    """
    frames = _frames(text, name)
    columns: dict[str, Array] = {}
    at = 8  # duration, root position, root orientation
    for joint in _ORDER:
        width = 1 if joint in REVOLUTE else 4
        columns[joint] = frames[:, at : at + width]
        at += width
    # the text writes w first
    orientation = np.roll(frames[:, 4:8], -1, axis=1)
    quaternions = np.stack([np.roll(columns[joint], -1, axis=1) for joint in SPHERICAL], 1)
    _check_units(name, "root", orientation)
    for i, joint in enumerate(SPHERICAL):
        _check_units(name, joint, quaternions[:, i])
    angles = np.concatenate([columns[joint] for joint in REVOLUTE], 1)
    return Written(frames[:, 0], frames[:, 1:4], orientation, quaternions, angles)


def from_joints(period: float, root: Array, orientation: Array, quaternions: Array, angles: Array) -> Clip:
    """The clip of a root ``[frame, 3]``, ``[frame, 4]``, its spherical joints ``[frame, 8, 4]`` and hinges ``[.., 4]``.

    Args:
        period: seconds between two frames.
        root: its positions, m.
        orientation: its orientations.
        quaternions: in the order of `SPHERICAL`.
        angles: in the order of `REVOLUTE`, rad.
    """
    frames = len(root)
    rates = np.zeros((frames, 3 * len(SPHERICAL) + len(REVOLUTE)))
    turn = rotations.multiply(rotations.conjugate(quaternions[:-2]), quaternions[2:])
    rates[1:-1, : 3 * len(SPHERICAL)] = rotations.to_rotation_vector(turn).reshape(len(turn), -1) / (2 * period)
    rates[1:-1, 3 * len(SPHERICAL) :] = (angles[2:] - angles[:-2]) / (2 * period)
    pose = np.concatenate([rotations.to_rotation_vector(quaternions).reshape(frames, -1), angles], 1)
    length = np.linalg.norm(orientation, axis=1, keepdims=True)
    return Clip(period, root, orientation / length, pose, rates)


def _frames(text: str, path: str) -> Array:
    """The numbers of a clip ``[frame, 44]``."""
    try:
        rows = json.loads(text)["Frames"]
    # Text from anywhere: brackets in brackets exhaust the stack of the reader.
    except (ValueError, KeyError, TypeError, RecursionError):
        raise BadClip(f'{path}: expected a motion clip (JSON with "Frames"), found something else') from None
    if not isinstance(rows, list) or len(rows) < 2:
        found = len(rows) if isinstance(rows, list) else repr(rows)[:_SHOWN]
        raise BadClip(f"{path}: expected at least 2 frames, found {found}")
    for i, row in enumerate(rows):
        if not isinstance(row, list) or len(row) != _VALUES:
            found = f"{len(row)} values" if isinstance(row, list) else repr(row)[:_SHOWN]
            raise BadClip(
                f"{path}: frame {i}: expected {_VALUES} values (duration, root, 12 joints), found {found}; "
                "is it a clip of another character?"
            )
    try:
        frames = np.array(rows, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise BadClip(f"{path}: expected numbers only, found something else among them") from None
    if not np.isfinite(frames).all():
        raise BadClip(f"{path}: frame {int(np.argmax(~np.isfinite(frames).all(1)))}: expected finite numbers")
    if not frames[0, 0] > 0:
        raise BadClip(f"{path}: frame 0: expected a duration above 0 s, found {frames[0, 0]:g}")
    return frames


def _check_units(path: str, joint: str, quaternions: NDArray[np.float64]) -> None:
    lengths = np.linalg.norm(quaternions, axis=1)
    frame = int(np.abs(lengths - 1).argmax())
    if abs(lengths[frame] - 1) > _UNIT:
        raise BadClip(
            f"{path}: frame {frame}: {joint}: expected a unit quaternion (w x y z), "
            f"found one of length {lengths[frame]:.4g}"
        )
