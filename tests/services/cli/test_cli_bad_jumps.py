"""The published studies of jumps with something wrong in them: one message, exit code 2, nothing left behind."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pybullet_data
import pytest
from safetensors.numpy import load, save

from workers.physics import clips
from workers.poses import training

STUDIES = Path(__file__).parents[3] / "studies"
MOTIONS = Path(pybullet_data.getDataPath()) / "data" / "motions"


@pytest.fixture(autouse=True)
def studies(shell):
    for file in STUDIES.glob("*.yaml"):
        shutil.copy(file, shell.folder)


def refused(shell, *arguments):
    typed = shell(*arguments)
    assert (typed.code, typed.out) == (2, ""), typed.err
    assert shell.study_names() == []
    return typed.err


@pytest.mark.parametrize(
    ("study", "where", "value", "expected"),
    [
        ("high_jump", "space.v_z.low", "-9", "from -8 to 8 m/s, found -9"),
        ("high_jump", "space.alpha.high", "180", "from -3.2 to 3.2 rad, found 180"),
        ("variations", "space.omega_x.high", "20.5", "from -15 to 15 rad/s, found 20.5"),
    ],
)
def test_take_off_states_out_of_range(shell, study, where, value, expected):
    message = refused(shell, "run", f"{study}.yaml", "--set", f"{where}={value}")
    assert f"{where}: expected {expected}; high_jump can do no more: give it a smaller range, usual is " in message


def test_take_off_states_out_of_range_in_the_file_are_told_with_their_line(shell):
    text = (STUDIES / "obstacle_jump.yaml").read_text()
    shell.write("a.yaml", text + "\nspace:\n  omega_y: {type: float, low: -40, high: 40}\n")
    line = text.count("\n") + 3
    why = "obstacle_jump can do no more: give it a smaller range, usual is -3 to 3"
    assert refused(shell, "run", "a.yaml") == (
        f"a.yaml:{line}: space.omega_y.low: expected from -15 to 15 rad/s, found -40; {why}\n"
        f"a.yaml:{line}: space.omega_y.high: expected from -15 to 15 rad/s, found 40; {why}\n"
    )


def test_take_off_states_that_are_no_numbers(shell):
    space = "{omega_x: {type: categorical, choices: [left, right]}}"
    message = refused(shell, "run", "obstacle_jump.yaml", "--set", f"space={space}")
    assert "space.omega_x.type: expected float, int or angle, found categorical\n" in message


@pytest.mark.parametrize("study", ["high_jump", "obstacle_jump", "variations"])
def test_a_stage_after_an_unknown_stage(shell, study):
    message = refused(shell, "run", f"{study}.yaml", "--set", "stages.polish.after=[serch]")
    assert "stages.polish.after: expected another stage, found serch; did you mean search?\n" in message


def test_a_pose_model_of_another_skeleton(shell):
    data = training.train(np.tile(clips.read(clips.packaged()[0]).pose, (8, 1)), epochs=1).to_bytes()
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])["__metadata__"]
    about = json.loads(header["halma.poses"])
    about["skeleton"] = [name for name in about["skeleton"] if "elbow" not in name]
    (shell.folder / "other").write_bytes(save(load(data), {"halma.poses": json.dumps(about)}))
    poses = ("--set", "task.settings.actions=pose", "--set", f"task.settings.poses={shell.folder}/other")
    message = refused(shell, "run", "variations.yaml", *poses)
    assert "task.settings.poses: " in message
    assert "expected a pose model of the athlete's skeleton, found one of another, missing right_elbow, left_elbow" in (
        message
    )


def frames(change):
    """A packaged clip with some of its numbers changed."""
    clip = json.loads((MOTIONS / "humanoid3d_run.txt").read_text())
    change(clip["Frames"])
    return json.dumps(clip)


SKELETON = """\
HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Tail
  {
    OFFSET 0 10 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 5 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.1
0 0 0 0 0 0 0 0 0
0 0 0 0 0 0 0 0 0
"""


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        (
            "short.txt",
            frames(lambda rows: rows[2].pop()),
            "short.txt: frame 2: expected 44 values (duration, root, 12 joints), found 43 values; is it a clip of ",
        ),
        (
            "long.txt",
            frames(lambda rows: rows[1].__setitem__(slice(8, 12), [2.0, 0.0, 0.0, 0.0])),
            "long.txt: frame 1: chest: expected a unit quaternion (w x y z), found one of length 2",
        ),
        ("tail.bvh", SKELETON, "tail.bvh: expected the joints of a person, found none for "),
    ],
)
def test_clips_that_are_none_of_the_athlete(shell, name, text, message):
    shell.write(name, text)
    typed = shell("poses", "train", name, "--out", "m.safetensors")
    assert typed.code == 2
    assert message in typed.err
    assert typed.err.count("\n") == 1
    assert not (shell.folder / "m.safetensors").exists()
