"""The rules, each in a scripted situation, and the reward against hand-worked values."""

import numpy as np
import pytest

from workers.audit import audit
from workers.physics.athlete import COORDINATES
from workers.physics.limits import HUMAN, Limits
from workers.physics.rotations import from_rotation_vector
from workers.physics.world import Contacts
from workers.replay import Recorder
from workers.tasks.high_jump import rules, takeoff
from workers.tasks.high_jump.env import HighJumpEnv
from workers.tasks.high_jump.rules import Rules
from workers.tasks.high_jump.settings import HighJumpSettings

LYING = from_rotation_vector(np.array([0, 0, np.pi / 2]))  # on the back, head towards -x


@pytest.fixture
def referee(world):
    link = world.athlete.link
    return Rules(foot=link["right_ankle"], head=link["neck"])


def put(world, position, orientation=(0, 0, 0, 1), velocity=(0, 0, 0)):
    world.athlete.place(position, orientation)
    world.athlete.bend(np.zeros(COORDINATES), np.zeros(COORDINATES))
    world.athlete.push(velocity, (0, 0, 0))
    world.athlete.command(np.zeros(COORDINATES))
    world.settle()


def judge(world, referee, frames):
    for frame in range(1, frames + 1):
        contacts = world.advance()
        rear = float(world.athlete.bounds()[0][0])
        verdict = referee.verdict(contacts, frame / 120, rear)
        if verdict:
            return verdict
    return None


def test_running_into_the_wall_fails(world, referee):
    world.set_bar(1.5)
    put(world, [-0.4, 1.0, 0], velocity=(3, 0, 0))
    assert judge(world, referee, 30) == "wall"


def test_passing_above_the_wall_touches_nothing(world, referee):
    world.set_bar(0.5)
    put(world, [-0.5, 1.8, 0], velocity=(4, 0, 0))
    assert judge(world, referee, 20) is None


def test_a_body_that_falls_on_the_ground_fails(world, referee):
    put(world, [-3, 0.5, 0], LYING)
    assert judge(world, referee, 60) == "ground"


def test_the_take_off_foot_may_touch_the_ground(world, referee):
    takeoff.start_state(world, HighJumpSettings().take_off({}))
    world.stand()
    contacts = world.advance()
    assert contacts.ground == {referee.foot}
    assert referee.verdict(contacts, 0.01, None) is None


def test_the_other_foot_may_not(referee, world):
    other = world.athlete.link["left_ankle"]
    assert referee.verdict(Contacts(ground={other, referee.foot}), 0.01, None) == "ground"


def test_lying_on_the_mat_has_landed(world, referee):
    world.set_bar(0.3)
    put(world, [2.0, 0.6, 0], LYING)
    assert judge(world, referee, 60) == "landed"


def test_a_leg_that_still_hangs_over_the_bar_has_not_landed(world, referee):
    world.set_bar(0.3)
    put(world, [0.4, 0.5, 0], from_rotation_vector(np.array([0, 0, -np.pi / 2])))  # feet towards -x, across the wall
    contacts = Contacts(mat={-1})
    world.athlete.links()
    rear = float(world.athlete.bounds()[0][0])
    assert rear < 0
    assert referee.verdict(contacts, 0.5, rear) is None


def test_two_seconds_are_the_limit(referee):
    assert referee.verdict(Contacts(), 1.99, None) is None
    assert referee.verdict(Contacts(), 2.0, None) == "time"


def test_touching_the_wall_counts_even_on_the_mat(referee):
    assert referee.verdict(Contacts(wall={3}, mat={-1}), 0.5, 1.0) == "wall"


def test_the_reward_against_a_hand_worked_value():
    # bar 1.1 m: c_offset = 48 - 33 / 2 = 31.5; naturalness 1 - (6.3 / 31.5)^2 = 0.96; exp(-0.02 * 5) = 0.904837
    found = rules.reward(landed=True, head_first=True, spin=5.0, offset=6.3, bar=1.1)
    assert found == pytest.approx(0.904837 * 0.7 * 0.96, rel=1e-5)


