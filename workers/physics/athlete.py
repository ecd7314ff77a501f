"""The athlete: DeepMimic's humanoid with 28 internal and 34 degrees of freedom in all, moved by stable PD control.

A **pose** is a vector of 28 joint coordinates: the rotation vectors (rad, in the child's frame) of the eight spherical
joints in the order of `SPHERICAL`, then the angles (rad) of the four hinges in the order of `REVOLUTE`. **Rates** are
the joint velocities (rad/s) in the same order. The body's forward axis is x, up y, right z; legs and arms hang along
-y, so that a positive rotation about z lifts them forward.

Stable PD control (Tan, Liu and Turk 2011) is Bullet's own, at gains and torque limits of the human body. A joint beyond
its range is driven back by a penalty torque, as in the published jumping system: its target is moved inside the range,
as far from the limit as the joint itself is beyond it, so that the limit is twice as stiff as the joint. There
ligaments help the muscles (`LIGAMENTS`): a leg that swings back after the push is more than the hip's muscles can stop.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pybullet as bullet
import pybullet_data
from numpy.typing import NDArray

from workers.physics import rotations
from workers.physics.rotations import Array


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint of the athlete.

    Args:
        name: of the joint and of the body that hangs on it.
        stiffness: of its PD controller, N m / rad.
        torque: most that its muscles give about any axis, N m.
        low, high: its range in joint coordinates, rad; three values for a spherical joint, one for a hinge.
        rate: fastest that a human turns it, rad/s, about any axis.
        held: in a cast, which keeps what the joint is told to do within its range.
    """

    name: str
    stiffness: float
    torque: float
    low: tuple[float, ...]
    high: tuple[float, ...]
    rate: float
    held: bool = False


# Stiffness and torque limits are DeepMimic's (Peng et al. 2018), but for knees and ankles, whose 150 and 90 N m are
# raised to 200 and 150: taking off from one leg is no everyday motion. With twice that the foot pushes with 9 body
# weights. Ranges are those of a flexible person, in rotation vectors; rates what the fastest kicks and throws reach.
JOINTS: tuple[Joint, ...] = (
    Joint("chest", 1000.0, 200.0, (-0.7, -0.9, -1.2), (0.7, 0.9, 0.8), 20.0),
    Joint("neck", 100.0, 50.0, (-0.8, -1.3, -1.1), (0.8, 1.3, 1.1), 25.0),
    Joint("right_hip", 500.0, 200.0, (-1.2, -1.0, -0.9), (0.6, 1.0, 2.4), 25.0),
    Joint("right_ankle", 400.0, 150.0, (-0.6, -0.7, -1.0), (0.6, 0.7, 0.7), 30.0),
    Joint("right_shoulder", 400.0, 100.0, (-2.8, -1.7, -1.3), (1.2, 1.7, 2.7), 40.0),
    Joint("left_hip", 500.0, 200.0, (-0.6, -1.0, -0.9), (1.2, 1.0, 2.4), 25.0),
    Joint("left_ankle", 400.0, 150.0, (-0.6, -0.7, -1.0), (0.6, 0.7, 0.7), 30.0),
    Joint("left_shoulder", 400.0, 100.0, (-1.2, -1.7, -1.3), (2.8, 1.7, 2.7), 40.0),
    Joint("right_knee", 500.0, 200.0, (-2.6,), (0.0,), 35.0),
    Joint("right_elbow", 300.0, 60.0, (0.0,), (2.7,), 45.0),
    Joint("left_knee", 500.0, 200.0, (-2.6,), (0.0,), 35.0),
    Joint("left_elbow", 300.0, 60.0, (0.0,), (2.7,), 45.0),
)
SPHERICAL: tuple[str, ...] = tuple(joint.name for joint in JOINTS if len(joint.low) == 3)
REVOLUTE: tuple[str, ...] = tuple(joint.name for joint in JOINTS if len(joint.low) == 1)
COORDINATES = 3 * len(SPHERICAL) + len(REVOLUTE)
"""Length of a pose: 28."""
COORDINATE_JOINT: tuple[int, ...] = tuple(i for i, joint in enumerate(JOINTS) for _ in joint.low)
"""For each coordinate of a pose, the index of its joint in `JOINTS`."""
LOW: Array = np.array([value for joint in JOINTS for value in joint.low])
HIGH: Array = np.array([value for joint in JOINTS for value in joint.high])
TORQUE: Array = np.array([JOINTS[i].torque for i in COORDINATE_JOINT])
STIFFNESS: Array = np.array([JOINTS[i].stiffness for i in COORDINATE_JOINT])
RATE: Array = np.array([JOINTS[i].rate for i in COORDINATE_JOINT])

