"""Motion-capture clips as replays, from the clips that pybullet itself carries."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pybullet_data
import pytest

from workers.physics.clips import BadClip
from workers.physics.world import FRAME, World
from workers.reference import replay_of_clip
from workers.replay import Recorder, Replay

CLIP = (Path(pybullet_data.getDataPath()) / "data" / "motions" / "humanoid3d_jump.txt").read_text()
FRAMES = np.array(json.loads(CLIP)["Frames"])


def spoiled(column, value):
    """The clip with one column of numbers set."""
    frames = FRAMES.copy()
    frames[:, column] = value
    return json.dumps({"Frames": frames.tolist()})


def test_a_clip_keeps_its_duration_and_its_root_and_turns_to_the_bar():
    replay = replay_of_clip(CLIP, 0.7)
    frames = FRAMES
    assert replay.seconds == pytest.approx(frames[:-1, 0].sum(), abs=1.5 * FRAME)
    # a root's height is that of the clip, at the clip's own times
    times = np.concatenate([[0], np.cumsum(frames[:-1, 0])])
    heights = np.interp(np.arange(replay.frames) * FRAME, times, frames[:, 2])
    assert replay.arrays["position"][:, 0, 1] == pytest.approx(heights, abs=1e-4)
    path = replay.arrays["com"]
    top = int(np.argmax(path[:, 1]))
    assert path[top, [0, 2]] == pytest.approx([0, 0], abs=1e-3)
    assert replay.header["bar"] == pytest.approx(0.7)
    assert Replay.from_bytes(replay.to_bytes()).frames == replay.frames


def test_a_clip_that_travels_comes_along_x():
    frames = FRAMES.copy()
    frames[:, 1], frames[:, 3] = 0.0, np.linspace(0, 3, len(frames))
    path = replay_of_clip(json.dumps({"Frames": frames.tolist()}), 0.0).arrays["com"]
    top = int(np.argmax(path[:, 1]))
    assert path[0, 0] < -0.5
    assert path[0, 2] == pytest.approx(path[top, 2], abs=1e-3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("no JSON", r'clip: expected a motion clip \(JSON with "Frames"\)'),
        ("[" * 100_000, r'clip: expected a motion clip \(JSON with "Frames"\)'),
        ('{"Frames": [[1, 2], [3, 4]]}', r"clip: frame 0: expected 44 values .* found 2 values"),
        ('{"Frames": ["' + "a" * 9000 + '", 1]}', r"clip: frame 0: expected 44 values .{,200}$"),
        (spoiled(0, 0.0), "clip: frame 0: expected a duration above 0 s, found 0"),
        (spoiled(0, 20.0), r"clip: expected at most 30 s, found \d+.0 s"),
        (spoiled(5, 3.0), r"clip: frame \d+: root: expected a unit quaternion"),
    ],
)
def test_what_is_no_clip_is_told(text, said):
    with pytest.raises(BadClip, match=said):
        replay_of_clip(text, 0.0)


def test_recorded_contact_forces_are_what_changes_the_momentum():
    world = World(measure_torque=True)
    try:
        world.athlete.place([-2, 1.0, 0], [0, 0, 0, 1])
        world.athlete.push([0.5, 0, 0.2], [0, 0, 0])
        recorder = Recorder("right_ankle", {})
        recorder.start(world)
        for _ in range(60):
            recorder.add(world, world.advance())
    finally:
        world.close()
    replay = recorder.replay()
    mass = sum(replay.header["masses"])
    pushed = replay.arrays["contact_force"].sum(axis=1)[1:]
    needed = mass * np.diff(replay.arrays["com_velocity"], axis=0) / FRAME + [0, mass * 9.81, 0]
    standing = (np.abs(pushed[:, 1]) > 50) & (np.abs(pushed[:, 1]) < 2000)
    # but for the first touch, which a single coarse step resolves
    standing[np.flatnonzero(standing)[0]] = False
    assert standing.sum() > 10
    assert pushed[standing] == pytest.approx(needed[standing], rel=0.02, abs=5)
    touched = np.abs(replay.arrays["contact_force"]).sum(axis=2) > 1
    assert np.abs(replay.arrays["contact_point"][touched][:, 1]).max() < 0.05
