"""The approach that a run-up follows: a captured run that turns into the take-off state in its last stride.

The packaged run is straight and goes on for ever; one from a file ends in a jump, and is followed along its curve. Both
are played at the speed of the take-off state.
"""

from __future__ import annotations

import functools
import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.physics import clips, rotations
from workers.physics.athlete import SPHERICAL
from workers.physics.clips import Clip
from workers.physics.kinematics import skeleton
from workers.physics.rotations import Array
from workers.tasks.high_jump.captured import flight_span
from workers.tasks.high_jump.takeoff import MID_SUPPORT_FRAME, RUN, StartState
from workers.tasks.imitation.reference import Moment, Reference

SECONDS = 0.6
"""How long it is at most."""
BLEND = 0.25
"""s before the take-off in which the run turns into it."""
_AFTER = 0.1
"""s that the reference goes on after the take-off state, at its velocities."""
_JUMP = 0.25
"""s in the air; a runner's stride has 0.15."""
_SUPPORT = 0.2
"""s before the flight in which the take-off foot bears on the ground."""
_SOLE = 0.027
"""Height of a foot's centre where it stands, m."""
_TURNED = 3 * len(SPHERICAL)


@dataclass(frozen=True, slots=True)
class Run:
    """A captured run that a run-up follows.

    Args:
        clip: it.
        frame: of the clip, in the middle of the support by the take-off foot that the run-up ends in.
        cyclic: whether it runs along x, and goes on from where it ends; else it is followed as it is, curves included.
        sha256: of its file, which can change; None for the packaged run.
    """

    clip: Clip
    frame: int
    cyclic: bool
    sha256: str | None = None


@functools.cache
def captured_run(path: str | None) -> Run:
    """The run in a file in the DeepMimic form that ends in a jump, or the packaged one.

    Raises `BadClip`: there is no jump, it is not from the right foot, or too little comes before it.
    """
    if path is None:
        return Run(clips.load(RUN), MID_SUPPORT_FRAME, cyclic=True)
    clip = clips.read(Path(path).expanduser())
    left_the_ground, landed = flight_span(clip)
    if (landed - left_the_ground) * clip.period < _JUMP:
        raise clips.BadClip(
            f"{path}: expected a run that ends in a jump of {_JUMP:g} s or more, found at most "
            f"{(landed - left_the_ground) * clip.period:.2f} s in the air"
        )
    body = skeleton()
    position = body.forward(clip.pose, clip.root, clip.orientation).position
    right, left = (position[:, body.names.index(name)] for name in ("right_ankle", "left_ankle"))
    earliest = max(0, left_the_ground - round(_SUPPORT / clip.period))
    if (earliest + 1) * clip.period <= SECONDS:
        raise clips.BadClip(
            f"{path}: expected a run of {SECONDS + _SUPPORT:g} s or more before a jump, found its take-off at "
            f"{left_the_ground * clip.period:.2f} s"
        )
    support = slice(earliest, left_the_ground + 1)
    if right[support, 1].min() > left[support, 1].min():
        raise clips.BadClip(f"{path}: expected a take-off from the right foot, found one from the left")
    speed = np.linalg.norm(np.gradient(right, clip.period, axis=0), axis=1)
    # another skeleton was captured, whose legs are longer: let this one's feet reach the ground
    floats = float(np.quantile(np.minimum(right[:, 1], left[:, 1]), 0.05)) - _SOLE
    clip = replace(clip, root=clip.root - np.array([0.0, floats, 0.0]))
    sha256 = hashlib.sha256(Path(path).expanduser().read_bytes()).hexdigest()
    return Run(clip, earliest + int(speed[support].argmin()), cyclic=False, sha256=sha256)


