"""A motion-capture clip as a replay, to be looked at beside a trial's. Clips are texts in the DeepMimic form."""

from __future__ import annotations

import threading

import numpy as np

from workers.physics import clips, rotations
from workers.physics.clips import BadClip, Written
from workers.physics.rotations import Array
from workers.physics.world import FRAME, Contacts, World
from workers.replay import Recorder, Replay

LONGEST = 30.0
"""Seconds of a clip at most."""
_TRAVELS = 0.5
"""Metres: a clip that moves less than this on its way to its highest point has no direction."""
_ONE_AT_A_TIME = threading.Lock()


def read_clip(text: str) -> Written:
    """The motion of a clip, which may be as long as `LONGEST`.

    Raises:
        BadClip: the text is no clip; the message says what was expected.
    """
    written = clips.parse(text, "clip")
    durations = written.durations[:-1]
    if (durations <= 0).any():
        frame = int(np.argmax(durations <= 0))
        raise BadClip(f"clip: frame {frame}: expected a duration above 0 s, found {durations[frame]:g}")
    seconds = float(durations.sum())
    if seconds > LONGEST:
        raise BadClip(f"clip: expected at most {LONGEST:.0f} s, found {seconds:.1f} s")
    return written


def replay_of_clip(text: str, bar: float) -> Replay:
    """The clip's motion at the frame rate of replays, its highest point over the bar, its way there along x.

    Args:
        text: the clip.
        bar: height of the bar beside which it is shown, m; it is only drawn.

    Raises:
        BadClip: the text is no clip.
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


def _resampled(written: Written) -> tuple[Array, Array, Array, Array]:
    """Root position ``n x 3`` and orientation ``n x 4``, joints ``n x 8 x 4`` and ``n x 4``, one row a `FRAME`."""
    start = np.concatenate([[0.0], np.cumsum(written.durations[:-1])])
    times = np.arange(0.0, start[-1], FRAME)
    before = np.clip(np.searchsorted(start, times, side="right") - 1, 0, len(start) - 2)
    share = (times - start[before]) / (start[before + 1] - start[before])

    def between(values: Array) -> Array:
        return np.asarray(values[before] + share[:, None] * (values[before + 1] - values[before]))

    def turned(quaternions: Array) -> Array:
        q = quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
        return np.array([
            rotations.interpolate(q[i], q[i + 1], float(part)) for i, part in zip(before, share, strict=True)
        ])  # fmt: skip

    balls = np.stack([turned(written.quaternions[:, joint]) for joint in range(written.quaternions.shape[1])], axis=1)
    return between(written.root), turned(written.orientation), balls, between(written.angles)
