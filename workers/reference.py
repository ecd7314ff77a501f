"""A motion-capture clip as a replay, to be looked at beside a trial's.

Clips are in the DeepMimic text form (Peng et al. 2018): JSON with `Frames`, each of 44 numbers: duration (s), root
position (m, y up), root quaternion (w first), then the joints in the order of `ORDER`, a quaternion (w first) for the
spherical ones and an angle (rad) for knees and elbows.
"""

from __future__ import annotations

import json
import threading

import numpy as np

from workers.contracts import BadJob
from workers.physics import rotations
from workers.physics.athlete import REVOLUTE, SPHERICAL
from workers.physics.rotations import Array
from workers.physics.world import FRAME, Contacts, World
from workers.replay import Recorder, Replay

ORDER = (
    "chest", "neck", "right_hip", "right_knee", "right_ankle", "right_shoulder", "right_elbow",
    "left_hip", "left_knee", "left_ankle", "left_shoulder", "left_elbow",
)  # fmt: skip
NUMBERS = 44
LONGEST = 30.0
"""Seconds of a clip at most."""
_TRAVELS = 0.5
"""Metres: a clip that moves less than this on its way to its highest point has no direction."""
_ONE_AT_A_TIME = threading.Lock()


def read_clip(text: str) -> Array:
    """The frames of a clip ``n x 44``.

    Raises:
        BadJob: the text is no clip; the message says what was expected.
    """
    try:
        frames = np.asarray(json.loads(text)["Frames"], dtype=float)
    except (ValueError, KeyError, TypeError, RecursionError):
        raise BadJob("clip: expected JSON with `Frames`, rows of 44 numbers (DeepMimic), found no such thing") from None
    if frames.ndim != 2 or frames.shape[1] != NUMBERS or len(frames) < 2:
        shape = " x ".join(str(n) for n in frames.shape)
        raise BadJob(f"clip: expected at least 2 frames of {NUMBERS} numbers (DeepMimic), found {shape}")
    if not np.isfinite(frames).all() or (frames[:-1, 0] <= 0).any():
        raise BadJob("clip: expected finite numbers, and durations above 0 s, found others")
    seconds = float(frames[:-1, 0].sum())
    if seconds > LONGEST:
        raise BadJob(f"clip: expected at most {LONGEST:.0f} s, found {seconds:.1f} s")
    return frames


def replay_of_clip(text: str, bar: float) -> Replay:
    """The clip's motion at the frame rate of replays, its highest point over the bar, its way there along x.

    Args:
        text: the clip.
        bar: height of the bar beside which it is shown, m; it is only drawn.

    Raises:
        BadJob: the text is no clip.
    """
    roots, turns, spherical, revolute = _resampled(read_clip(text))
    # Bullet's functions hold no lock of their own, and a server calls from several threads.
    with _ONE_AT_A_TIME:
        world = World()
        try:
            world.set_bar(bar)
            path = np.array([_shown(world, *state) for state in zip(roots, turns, spherical, revolute, strict=True)])
            top = int(np.argmax(path[:, 1]))
            along = path[top] - path[0]
            angle = float(np.arctan2(along[2], along[0])) if np.hypot(along[0], along[2]) > _TRAVELS else 0.0
            turn = np.array([0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2)])
            foot = path[top] * [1, 0, 1]
            recorder = Recorder("none", {"name": "reference clip"})
            recorder.start(world)
            for root, orientation, balls, hinges in zip(roots, turns, spherical, revolute, strict=True):
                placed = rotations.rotate(turn, root - foot)
                _shown(world, placed, rotations.multiply(turn, orientation), balls, hinges)
                recorder.add(world, Contacts())
            return recorder.replay()
        finally:
            world.close()


def _shown(world: World, root: Array, turn: Array, balls: Array, hinges: Array) -> Array:
    """Put the athlete into a state; its centre of mass ``[3]``."""
    world.athlete.place(root, turn)
    pose = np.concatenate([rotations.to_rotation_vector(balls).ravel(), hinges])
    world.athlete.bend(pose, np.zeros_like(pose))
    return world.athlete.centre_of_mass(world.athlete.links())


def _resampled(frames: Array) -> tuple[Array, Array, Array, Array]:
    """Root position ``n x 3`` and orientation ``n x 4``, joints ``n x 8 x 4`` and ``n x 4``, one row a `FRAME`."""
    start = np.concatenate([[0.0], np.cumsum(frames[:-1, 0])])
    times = np.arange(0.0, start[-1], FRAME)
    before = np.clip(np.searchsorted(start, times, side="right") - 1, 0, len(frames) - 2)
    share = (times - start[before]) / (start[before + 1] - start[before])
    columns, at = {}, 8
    for name in ORDER:
        width = 4 if name in SPHERICAL else 1
        columns[name] = slice(at, at + width)
        at += width

    def numbers(where: slice) -> Array:
        return np.asarray(frames[before, where] + share[:, None] * (frames[before + 1, where] - frames[before, where]))

    def turned(where: slice) -> Array:
        q = np.roll(frames[:, where], -1, axis=1)
        q = q / np.linalg.norm(q, axis=1, keepdims=True)
        return np.array([
            rotations.interpolate(q[i], q[i + 1], float(part)) for i, part in zip(before, share, strict=True)
        ])  # fmt: skip

    spherical = np.stack([turned(columns[name]) for name in SPHERICAL], axis=1)
    revolute = np.concatenate([numbers(columns[name]) for name in REVOLUTE], axis=1)
    return numbers(slice(1, 4)), turned(slice(4, 8)), spherical, revolute
