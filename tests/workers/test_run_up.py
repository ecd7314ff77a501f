"""The run-up, with few candidates: what matters is that it is one motion, and the same one each time."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from workers.audit import audit
from workers.contracts import BadSetting
from workers.physics import clips, rotations
from workers.physics.athlete import JOINTS
from workers.physics.limits import HUMAN
from workers.physics.world import FRAME, World
from workers.replay import Recorder
from workers.tasks.high_jump import takeoff
from workers.tasks.high_jump.approach import captured_run, reference_of
from workers.tasks.high_jump.env import HighJumpEnv
from workers.tasks.high_jump.run_up import WINDOW, arrival, run_up_to
from workers.tasks.high_jump.settings import HighJumpSettings, ObstacleJumpSettings

SIDE = {"alpha": 0.70, "omega_x": -1.44, "omega_z": 0.44, "v_z": -1.99}
STATE = HighJumpSettings().take_off(SIDE)
SMALL = {"seconds": 0.3, "candidates": 200, "kept": 20, "rounds": 1}


@pytest.fixture(scope="module")
def run_up():
    return run_up_to(STATE, JOINTS, **SMALL)


@pytest.fixture(scope="module")
def start():
    world = World()
    found = takeoff.start_state(world, STATE)
    world.close()
    return found


def test_the_reference_ends_in_the_take_off_state_at_its_velocities(start):
    found = reference_of(start, captured_run(None), 0.6).at(0.6)
    assert found.root == pytest.approx(start.position, abs=1e-6)
    assert rotations.angle_between(found.orientation, start.orientation) < 1e-6
    assert found.pose == pytest.approx(start.pose, abs=1e-6)
    assert found.velocity == pytest.approx(start.velocity, abs=0.05)
    assert found.spin == pytest.approx(start.angular_velocity, abs=0.1)


def test_the_reference_comes_from_where_the_approach_comes_from_at_its_speed(start):
    reference = reference_of(start, captured_run(None), 0.6)
    way = (reference.at(0.3).root - reference.at(0.0).root) / 0.3
    assert way[[0, 2]] == pytest.approx(start.velocity[[0, 2]], abs=0.05)
    # it faces where it runs
    ahead = rotations.rotate(reference.at(0.1).orientation, np.array([1.0, 0.0, 0.0]))
    assert ahead @ way / np.linalg.norm(way) > 0.9


def test_a_run_up_follows_its_reference_and_one_that_only_repeats_the_clip_does_not(run_up):
    found = arrival(run_up, STATE, JOINTS)
    without = arrival(run_up_to(STATE, JOINTS, seconds=0.3, candidates=1, kept=1, rounds=0), STATE, JOINTS)
    assert found.velocity < 0.75 * without.velocity
    assert found.place < 0.3


def test_the_last_targets_are_improved_for_the_take_off(run_up):
    found, before = (arrival(run_up_to(STATE, JOINTS, **{**SMALL, "rounds": n}), STATE, JOINTS) for n in (1, 0))
    assert found.carried < 0.9 * before.carried
    assert found.spin < 0.75 * before.spin


def test_the_same_take_off_state_has_the_same_run_up(run_up):
    run_up_to.cache_clear()
    again = run_up_to(STATE, JOINTS, **SMALL)
    assert again.targets.tobytes() == run_up.targets.tobytes()
    assert again.start.position.tobytes() == run_up.start.position.tobytes()


def recorded(run_up, **options):
    recorder = Recorder(takeoff.TAKE_OFF_FOOT)
    env = HighJumpEnv(STATE, run_up=run_up, recorder=recorder, **options)
    env.reset(options={"level": 0.2})
    frames = len(recorder.replay().arrays["com"])
    done = False
    while not done:
        *_, done, _, _ = env.step(np.zeros(28))
    env.close()
    return recorder.replay(), frames


def test_run_up_and_jump_are_one_motion(run_up):
    replay, frames = recorded(run_up)
    assert frames == 1 + len(run_up.targets) * WINDOW
    assert replay.frames > frames
    com, velocity = (replay.arrays[name].astype(float) for name in ("com", "com_velocity"))
    # what the centre of mass moves by is what its velocity says, also where the run-up becomes the jump
    moved = np.diff(com, axis=0) / FRAME
    assert np.abs(moved - (velocity[1:] + velocity[:-1]) / 2).max() < 0.5
    # and it comes from far away, running
    assert com[0, 0] < com[frames - 1, 0] - 0.7


def test_feet_that_roll_over_the_ground_do_not_sink_into_it(run_up):
    replay, frames = recorded(run_up)
    sunk = replay.arrays["penetration"][:frames]
    struck = int(np.flatnonzero(sunk)[0])
    assert frames - struck > 8
    assert sunk[struck + 4 :].max() < 0.008


def test_the_audit_judges_the_run_up_too(run_up):
    replay, frames = recorded(run_up)
    checks = {check.name: check for check in audit(replay).checks}
    assert checks["ballistic_flight"].passed
    replay.arrays["ground_force"].setflags(write=True)
    replay.arrays["ground_force"][frames // 2] = 7 * 45 * 9.81
    assert "foot_push" in audit(replay).failures


def test_a_jump_after_a_run_up_begins_alike_in_a_used_world_and_in_a_new_one(run_up):
    env = HighJumpEnv(STATE, run_up=run_up)
    first, _ = env.reset(options={"level": 0.3, "fresh": True})
    env.step(np.zeros(28))
    again, _ = env.reset(options={"level": 0.3, "fresh": True})
    env.close()
    assert first.tobytes() == again.tobytes()


def test_a_rehearsed_jump_begins_where_the_run_up_ends(run_up):
    both = [HighJumpEnv(STATE, run_up=run_up, rehearse=rehearse, limits=HUMAN) for rehearse in (False, True)]
    first, rehearsed = (env.reset(options={"level": 0.3, "fresh": True})[0] for env in both)
    assert rehearsed == pytest.approx(first, abs=1e-6)
    # and what the run-up asked of the body counts in both
    strains = [env._strain() for env in both]
    assert strains[0].rate > 0.1
    assert strains[1].worst == pytest.approx(strains[0].worst, rel=1e-6)
    again, _ = both[1].reset(options={"level": 0.3, "fresh": True})
    assert again.tobytes() == rehearsed.tobytes()
    for env in both:
        env.close()


def test_an_obstacle_is_run_up_to_from_where_it_is_wide(run_up):
    settings = ObstacleJumpSettings()
    env = HighJumpEnv(STATE, run_up=run_up, obstacle=settings.obstacle)
    near, far = (env.reset(options={"level": level})[0][0] for level in (0.1, 0.5))
    env.close()
    assert far - near == pytest.approx(-0.2, abs=0.02)


def test_a_run_up_is_none_of_a_jump_that_begins_in_the_air():
    with pytest.raises(BadSetting, match="expected none with formulation: flight"):
        HighJumpSettings.parse({"formulation": "flight", "run_up": True})


RAW = np.array(json.loads((clips.packaged()[0].parent / "humanoid3d_run.txt").read_text())["Frames"])


def written(folder, *, cycles=2.0, jumps=True, radius=None):
    """A file of the packaged run that goes round and round, as on a circle to its left, and ends in a jump."""
    period, cycle = RAW[0, 0], len(RAW) - 1
    count = round(cycles * cycle) + 5
    frames = np.stack([RAW[i % cycle] for i in range(count)])
    advance = RAW[-1, 1] - RAW[0, 1]
    frames[:, 1] = [RAW[i % cycle, 1] + i // cycle * advance for i in range(count)]
    flight = np.repeat(frames[-1:], round(0.5 / period), 0)
    time = period * (1 + np.arange(len(flight)))
    flight[:, 1] += advance / (cycle * period) * time
    flight[:, 2] += 3.0 * time - 9.81 / 2 * time**2
    frames = np.concatenate([frames, flight if jumps else np.repeat(frames[-1:], 60, 0)])
    if radius is not None:
        way = frames[:, 1] / radius
        for frame, angle in zip(frames, way, strict=True):
            frame[[1, 3]] = radius * np.sin(angle), -radius * (1 - np.cos(angle))
            w, x, y, z = frame[4:8]
            turned = rotations.multiply(rotations.from_rotation_vector(np.array([0, angle, 0])), np.array([x, y, z, w]))
            frame[4:8] = turned[[3, 0, 1, 2]]
    path = folder / "run.txt"
    path.write_text(json.dumps({"Loop": "none", "Frames": frames.tolist()}))
    return str(path)


def test_a_run_from_a_file_ends_in_the_last_support_before_its_jump(tmp_path):
    path = written(tmp_path)
    run = captured_run(path)
    assert not run.cyclic
    assert run.sha256 == hashlib.sha256(Path(path).read_bytes()).hexdigest()
    assert abs(run.frame - 2 * (len(RAW) - 1) - takeoff.MID_SUPPORT_FRAME) <= 3


def test_a_run_up_goes_along_the_curve_of_its_clip_and_ends_in_the_take_off_state(tmp_path, start):
    reference = reference_of(start, captured_run(written(tmp_path, radius=5.0)), 0.6)
    ways = [reference.at(t).velocity for t in (0.05, 0.3, 0.6)]
    first, middle, last = (np.arctan2(-v[2], v[0]) for v in ways)
    assert [np.hypot(v[0], v[2]) for v in ways] == pytest.approx([np.hypot(*start.velocity[[0, 2]])] * 3, rel=0.05)
    # 0.3 s at some 4 m/s are a quarter of a radian of a circle with a radius of 5 m
    assert middle - first == pytest.approx(0.25, abs=0.07)
    assert last == pytest.approx(np.arctan2(-start.velocity[2], start.velocity[0]), abs=0.02)
    ahead = rotations.rotate(reference.at(0.05).orientation, np.array([1.0, 0.0, 0.0]))
    assert np.arctan2(-ahead[2], ahead[0]) == pytest.approx(first, abs=0.3)
    found = reference.at(0.6)
    assert found.root == pytest.approx(start.position, abs=1e-6)
    assert found.pose == pytest.approx(start.pose, abs=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"jumps": False}, "expected a run that ends in a jump of 0.25 s or more, found at most 0.1"),
        ({"cycles": 2.5}, "expected a take-off from the right foot, found one from the left"),
        ({"cycles": 0.0}, "expected a run of 0.8 s or more before a jump, found its take-off at 0"),
    ],
)
def test_a_clip_that_is_no_run_up_is_refused_with_where_and_why(tmp_path, options, message):
    settings = {"run_up": True, "run_up_clip": written(tmp_path, **options)}
    with pytest.raises(BadSetting, match=r"run_up_clip.*" + message):
        HighJumpSettings.parse(settings)


def test_a_clip_is_none_of_a_jump_without_a_run_up(tmp_path):
    with pytest.raises(BadSetting, match=r"run_up_clip.*expected none with run_up: false"):
        HighJumpSettings.parse({"run_up_clip": written(tmp_path)})