def reference_of(start: StartState, run: Run, seconds: float = SECONDS) -> Reference:
    """The run that ends in a take-off state.

    Args:
        start: the take-off state.
        run: what it is made of.
        seconds: how long it lasts; the reference goes on a little longer, at the velocities of the take-off.
    """
    clip, period = run.clip, 1 / 240
    count = round((seconds + _AFTER) / period)
    before = (np.arange(count + 1) * period - seconds)[:, None]  # the take-off is at 0
    weight = _smooth(1 + before / BLEND)
    captured = Reference(clip, cyclic=run.cyclic)
    speed = float(np.hypot(start.velocity[0], start.velocity[2]))
    took_off = run.frame * clip.period
    tempo = speed / _speed(captured, took_off)
    times = took_off + tempo * before[:, 0]
    moments = [captured.at(t % captured.seconds if run.cyclic else max(t, 0.0)) for t in times]
    # along the curve of the clip, as far as it has turned since, at the speed of the take-off
    turned, last = _course(moments, before[:, 0])
    turned = (1 - weight[:, 0]) * turned
    end = math.atan2(-start.velocity[2], start.velocity[0])
    way = speed * np.stack([np.cos(end + turned), np.zeros(len(turned)), -np.sin(end + turned)], 1) * period
    root = np.cumsum(way, 0)
    root = start.position + root - root[int(np.argmin(np.abs(before)))] + start.velocity * before * [0, 1, 0]
    height = np.array([moment.root[1] for moment in moments])[:, None]
    root[:, 1:2] = (1 - weight) * height + weight * root[:, 1:2]
    heading = rotations.from_rotation_vector(np.array([0, end - last, 0]))
    running = rotations.multiply(heading, np.stack([moment.orientation for moment in moments]))
    turning = rotations.multiply(
        rotations.from_rotation_vector(start.angular_velocity * np.maximum(before, -BLEND)), start.orientation
    )
    pose = np.stack([moment.pose for moment in moments])
    towards = start.pose + start.rates * np.maximum(before, -BLEND / 2)
    turns = rotations.to_rotation_vector(_mixed(_turns(pose), _turns(towards), weight[:, None]))
    angles = (1 - weight) * pose[:, _TURNED:] + weight * towards[:, _TURNED:]
    blended = np.concatenate([turns.reshape(len(turns), -1), angles], 1)
    motion = Clip(period, root, _mixed(running, turning, weight), blended, np.zeros_like(blended))
    return Reference(motion, cyclic=False)


def _speed(captured: Reference, took_off: float) -> float:
    """Of a captured run, m/s: of a cycle, or of the stride before the take-off, which slows the body down."""
    if captured.cyclic:
        return float(np.linalg.norm(captured.advance)) / captured.seconds
    way = captured.at(took_off - _SUPPORT).root - captured.at(took_off - SECONDS).root
    return float(np.hypot(way[0], way[2])) / (SECONDS - _SUPPORT)


def _course(moments: Sequence[Moment], before: NDArray[Any]) -> tuple[Array, float]:
    """Where a run leads at each moment: its angle about the vertical from that of the take-off on (rad), and that one.

    The root sways with each step, so both are means over a tenth of a second.
    """
    velocity = np.stack([moment.velocity for moment in moments])
    angle = np.unwrap(np.arctan2(-velocity[:, 2], velocity[:, 0]))
    width = min(24, len(angle))
    padded = np.pad(angle, (width // 2, width - 1 - width // 2), mode="edge")
    smooth = np.convolve(padded, np.full(width, 1 / width), mode="valid")
    last = float(smooth[np.abs(before) < _SUPPORT / 2].mean())
    return smooth - last, last


def _smooth(x: NDArray[Any]) -> Array:
    x = np.clip(x, 0, 1)
    return np.asarray(x * x * (3 - 2 * x), np.float64)


def _turns(pose: Array) -> Array:
    return rotations.from_rotation_vector(pose[:, :_TURNED].reshape(len(pose), -1, 3))


def _mixed(a: Array, b: Array, share: Array) -> Array:
    """Rotations on the way from `a` to `b` (slerp)."""
    way = rotations.to_rotation_vector(rotations.multiply(b, rotations.conjugate(a)))
    return rotations.multiply(rotations.from_rotation_vector(share * way), a)
