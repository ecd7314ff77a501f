"""The athlete and its world: what a learner must not be able to exploit."""

import numpy as np
import pybullet as bullet
import pytest

from workers.physics import clips
from workers.physics.athlete import COORDINATES, HIGH, JOINTS, LOW, TORQUE
from workers.physics.rotations import from_rotation_vector
from workers.physics.world import FRAME, GRAVITY, LOADED_STEPS, World

RUN = clips.load("run").pose[1]


def throw(world, rng, height=50.0):
    """In the air, turning, at rates of its own."""
    world.athlete.place([0, height, 0], from_rotation_vector(rng.normal(size=3)))
    world.athlete.bend(RUN, rng.normal(size=COORDINATES))
    world.athlete.push([1, 2, 0.5], [1, 3, -1])
    world.settle()


def test_the_athlete_weighs_45_kg_and_has_34_degrees_of_freedom(world):
    assert world.athlete.mass.sum() == pytest.approx(45, abs=0.01)
    assert COORDINATES + 6 == 34
    assert len(world.athlete.names) == 13


def test_a_pose_is_read_back_as_it_was_set(world):
    rng = np.random.default_rng(1)
    rates = rng.normal(size=COORDINATES)
    world.athlete.bend(RUN, rates)
    pose, found = world.athlete.pose()
    assert pose == pytest.approx(RUN, abs=1e-9)
    assert found == pytest.approx(rates, abs=1e-9)


def test_free_flight_keeps_momentum_however_the_joints_are_driven(world):
    rng = np.random.default_rng(2)
    throw(world, rng)
    athlete = world.athlete
    links = athlete.links()
    start, velocity = athlete.centre_of_mass(links), athlete.centre_of_mass(links[:, 7:10])
    for frame in range(72):
        if frame % 12 == 0:
            athlete.command(RUN + 0.5 * rng.normal(size=COORDINATES))
        world.advance()
    t = 72 * FRAME
    expected = start + velocity * t - [0, GRAVITY * t * t / 2, 0]
    assert athlete.centre_of_mass(athlete.links()) == pytest.approx(expected, abs=0.02)


def angular_momentum(world):
    """About the centre of mass, from the bodies' states (kg m^2/s)."""
    athlete = world.athlete
    links = athlete.links()
    centre, velocity = athlete.centre_of_mass(links), athlete.centre_of_mass(links[:, 7:10])
    total = np.zeros(3)
    for body, mass in enumerate(athlete.mass):
        inertia = np.diag(bullet.getDynamicsInfo(athlete.body, body - 1, **world._k)[2])
        turn = np.array(bullet.getMatrixFromQuaternion(links[body, 3:7])).reshape(3, 3)
        total += mass * np.cross(links[body, :3] - centre, links[body, 7:10] - velocity)
        total += turn @ inertia @ turn.T @ links[body, 10:13]
    return total


def test_free_flight_keeps_angular_momentum_within_a_twelfth(world):
    rng = np.random.default_rng(6)
    throw(world, rng)
    before = angular_momentum(world)
    for frame in range(60):
        if frame % 12 == 0:
            world.athlete.command(RUN + 0.4 * rng.normal(size=COORDINATES))
        world.advance()
    assert np.linalg.norm(angular_momentum(world) - before) < np.linalg.norm(before) / 12


def test_without_torque_a_command_moves_nothing():
    def bent(limit):
        world = World()
        athlete = world.athlete
        athlete._muscles = [[limit] * len(f) for f in athlete._muscles]
        athlete.place([0, 50, 0], [0, 0, 0, 1])
        athlete.bend(RUN, np.zeros(COORDINATES))
        athlete.push([0, 0, 0], [0, 0, 0])
        athlete.command(np.where(np.abs(RUN) > 0.2, 0.0, 0.4))
        for _ in range(12):
            world.advance()
        moved = np.abs(athlete.pose()[0] - RUN).max()
        world.close()
        return moved

    assert bent(0.0) < 1e-6
    assert 1e-3 < bent(0.5) < bent(50.0)