DAMPING_RATIO = 0.1
"""Damping over stiffness, s."""
LIGAMENTS = 10.0
"""1/rad: beyond its range by e rad, a joint can bear (1 + 10 e) times the torque of its muscles."""
SCALE = 0.25
"""The model file is four times life size."""
_TURNED = 3 * len(SPHERICAL)
_SURE_W = 0.74
_SURE_FACTOR = 2.2
"""A quaternion with w > 0.74 has a rotation vector of less than 2.2 times its (x, y, z)."""


Command = tuple[list[list[float]], list[list[float]]]
"""A pose that is pulled to, joint by joint: in joint coordinates, and as Bullet takes it."""


class Athlete:
    """The athlete in one Bullet world.

    Args:
        client: the Bullet client that it is loaded into.
        joints: what they can do; those of `JOINTS` in their order, or some of them changed.
    """

    def __init__(self, client: int, joints: Sequence[Joint] = JOINTS) -> None:
        self.joints = tuple(joints)
        self._client = client
        self._k = {"physicsClientId": client}
        path = Path(pybullet_data.getDataPath()) / "humanoid" / "humanoid.urdf"
        flags = bullet.URDF_MERGE_FIXED_LINKS | bullet.URDF_USE_SELF_COLLISION
        self.body: int = bullet.loadURDF(str(path), [0, 1, 0], globalScaling=SCALE, flags=flags, **self._k)
        count = bullet.getNumJoints(self.body, **self._k)
        names = [bullet.getJointInfo(self.body, j, **self._k)[12].decode() for j in range(count)]
        self.link: dict[str, int] = {name: j for j, name in enumerate(names)}
        """Bullet's link index by name; the root is -1."""
        self.names: tuple[str, ...] = ("root", *names)
        """Bodies in the order of `links`."""
        self._links = list(range(count))
        self._joints = [self.link[joint.name] for joint in JOINTS]
        self._slots = self._coordinate_slots()
        self.mass: Array = np.array([bullet.getDynamicsInfo(self.body, j, **self._k)[0] for j in range(-1, count)])
        """Mass of each body ``[13]``, kg."""
        self._share = self.mass / self.mass.sum()
        self._gains = [joint.stiffness for joint in joints]
        self._stiffness = np.array([joints[i].stiffness for i in COORDINATE_JOINT])
        self._dampings = [joint.stiffness * DAMPING_RATIO for joint in joints]
        self._muscles = [[joint.torque] * len(joint.low) for joint in joints]
        self._forces = self._muscles
        self._still = [[0.0] * len(joint.low) for joint in joints]
        self._ranges = [(joint.low, joint.high) for joint in joints]
        self._surely_within = [
            tuple(bound / _SURE_FACTOR for axis in zip(joint.low, joint.high, strict=True) for bound in axis)
            for joint in joints[: len(SPHERICAL)]
        ]
        self._hinge_ranges = [(i, joint.low[0], joint.high[0]) for i, joint in enumerate(joints) if len(joint.low) == 1]
        self._held_within = held_within(joints)
        self._target: list[list[float]] = [[0.0] * len(joint.low) for joint in joints]
        self._command: list[list[float]] = []
        self.seen: Sequence[Any] = ()
        """Bullet's states of the joints when their ranges were last looked at, for `poses_of`."""
        self._free_the_joints()
        self.command(np.zeros(COORDINATES))

    def _free_the_joints(self) -> None:
        """Bullet brakes every joint with a motor of its own and every body with air drag: take both away."""
        for link in range(-1, len(self._links)):
            bullet.changeDynamics(self.body, link, linearDamping=0, angularDamping=0, **self._k)
        for name in REVOLUTE:
            bullet.setJointMotorControl2(self.body, self.link[name], bullet.POSITION_CONTROL, force=0, **self._k)
        for name in SPHERICAL:
            bullet.setJointMotorControlMultiDof(
                self.body,
                self.link[name],
                bullet.POSITION_CONTROL,
                [0, 0, 0, 1],
                targetVelocity=[0, 0, 0],
                positionGain=0,
                velocityGain=1,
                force=[0, 0, 0],
                **self._k,
            )

    def _coordinate_slots(self) -> list[int]:
        """For each coordinate of a pose, its index in Bullet's generalised velocities of the whole body."""
        start, at = {}, 7
        for name in self.link:
            start[name] = at
            at += 4 if name in SPHERICAL else 1
        return [start[joint.name] + axis for joint in JOINTS for axis in range(len(joint.low))]

    def place(self, position: Iterable[float], orientation: Iterable[float]) -> None:
        """Put the root somewhere ``[3]`` (m) and turn it ``[4]``; joints stay as they are."""
        bullet.resetBasePositionAndOrientation(self.body, list(position), list(orientation), **self._k)

    def push(self, velocity: Iterable[float], angular_velocity: Iterable[float]) -> None:
        """Give the root its velocity ``[3]`` (m/s) and angular velocity ``[3]`` (rad/s), world frame."""
        bullet.resetBaseVelocity(self.body, list(velocity), list(angular_velocity), **self._k)

    def bend(self, pose: NDArray[Any], rates: NDArray[Any]) -> None:
        """Put the joints into a pose ``[28]`` at these rates ``[28]``."""
        positions: list[list[float]] = rotations.from_rotation_vector(pose[:_TURNED].reshape(-1, 3)).tolist()
        positions += [[value] for value in pose[_TURNED:].tolist()]
        speeds: list[list[float]] = rates[:_TURNED].reshape(-1, 3).tolist()
        speeds += [[value] for value in rates[_TURNED:].tolist()]
        bullet.resetJointStatesMultiDof(self.body, self._joints, positions, speeds, **self._k)

    def pose(self) -> tuple[Array, Array]:
        """Joint coordinates and rates, ``[28]`` each."""
        states = bullet.getJointStatesMultiDof(self.body, self._joints, **self._k)
        rates = [rate for s in states for rate in s[1]]
        return poses_of([states])[0], np.array(rates)

    def links(self) -> Array:
        """State of each body ``[13, 13]``: centre of mass (m), orientation (x y z w), velocity, angular velocity."""
        position, orientation = bullet.getBasePositionAndOrientation(self.body, **self._k)
        velocity, angular = bullet.getBaseVelocity(self.body, **self._k)
        states = bullet.getLinkStates(
            self.body, self._links, computeLinkVelocity=1, computeForwardKinematics=1, **self._k
        )
        rows = [position + orientation + velocity + angular]
        rows += [s[0] + s[1] + s[6] + s[7] for s in states]
        return np.array(rows)

    def root(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Position ``[3]`` and orientation ``[4]`` of the root: the cheap part of `links`."""
        position, orientation = bullet.getBasePositionAndOrientation(self.body, **self._k)
        return position, orientation

    def spin(self) -> float:
        """Magnitude of the root's angular velocity, rad/s."""
        x, y, z = bullet.getBaseVelocity(self.body, **self._k)[1]
        return math.sqrt(x * x + y * y + z * z)

    def centre_of_mass(self, links: Array) -> Array:
        """Centre of mass ``[3]`` (m), or its velocity where `links` are velocities ``[13, >=3]``."""
        return np.asarray(self._share @ links[:, :3])

    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest corner ``[3]`` of the box that holds all bodies. Right only after a step or `links`."""
        boxes = np.array([bullet.getAABB(self.body, j, **self._k) for j in range(-1, len(self._links))])
        return boxes[:, 0].min(0), boxes[:, 1].max(0)

    def rear(self) -> float:
        """Lowest x of all bodies, m: the part of `bounds` that is asked for at each frame of a landing."""
        return float(min(bullet.getAABB(self.body, j, **self._k)[0][0] for j in range(-1, len(self._links))))

    def command(self, target: NDArray[Any]) -> None:
        """Set the pose ``[28]`` that the PD controllers pull to from now on. It may lie beyond the ranges."""
        self.follow(self.commands(np.asarray(target, np.float64)[None])[0])

    def commands(self, targets: NDArray[np.float64]) -> list[Command]:
        """Poses ``[n, 28]`` made ready for `follow`, which takes less time than one `command` for each."""
        if self._held_within is not None:
            targets = np.clip(targets, *self._held_within)
        balls = targets[:, :_TURNED].reshape(len(targets), -1, 3)
        hinges = targets[:, _TURNED:, None].tolist()
        quaternions = rotations.from_rotation_vector(balls).tolist()
        return [(b + h, q + h) for b, h, q in zip(balls.tolist(), hinges, quaternions, strict=True)]

    def follow(self, command: Command) -> None:
        """Set what the PD controllers pull to from now on, one of `commands`."""
        self._target, self._command = command
        self._limited = self._command

    def actuate(self, *, watch_limits: bool) -> None:
        """Set the torques of the next Bullet step; `watch_limits` looks at the joints' ranges anew."""
        if watch_limits:
            self._watch_ranges()
        bullet.setJointMotorControlMultiDofArray(
            self.body,
            self._joints,
            bullet.STABLE_PD_CONTROL,
            targetPositions=self._limited,
            targetVelocities=self._still,
            positionGains=self._gains,
            velocityGains=self._dampings,
            forces=self._forces,
            **self._k,
        )

    def torques(self, dt: float) -> Array:
        """Torques ``[28]`` (N m) of muscles and ligaments in Bullet's next step of `dt` seconds, after `actuate`.

        Bullet keeps them to itself, so this is stable PD control once more, in numpy and slow: for
        recordings. A test holds it against Bullet's.
        """
        states = bullet.getJointStatesMultiDof(self.body, self._links, **self._k)
        position, orientation = bullet.getBasePositionAndOrientation(self.body, **self._k)
        velocity, angular = bullet.getBaseVelocity(self.body, **self._k)
        # Bullet lays out quaternions and the rates beside them in four slots each, the last rate being 0
        q = [*position, *orientation, *(x for s in states for x in s[0])]
        qd = [*velocity, *angular, 0.0]
        for s in states:
            qd += [*s[1], 0.0] if len(s[1]) == 3 else s[1]
        M = np.array(bullet.calculateMassMatrix(self.body, q, flags=1, **self._k))
        C = np.array(bullet.calculateInverseDynamics(self.body, q, qd, [0.0] * len(qd), flags=1, **self._k))
        M[np.diag_indices_from(M)] += np.abs(M).sum(1) == 0
        kp, kd = self._stiffness, self._stiffness * DAMPING_RATIO
        rates = np.array(qd)[self._slots]
        error = kp * self._error_after(dt) - kd * rates
        force = -C
        force[self._slots] += error
        M[self._slots, self._slots] += kd * dt
        acceleration = np.linalg.solve(M, force)[self._slots]
        bound = np.array([force for forces in self._forces for force in forces])
        return np.asarray(np.clip(error - kd * dt * acceleration, -bound, bound))

    def _error_after(self, dt: float) -> Array:
        """What the joints lack to their targets ``[28]`` after `dt` seconds at their present rates, rad."""
        pose, rates = self.pose()
        turn = dt * rates[:_TURNED].reshape(-1, 3)
        then = rotations.multiply(
            rotations.from_rotation_vector(pose[:_TURNED].reshape(-1, 3)), rotations.from_rotation_vector(turn)
        )
        aims = np.array(self._limited[: len(SPHERICAL)])
        turned = rotations.to_rotation_vector(rotations.multiply(rotations.conjugate(then), aims))
        hinges = np.array([a[0] for a in self._limited[len(SPHERICAL) :]])
        return np.concatenate([turned.ravel(), hinges - (pose[_TURNED:] + dt * rates[_TURNED:])])

    def _watch_ranges(self) -> None:
        """Set targets and torque limits anew, with the penalty of the joints that are beyond their range.

        Plain Python, since numpy's overhead on so few numbers is several times the arithmetic.
        """
        limited, forces = list(self._command), list(self._muscles)
        states = self.seen = bullet.getJointStatesMultiDof(self.body, self._joints, **self._k)
        for i, (x0, x1, y0, y1, z0, z1) in enumerate(self._surely_within):
            x, y, z, w = states[i][0]
            # most joints, most of the time: told by comparisons alone
            if w > _SURE_W and x0 <= x <= x1 and y0 <= y <= y1 and z0 <= z <= z1:
                continue
            if w < 0:
                x, y, z, w = -x, -y, -z, -w
            length = math.sqrt(x * x + y * y + z * z)
            factor = 2 * math.atan2(length, w) / length if length > 1e-8 else 2.0
            self._restrain(i, (x * factor, y * factor, z * factor), limited, forces)
        for i, low, high in self._hinge_ranges:
            position = states[i][0]
            if not low <= position[0] <= high:
                self._restrain(i, position, limited, forces)
        self._limited, self._forces = limited, forces

    def _restrain(
        self, i: int, coordinates: tuple[float, ...], limited: list[list[float]], forces: list[list[float]]
    ) -> None:
        """Change target and torque limit of joint `i` where its coordinates (rad) are beyond its range."""
        moved: list[float] | None = None
        furthest = 0.0
        for axis, (value, low, high) in enumerate(zip(coordinates, *self._ranges[i], strict=True)):
            if value > high:
                excess = value - high
            elif value < low:
                excess = value - low
            else:
                continue
            moved = moved or list(self._target[i])
            aim = moved[axis]
            moved[axis] = (low if aim < low else min(aim, high)) - excess
            furthest = max(furthest, abs(excess))
        if moved is not None:
            limited[i] = moved if len(coordinates) == 1 else _quaternion(moved)
            share = 1 + LIGAMENTS * furthest
            forces[i] = [force * share for force in self._muscles[i]]


def poses_of(seen: Sequence[Sequence[Any]]) -> Array:
    """Poses ``[n, 28]`` of what `Athlete.seen` was at n times."""
    quaternions = np.array([[s[0] for s in states[: len(SPHERICAL)]] for states in seen])
    hinges = np.array([[s[0][0] for s in states[len(SPHERICAL) :]] for states in seen])
    return np.concatenate([rotations.to_rotation_vector(quaternions).reshape(len(seen), -1), hinges], 1)


def ranges(joints: Sequence[Joint]) -> tuple[Array, Array]:
    """Lowest and highest coordinates of joints ``[28]`` each, rad."""
    return np.array([v for joint in joints for v in joint.low]), np.array([v for joint in joints for v in joint.high])


def held_within(joints: Sequence[Joint]) -> tuple[Array, Array] | None:
    """Bounds of a pose ``[28]`` that keep the joints in casts within their ranges, or None where there are none."""
    if not any(joint.held for joint in joints):
        return None
    held = np.array([joints[i].held for i in COORDINATE_JOINT])
    low, high = ranges(joints)
    return np.where(held, low, -np.inf), np.where(held, high, np.inf)


def torque_bound(pose: NDArray[Any], joints: Sequence[Joint] = JOINTS) -> Array:
    """Largest torques ``[..., 28]`` (N m) that muscles and ligaments give in poses ``[..., 28]``."""
    low, high = ranges(joints)
    torque = np.array([joints[i].torque for i in COORDINATE_JOINT])
    beyond = np.maximum(np.maximum(pose - high, low - pose), 0.0)
    furthest = np.stack([beyond[..., np.array(COORDINATE_JOINT) == i].max(-1) for i in range(len(joints))], -1)
    bound: Array = torque * (1 + LIGAMENTS * furthest[..., list(COORDINATE_JOINT)])
    return bound


def _quaternion(e: list[float]) -> list[float]:
    """`rotations.from_rotation_vector` of one vector, without numpy's overhead."""
    angle = math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
    factor = math.sin(angle / 2) / angle if angle > 1e-8 else 0.5
    return [e[0] * factor, e[1] * factor, e[2] * factor, math.cos(angle / 2)]
