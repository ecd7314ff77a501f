"""Variations of the high jump: other gravity, other athletes, and who must land on the feet."""

import numpy as np
import pytest

from workers.audit import audit
from workers.contracts import BadJob, BadSetting
from workers.physics.athlete import JOINTS, torque_bound
from workers.physics.world import Contacts, World
from workers.replay import Recorder, Replay
from workers.tasks.high_jump import HighJump, takeoff
from workers.tasks.high_jump.env import HighJumpEnv
from workers.tasks.high_jump.rules import Rules
from workers.tasks.high_jump.settings import HighJumpSettings
from workers.tasks.high_jump.takeoff import coordinate
from workers.tasks.high_jump.variations import varied_joints

FLOP = {"alpha": 0.4, "omega_x": -3.0, "omega_z": 1.0, "v_z": -2.4}


def push_off(**settings):
    """The jump of action 0 in flight, its verdict and its recording."""
    recorder = Recorder("right_ankle")
    env = HighJumpEnv(HighJumpSettings(formulation="flight").take_off(FLOP), recorder=recorder, **settings)
    env.reset(options={"level": 0.5})
    done = False
    while not done:
        _, _, done, _, info = env.step(np.zeros(28))
    env.close()
    return info["verdict"], recorder.replay()


@pytest.fixture(scope="module")
def on_mars():
    """Half a second of free fall from 5 m."""
    world, recorder = World(gravity=3.711), Recorder("right_ankle")
    world.athlete.place([0, 5, 0], [0, 0, 0, 1])
    recorder.start(world)
    for _ in range(60):
        recorder.add(world, world.advance())
    world.close()
    return recorder.replay()


def test_on_mars_the_centre_of_mass_falls_with_its_gravity(on_mars):
    speed = on_mars.arrays["com_velocity"][:, 1].astype(float)
    seconds = np.arange(60) * on_mars.header["frame_seconds"]
    assert np.polyfit(seconds, speed, 1)[0] == pytest.approx(-3.711, abs=0.05)


def test_on_mars_a_jump_is_judged_by_its_gravity(on_mars):
    earthly = Replay({k: v for k, v in on_mars.header.items() if k != "gravity"}, on_mars.arrays)
    assert "ballistic_flight" not in audit(on_mars).failures
    assert "ballistic_flight" in audit(earthly).failures


def test_replays_on_earth_say_nothing_of_gravity(jump):
    assert "gravity" not in jump.header


def test_who_must_land_on_the_feet_falls_on_anything_else():
    rules = Rules(foot=9, head=2, may_land_on=frozenset({9, 12}))
    assert rules.verdict(Contacts(mat={9, 12}), 1.0, 0.5) == "landed"
    assert rules.verdict(Contacts(mat={9, 1}), 1.0, 0.5) == "fall"
    assert rules.verdict(Contacts(mat={1}), 1.0, -0.5) == "fall"
    assert rules.verdict(Contacts(mat={9}), 1.0, -0.5) is None
    assert Rules(foot=9, head=2).verdict(Contacts(mat={1}), 1.0, 0.5) == "landed"


def test_a_jump_that_lands_on_the_back_is_a_fall_where_the_feet_are_asked_for(jump):
    assert push_off(landing="feet")[0] == "fall"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"gravity": 0}, "expected a number from 0.5 to 30"),
        ({"landing": "head"}, "expected any or feet"),
        ({"cast": "arm"}, "expected none or take_off or swing"),
        ({"take_off_leg": 0}, "expected a number from 0.1 to 2"),
    ],
)
def test_wrong_variations_are_refused(settings, message):
    with pytest.raises(BadSetting, match=message):
        HighJump().validate(settings, {}, ())


def held_still(joints, target, frames=90):
    """Where the athlete's joints get in free fall while they are told to go to `target` ``[28]``."""
    world, recorder = World(joints=joints, measure_torque=True), Recorder("right_ankle")
    world.athlete.place([0, 8, 0], [0, 0, 0, 1])
    world.athlete.command(target)
    recorder.start(world)
    for _ in range(frames):
        recorder.add(world, world.advance())
    world.close()
    return recorder.replay()


