"""What is to be imitated: a clip at any time, for as long as one likes.

A clip that is marked as cyclic goes on from where it ends: its poses begin again, its root goes on from its last place
on the ground. Another one ends in its last pose, which is then to be held. Everything is laid out once, 240 times a
second, and looked up: half a sample away a hand at 5 m/s is 1 cm off.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workers.contracts import BadSetting
from workers.physics import clips, rotations
from workers.physics.athlete import SPHERICAL
from workers.physics.clips import Clip
from workers.physics.kinematics import skeleton
from workers.physics.rotations import Array
from workers.user_code import suggestion

RATE = 240
"""Samples a second."""
ENDS = ("right_ankle", "left_ankle", "right_elbow", "left_elbow")
"""Bodies that end the limbs: feet, and forearms with hands."""
_TURNED = 3 * len(SPHERICAL)
_NEAR_GROUND = 0.25
"""m; a trunk that the clip itself brings lower may touch the ground."""
_TRUNK = ("root", "chest", "neck")


@dataclass(frozen=True, slots=True)
class Moment:
    """The reference at one time.

    Args:
        root: position of the root ``[3]``, m.
        orientation: of the root ``[4]``.
        velocity, spin: of the root ``[3]``, m/s and rad/s, world frame.
        pose, rates: of the joints ``[28]``.
        turns: rotations of the spherical joints ``[8, 4]``.
        ends: positions of `ENDS` relative to the root ``[4, 3]``, m.
        com: centre of mass ``[3]``, m.
        com_velocity: its velocity ``[3]``, m/s.
    """

    root: Array
    orientation: Array
    velocity: Array
    spin: Array
    pose: Array
    rates: Array
    turns: Array
    ends: Array
    com: Array
    com_velocity: Array


class Reference:
    """A clip, laid out.

    Args:
        clip: the motion.
        cyclic: whether it goes on from where it ends.
    """

    def __init__(self, clip: Clip, *, cyclic: bool) -> None:
        self.cyclic = cyclic
        self.seconds = (len(clip.pose) - 1) * clip.period
        """Of one cycle, or of the whole motion."""
        self._count = max(2, round(self.seconds * RATE))
        self._step = self.seconds / self._count
        root, orientation, turns, angles = _states(clip, np.linspace(0.0, self.seconds, self._count + 1))
        self.advance: Array = (clip.root[-1] - clip.root[0]) * np.array([1.0, 0.0, 1.0]) if cyclic else np.zeros(3)
        """How far a cycle leads ``[3]``, m."""
        # Differences stay within the cycle: its last pose is not quite its first, which is no motion.
        at = np.arange(self._count + 1)
        before, after = np.maximum(at - 1, 0), np.minimum(at + 1, self._count)
        span = (after - before)[:, None] * self._step
        self._velocity = (root[after] - root[before]) / span
        between = rotations.multiply(orientation[after], rotations.conjugate(orientation[before]))
        self._spin = rotations.to_rotation_vector(between) / span
        turned = rotations.to_rotation_vector(rotations.multiply(rotations.conjugate(turns[before]), turns[after]))
        self._rates = np.concatenate([turned.reshape(len(at), -1), angles[after] - angles[before]], 1) / span
        self._root, self._orientation, self._turns = root, orientation, turns
        flat = rotations.to_rotation_vector(self._turns).reshape(len(self._turns), -1)
        self._pose = np.concatenate([flat, angles], 1)
        body = skeleton()
        placed = body.forward(self._pose, self._root, self._orientation).position
        ends = [body.names.index(name) for name in ENDS]
        self._ends = placed[:, ends] - placed[:, :1]
        self._com = body.centre_of_mass(placed)
        self._com_velocity = (self._com[after] - self._com[before]) / span
        lowest = placed[:, :, 1].min(0)
        self.upright: tuple[str, ...] = tuple(name for name in _TRUNK if lowest[body.names.index(name)] > _NEAR_GROUND)
        """Bodies that never come near the ground in the clip: if they touch it, the imitation has failed."""

    def at(self, time: float) -> Moment:
        """The reference `time` seconds (at least 0) after its beginning."""
        cycles, rest = divmod(time, self.seconds) if self.cyclic else (0.0, min(time, self.seconds))
        i = min(round(rest / self._step), self._count)
        over = not self.cyclic and time >= self.seconds
        shift = cycles * self.advance
        still = 0.0 if over else 1.0
        return Moment(
            self._root[i] + shift,
            self._orientation[i],
            still * self._velocity[i],
            still * self._spin[i],
            self._pose[i],
            still * self._rates[i],
            self._turns[i],
            self._ends[i],
            self._com[i] + shift,
            still * self._com_velocity[i],
        )

    def phase(self, time: float) -> tuple[float, float]:
        """What tells the policy where it is: a point on the circle for a cycle, on half of it for what ends."""
        share = (time / self.seconds) % 1.0 if self.cyclic else min(time / self.seconds, 1.0) / 2
        return float(np.cos(2 * np.pi * share)), float(np.sin(2 * np.pi * share))


def _states(clip: Clip, times: NDArray[np.float64]) -> tuple[Array, Array, Array, Array]:
    """Root ``[n, 3]``, its orientation ``[n, 4]``, spherical joints ``[n, 8, 4]`` and hinges ``[n, 4]`` at `times`."""
    before = np.minimum((times / clip.period).astype(int), len(clip.pose) - 2)
    share = np.minimum(times / clip.period - before, 1.0)[:, None]
    turns = rotations.from_rotation_vector(clip.pose[:, :_TURNED].reshape(len(clip.pose), -1, 3))

    def mixed(values: Array) -> Array:
        return np.asarray(values[before] + share * (values[before + 1] - values[before]))

    def turned(q: Array, part: Array) -> Array:
        way = rotations.to_rotation_vector(rotations.multiply(q[before + 1], rotations.conjugate(q[before])))
        return rotations.multiply(rotations.from_rotation_vector(part * way), q[before])

    return (
        mixed(clip.root),
        turned(clip.orientation, share),
        turned(turns, share[:, None]),
        mixed(clip.pose[:, _TURNED:]),
    )


def names() -> list[str]:
    """The packaged clips, by name."""
    return [path.stem.removeprefix("humanoid3d_") for path in clips.packaged()]


def find(clip: str) -> Path:
    """The file of a packaged clip, or of one's own. Raises `BadSetting`."""
    path = Path(clip).expanduser()
    if path.suffix or path.parent != Path():
        return path
    if clip not in names():
        known = ", ".join(names())
        raise BadSetting(
            "task.settings", "clip", f"expected a clip or the path of one, found {clip!r}{suggestion(clip, names())}; "
            f"known are {known}",
        )  # fmt: skip
    return next(each for each in clips.packaged() if each.stem == f"humanoid3d_{clip}")


def read(clip: str) -> Reference:
    """The reference of a packaged clip, or of a file. Raises `BadSetting`."""
    path = find(clip)
    try:
        motion = clips.read(path)
    except clips.BadClip as error:
        raise BadSetting("task.settings", "clip", str(error)) from None
    return Reference(motion, cyclic=json.loads(path.read_text()).get("Loop") == "wrap")
