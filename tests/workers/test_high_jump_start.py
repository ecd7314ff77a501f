"""Where a jump begins: the published conventions, and a stance foot at rest."""

import numpy as np
import pytest

from workers.contracts import BadSetting
from workers.physics.world import World
from workers.tasks.high_jump import takeoff
from workers.tasks.high_jump.env import HighJumpEnv
from workers.tasks.high_jump.settings import HighJumpSettings


def state(formulation="support", **params):
    values = {"alpha": np.pi / 2, "omega_x": 0.0, "omega_z": 0.0, "v_z": 0.0} | params
    return HighJumpSettings(formulation=formulation).take_off(values)


def test_at_alpha_half_pi_the_bar_lies_straight_ahead(world):
    start = takeoff.start_state(world, state())
    assert start.velocity == pytest.approx([3.5, 1.2, 0.0], abs=1e-9)


def test_at_alpha_zero_the_bar_is_parallel_to_the_run_up_on_the_left(world):
    start = takeoff.start_state(world, state(alpha=0.0, v_z=-2.0))
    # forward is along the bar, sideways to the left is towards it
    assert start.velocity == pytest.approx([2.0, 1.2, 3.5], abs=1e-9)
    assert state(alpha=0.0, v_z=-2.0).approach == pytest.approx(2.0)


def test_the_spin_is_given_in_the_heading_frame(world):
    start = takeoff.start_state(world, state(alpha=0.0, omega_x=-3.0, omega_z=1.0, v_z=-2.4))
    # heading along z: forward = z, up = y, right = -x
    assert start.angular_velocity == pytest.approx([-1.0, 3.0, -3.0], abs=1e-9)


@pytest.mark.parametrize("params", [{}, {"alpha": 0.4, "omega_x": -3.0, "omega_z": 2.0, "v_z": -2.5}])
def test_in_support_the_foot_stands_still_on_the_ground_while_the_body_moves(world, params):
    takeoff.start_state(world, state(**params))
    links = world.athlete.links()
    foot = links[world.athlete.names.index("right_ankle")]
    assert np.linalg.norm(foot[7:10]) < 0.05
    assert np.linalg.norm(links[0, 7:10]) > 2
    assert world.athlete.bounds()[0][1] == pytest.approx(0, abs=1e-3)


def test_in_flight_the_centre_of_mass_has_the_velocity_whatever_the_spin(world):
    takeoff.start_state(world, state("flight", omega_x=3.0, omega_z=-2.0))
    athlete = world.athlete
    links = athlete.links()
    assert athlete.centre_of_mass(links[:, 7:10]) == pytest.approx([3.5, 3.5, 0.0], abs=1e-6)
    assert athlete.bounds()[0][1] == pytest.approx(0.03, abs=1e-3)


def test_the_bar_stands_where_the_athlete_gets_but_neither_too_near_nor_too_far():
    assert state(v_z=0.0).distance == pytest.approx(3.5 * 0.35)
    assert state(alpha=0.1).distance == 0.6
    assert HighJumpSettings(forward_speed=9.0).take_off({}).distance == 1.5


def test_missing_parameters_are_at_the_middle_of_their_range():
    middle = HighJumpSettings().take_off({})
    for name, spec in takeoff.PARAMETERS.items():
        assert getattr(middle, name) == pytest.approx((spec.low + spec.high) / 2)


def test_equal_actions_give_equal_episodes_bit_for_bit():
    actions = 0.3 * np.random.default_rng(5).normal(size=(30, 28))

    def episode(env, *, fresh):
        observation, _ = env.reset(seed=1, options={"level": 0.3, "fresh": fresh})
        seen = [observation.tobytes()]
        for action in actions:
            observation, reward, done, _, _ = env.step(action)
            seen.append(observation.tobytes() + np.float64(reward).tobytes())
            if done:
                break
        return seen

    env, other = HighJumpEnv(state(v_z=-1.0)), HighJumpEnv(state(v_z=-1.0))
    first = episode(env, fresh=True)
    episode(env, fresh=False)
    assert len(first) > 2
    assert episode(env, fresh=True) == first
    assert episode(other, fresh=True) == first
    env.close()
    other.close()


def test_the_observation_is_what_it_says(world):
    env = HighJumpEnv(state())
    observation, _ = env.reset(options={"level": 0.77})
    assert observation.shape == env.observation_space.shape == (173,)
    assert observation[3] == 0.77
    assert observation[0] == pytest.approx(-1.225)
    assert observation[4:7] == pytest.approx([0, 0, 0])  # the root relative to itself
    env.close()


def test_every_corner_of_the_default_space_starts_on_its_foot():
    world = World()
    for alpha in (0.4, 2.0):
        for v_z in (-2.5, -0.5):
            corner = state(alpha=alpha, v_z=v_z, omega_x=-3.0, omega_z=2.0)
            assert corner.approach > 1.0
            takeoff.start_state(world, corner)
            world.settle()
            world.stand()
            assert world.advance().ground == {world.athlete.link["right_ankle"]}
    world.close()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("alpha", 4.0, "expected from -3.2 to 3.2 rad, found 4"),
        ("omega_x", -20.0, "expected from -15 to 15 rad/s, found -20"),
        ("v_z", float("nan"), "expected from -8 to 8 m/s, found nan"),
    ],
)
def test_a_take_off_state_that_nobody_takes_off_with_is_refused(name, value, message):
    with pytest.raises(BadSetting) as refusal:
        HighJumpSettings().take_off({name: value})
    assert str(refusal.value) == f"space.{name}: {message}"