def bent(joint, angle, axis=0):
    pose = np.zeros(28)
    pose[coordinate(joint, axis)] = angle
    return pose


def test_a_spine_that_is_stiff_bends_forward_and_not_back():
    stiff = varied_joints(1.0, "stiff", "none")
    at = coordinate("chest", 2)
    reached = {
        (name, angle): held_still(joints, bent("chest", angle, 2)).arrays["pose"][-30:, at].mean()
        for name, joints in (("free", JOINTS), ("stiff", stiff))
        for angle in (0.6, -0.6)
    }
    assert reached["free", 0.6] > 0.4
    assert abs(reached["stiff", 0.6]) < 0.25
    assert reached["free", -0.6] < -0.4
    assert reached["stiff", -0.6] == pytest.approx(reached["free", -0.6], abs=1e-6)


def test_a_knee_in_a_cast_stays_straight_whatever_it_is_told():
    at = coordinate("left_knee")
    pose = held_still(varied_joints(1.0, "free", "swing"), bent("left_knee", -2.0)).arrays["pose"][:, at]
    assert pose.min() > -0.3
    assert held_still(JOINTS, bent("left_knee", -2.0)).arrays["pose"][-1, at] < -1.0


def test_a_weak_leg_pushes_with_so_much_less_and_the_audit_knows():
    weak = varied_joints(0.6, "free", "none")
    replay = held_still(weak, bent("right_knee", -2.5), frames=12)
    at = coordinate("right_knee")
    assert np.abs(replay.arrays["torque"][:, at]).max() == pytest.approx(0.6 * 200.0, rel=1e-3)
    other = coordinate("left_knee")
    assert torque_bound(np.zeros(28), weak)[[at, other]].tolist() == [120.0, 200.0]
    assert replay.joints() == weak
    # With the torque of a sound leg the same athlete would be refused.
    stronger = {**replay.arrays, "torque": replay.arrays["torque"] / np.float32(0.6)}
    assert "torque" not in audit(replay).failures
    assert "torque" in audit(Replay(replay.header, stronger)).failures


def test_a_replay_of_the_usual_athlete_says_nothing_of_joints(jump):
    assert "changed_joints" not in jump.header
    assert jump.joints() == JOINTS
    with pytest.raises(BadJob, match="expected the changed joints of an athlete"):
        Replay({**jump.header, "changed_joints": [{"name": "chest"}]}, jump.arrays).joints()


@pytest.mark.parametrize("cast", ["take_off", "swing"])
def test_an_athlete_in_a_cast_starts_with_a_straight_knee_and_its_foot_at_rest(cast):
    settings = HighJumpSettings.parse({"cast": cast})
    world = World(joints=settings.joints())
    start = takeoff.start_state(world, settings.take_off(FLOP))
    at = coordinate("right_knee" if cast == "take_off" else "left_knee")
    assert -0.1 <= start.pose[at] <= 0
    assert start.rates[at] == 0
    athlete = world.athlete
    foot = athlete.links()[athlete.names.index("right_ankle"), 7:10]
    assert np.linalg.norm(foot) < (0.2 if cast == "swing" else 1.5)
    world.close()


@pytest.mark.parametrize("actions", ["offset", "pose"])
@pytest.mark.parametrize("cast", ["none", "take_off", "swing"])
def test_an_athlete_with_or_without_a_cast_leaves_the_ground_from_its_take_off_foot(cast, actions):
    settings = HighJumpSettings.parse({"cast": cast, "actions": actions})
    env = HighJumpEnv(settings.take_off(FLOP), joints=settings.joints(), poses=settings.pose_model())
    env.reset(options={"level": 0.2})
    ended = False
    while not ended:
        _, _, ended, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
    assert info["verdict"] in {"wall", "landed"}, "no other part has touched the ground"
    env.world.close()