def test_the_reward_is_sparse():
    assert rules.reward(landed=False, head_first=False, spin=0.0, offset=0.0, bar=0.5) == 0.0
    assert rules.reward(landed=True, head_first=False, spin=0.0, offset=0.0, bar=0.5) == 1.0


def test_the_offset_bound_falls_from_48_to_15():
    assert [rules.offset_bound(bar) for bar in (0.3, 0.6, 1.6, 2.2)] == pytest.approx([48, 48, 15, 15])
    assert rules.naturalness(100.0, 0.5) == 0.0


def pushing(limit):
    """Reward and verdict of the jump of action 0 from the middle of the support, its push limited so."""
    env = HighJumpEnv(
        HighJumpSettings().take_off({"alpha": 0.7, "v_z": -2.0}), limits=None if limit is None else Limits(push=limit)
    )
    env.reset(options={"level": 0.1})
    done = False
    while not done:
        _, reward, done, _, info = env.step(np.zeros(28))
    env.close()
    return reward, info


def test_in_training_a_jump_that_pushes_too_hard_fails_and_earns_little():
    free, info = pushing(None)
    assert (info["verdict"], info["success"], info["metrics"]["hard_push"]) == ("landed", True, 0.0)
    limited, info = pushing(0.5)
    assert (info["verdict"], info["success"], info["metrics"]["hard_push"]) == ("landed", False, 1.0)
    assert limited == pytest.approx(0.2 * free)
    assert pushing(100.0)[0] == free


def jumping(limits, recorder=None):
    """Reward and information of a wild jump over a low bar."""
    env = HighJumpEnv(HighJumpSettings().take_off({"alpha": 0.7, "v_z": -2.0}), limits=limits, recorder=recorder)
    env.reset(options={"level": 0.1})
    action, done = np.zeros(28), False
    action[takeoff.coordinate("left_hip", 2)] = 1.5
    action[takeoff.coordinate("left_elbow")] = 2.0
    while not done:
        _, reward, done, _, info = env.step(action)
    strain = env._strain()
    env.close()
    return reward, info, strain


@pytest.mark.parametrize(("limit", "metric"), [("rate", "fast_joint"), ("angle", "bent_joint")])
def test_in_training_a_jump_that_asks_too_much_of_a_joint_fails_and_earns_little(limit, metric):
    free, info, _ = jumping(None)
    assert (info["success"], info["metrics"][metric]) == (True, 0.0)
    least = jumping(Limits(**{limit: 1.0}))[2].worst
    assert least > 0
    within, info, strain = jumping(Limits(**{limit: 1.01 * least}))
    assert (within, info["success"], info["metrics"][metric]) == (free, True, 0.0)
    assert strain.worst == pytest.approx(1 / 1.01)
    beyond, info, _ = jumping(Limits(**{limit: 0.99 * least}))
    assert (info["success"], info["metrics"][metric]) == (False, 1.0)
    assert beyond == pytest.approx(0.2 * free)


def test_what_a_training_sees_of_a_body_is_what_the_audit_finds():
    recorder = Recorder(takeoff.TAKE_OFF_FOOT)
    strain = jumping(HUMAN, recorder)[2]
    found = {check.name: check for check in audit(recorder.replay()).checks}
    # replays are of 32 bits
    assert strain.push * HUMAN.push == pytest.approx(found["foot_push"].found, rel=1e-5)
    assert strain.rate * HUMAN.rate == pytest.approx(found["joint_rate"].found, rel=1e-4)
    assert strain.angle * HUMAN.angle == pytest.approx(found["joint_angle"].found, rel=1e-4)
    assert found["joint_angle"].found > 0.01


def test_a_body_of_nan_is_strained():
    pose = np.zeros((6, 28))
    pose[3, 5] = np.nan
    assert not HUMAN.strain(1.0, pose, 1 / 120).worst <= 1