@pytest.mark.parametrize(("dt", "in_flight", "tolerance"), [(FRAME / LOADED_STEPS, False, 1e-5), (FRAME, True, 1e-3)])
def test_the_torques_told_are_those_that_bullet_applies(world, dt, in_flight, tolerance):
    """Setting them as plain torques moves the athlete as stable PD control does; some of them are at their limit."""
    athlete = world.athlete
    target = RUN + 0.3 * np.random.default_rng(3).normal(size=COORDINATES)

    def prepare():
        throw(world, np.random.default_rng(4))
        athlete.links()
        athlete.command(target)
        world._set_flight(in_flight=in_flight)

    prepare()
    athlete.actuate(watch_limits=False)
    torques = athlete.torques(dt)
    bullet.stepSimulation(**world._k)
    controlled = athlete.links()
    prepare()
    forces = [torques[3 * i : 3 * i + 3].tolist() for i in range(8)] + [[t] for t in torques[24:].tolist()]
    bullet.setJointMotorControlMultiDofArray(
        athlete.body, athlete._joints, bullet.TORQUE_CONTROL, forces=forces, **world._k
    )
    bullet.stepSimulation(**world._k)
    assert athlete.links() == pytest.approx(controlled, abs=tolerance)
    assert (np.abs(torques) <= TORQUE).all()
    assert (np.abs(torques) == TORQUE).any()


@pytest.mark.parametrize("direction", [-1, 1])
def test_joints_that_are_driven_beyond_their_range_stay_near_it(direction):
    for index, joint in enumerate(JOINTS):
        world = World()
        athlete = world.athlete
        athlete.place([0, 50, 0], [0, 0, 0, 1])
        at = sum(len(j.low) for j in JOINTS[:index]) + min(2, len(joint.low) - 1)
        pose, target = np.zeros(COORDINATES), np.zeros(COORDINATES)
        limit = HIGH[at] if direction > 0 else LOW[at]
        pose[at], target[at] = limit - 0.3 * direction, limit + 0.4 * direction
        athlete.bend(pose, np.zeros(COORDINATES))
        athlete.push([0, 0, 0], [0, 0, 0])
        athlete.command(target)
        for _ in range(60):
            world.advance()
        pose, _ = athlete.pose()
        world.close()
        beyond = max(pose[at] - HIGH[at], LOW[at] - pose[at])
        assert -0.3 < beyond < 0.15, joint.name


def test_the_legs_do_not_pass_through_each_other(world):
    athlete = world.athlete
    athlete.place([0, 50, 0], [0, 0, 0, 1])
    athlete.bend(np.zeros(COORDINATES), np.zeros(COORDINATES))
    athlete.push([0, 0, 0], [0, 0, 0])
    target = np.zeros(COORDINATES)
    target[6], target[15] = 0.6, -0.6  # both hips inwards
    athlete.command(target)
    deepest, touched = 0.0, False
    for _ in range(60):
        deepest = max(deepest, world.advance().overlap)
        touched = touched or bool(bullet.getContactPoints(athlete.body, athlete.body, **world._k))
    links = athlete.links()
    right, left = (links[athlete.names.index(name), 2] for name in ("right_knee", "left_knee"))
    assert touched
    assert right > left
    assert deepest < 0.03


def test_a_rebuilt_world_repeats_a_new_one_bit_for_bit():
    def play(world):
        athlete = world.athlete
        athlete.place([0, 1.0, 0], [0, 0, 0, 1])
        athlete.bend(RUN, np.zeros(COORDINATES))
        athlete.push([1, 0, 0], [0, 1, 0])
        world.set_bar(0.5)
        world.settle()
        athlete.command(RUN)
        for _ in range(60):
            world.advance()
        return athlete.links().tobytes()

    world = World()
    first = play(world)
    play(world)
    world.rebuild()
    assert play(world) == first
    world.close()


def test_loading_a_world_prints_nothing(capfd):
    World().close()
    assert not capfd.readouterr().out


def test_standing_presses_the_ground_with_about_body_weight(world):
    athlete = world.athlete
    athlete.place([-5, 2, 0], [0, 0, 0, 1])
    athlete.bend(np.zeros(COORDINATES), np.zeros(COORDINATES))
    athlete.push([0, 0, 0], [0, 0, 0])
    athlete.links()
    low = athlete.bounds()[0][1]
    athlete.place([-5, 2 - low, 0], [0, 0, 0, 1])
    athlete.command(np.zeros(COORDINATES))
    world.settle()
    world.stand()
    forces = [world.advance().ground_force for _ in range(60)]
    assert np.mean(forces[30:]) == pytest.approx(45 * GRAVITY, rel=0.1)
