"""The walker's world: a floor, one walker, and the hand that helps it.

The helping hand is a PD controller on the root (Yu, Turk and Liu 2018, "Learning Symmetric and Low-Energy Locomotion",
section 4; gains of Yang 2021): it keeps the torso upright, facing forward, at its height and on its line,
and moves it at a steady speed. Its gains are kp = kd = 200 (1 - level), so that at level 1 the walker is on its own.
They are accelerations (1/s^2 and 1/s), so that a body of 6 kg is helped as much as one of 290 kg.

Hinges are moved by torques alone. What ligaments do beside muscles is a spring and a damper in each: without them
nobody stands long enough to learn anything.

Both are stiff for a step of 1/60 s, the dampers for a small foot alone: explicit control would throw them about. So it
is first felt how much each hinge and the root resist (`_felt`), and what damps is divided by
1 + damping x step / inertia, which is backward Euler's rule.

For the hand that inertia is a matrix: it pushes with the mass of the whole body, but in the first instant the torso
resists with half of that or less, as the legs hang on hinges, and it rocks when it is pushed. With the mass alone the
hand threw two bodies of three about and down.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pybullet as bullet
from numpy.typing import NDArray

from workers.physics.rotations import Array
from workers.physics.world import GRAVITY, quiet
from workers.tasks.walker.body import HINGES, Figure

STEP = 1 / 240
"""Seconds of a physics step."""
STEPS = 4
"""Physics steps in a control step: torques change 60 times a second."""
CONTROL = STEP * STEPS
SOLVER_ITERATIONS = 10
GAIN = 200.0
"""kp, 1/s^2, and kd, 1/s, where help is whole, as published."""
STIFFNESS = 40.0
"""N m/rad of every hinge's ligaments, whose rest is the standing pose. Two ankles need 700 to hold the whole body."""
DAMPING = 5.0
"""N m s/rad in every hinge."""
FASTEST = 30.0
"""rad/s; no hinge turns faster."""
_GROUND = 100.0
"""m that the floor extends to each side."""
JOINTS = list(range(len(HINGES)))
LOW: Array = np.array([hinge.low for hinge in HINGES])
HIGH: Array = np.array([hinge.high for hinge in HINGES])
TORQUE: Array = np.array([hinge.torque for hinge in HINGES])
FEET = tuple(i for i, hinge in enumerate(HINGES) if hinge.name.endswith("ankle_tilt"))
"""Bullet's links of the right and the left foot."""


class WalkerWorld:
    """One Bullet world with a walker, without display.

    Args:
        figure: the walker's measures.
        speed: that the helping hand pushes towards, m/s.
        gain: of the whole hand, kp (1/s^2) and kd (1/s).
    """

    def __init__(self, figure: Figure, *, speed: float, gain: float = GAIN) -> None:
        self.figure, self.speed, self.gain = figure, speed, gain
        self._urdf = figure.urdf()
        self._client = -1
        self._level = 1.0
        self.rebuild()

    def rebuild(self) -> None:
        """Begin again as newly constructed, bit for bit."""
        with quiet():
            if self._client < 0:
                self._client = bullet.connect(bullet.DIRECT)
            self._k = {"physicsClientId": self._client}
            bullet.resetSimulation(**self._k)
            with tempfile.TemporaryDirectory(prefix="halma-walker-") as folder:
                path = Path(folder) / "walker.urdf"
                path.write_text(self._urdf, encoding="utf-8")
                flags = bullet.URDF_USE_INERTIA_FROM_FILE | bullet.URDF_MAINTAIN_LINK_ORDER
                self.body: int = bullet.loadURDF(str(path), [0, self.figure.height, 0], flags=flags, **self._k)
        # A box, no plane, into which feet sink as they roll (see `World` of the athlete).
        ground = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=[_GROUND, 1.0, _GROUND], **self._k)
        self._floor = bullet.createMultiBody(0, ground, -1, [0, -1.0, 0], **self._k)
        bullet.changeDynamics(self._floor, -1, lateralFriction=1.0, **self._k)
        for link in range(-1, len(JOINTS)):
            bullet.changeDynamics(
                self.body, link, linearDamping=0, angularDamping=0, lateralFriction=1.0,
                maxJointVelocity=FASTEST, **self._k,
            )  # fmt: skip
        # Bullet brakes every hinge with a motor of its own: take it away
        bullet.setJointMotorControlArray(
            self.body, JOINTS, bullet.VELOCITY_CONTROL, forces=[0.0] * len(JOINTS), **self._k
        )
        bullet.setPhysicsEngineParameter(
            numSolverIterations=SOLVER_ITERATIONS, deterministicOverlappingPairs=1, numSubSteps=0, **self._k
        )
        self._mobility, hinges = self._felt()
        self.level = self._level
        self._yields: list[float] = (1 / (1 + CONTROL * DAMPING / hinges)).tolist()
        bullet.setGravity(0, -GRAVITY, 0, **self._k)
        bullet.setTimeStep(CONTROL, **self._k)
        bullet.setPhysicsEngineParameter(numSubSteps=STEPS, **self._k)
        self._links = [-1, *(i for i, hinge in enumerate(HINGES) if _carries(hinge.name))]

    def _felt(self) -> tuple[Array, Array]:
        """How the walker in the air yields: the speeds that a unit of force or torque gives in a physics step.

        Of the root, standing: mobility ``[6, 6]``, 1/kg and 1/(kg m^2), from a force (N) and a torque (N m) in the
        columns to velocity and angular velocity over the length of the step. Of the hinges, in the middle of their
        ranges: inertia ``[15]``, kg m^2.
        """
        bullet.setGravity(0, 0, 0, **self._k)
        bullet.setTimeStep(STEP, **self._k)
        mobility, hinges = np.empty((6, 6)), np.empty(len(JOINTS))
        standing, middle, above = np.zeros(len(JOINTS)), (LOW + HIGH) / 2, [0.0, self.figure.height + 1.0, 0.0]
        for column, unit in enumerate(np.eye(6)):
            self.place(standing, above)
            self._push(unit)
            bullet.stepSimulation(**self._k)
            mobility[:, column] = np.concatenate(bullet.getBaseVelocity(self.body, **self._k)) / STEP
        for joint, torque in enumerate(np.eye(len(JOINTS)).tolist()):
            self.place(middle, above)
            self._turn(torque)
            bullet.stepSimulation(**self._k)
            hinges[joint] = STEP / bullet.getJointState(self.body, joint, **self._k)[1]
        return mobility, hinges

    @property
    def level(self) -> float:
        """How far the help is withdrawn, in [0, 1]."""
        return self._level

    @level.setter
    def level(self, level: float) -> None:
        self._level = level
        gain = self.gain * (1 - level)
        whole = gain * np.array([self.figure.mass] * 3 + (1 / np.diag(self._mobility)[3:]).tolist())
        # backward Euler: the push is that for the speeds which it will have led to, v + dt mobility push
        implicit = np.linalg.solve(np.eye(6) + CONTROL * whole[:, None] * self._mobility, np.diag(whole))
        self._hand: Array = implicit.astype(np.float64)

    def _turn(self, torques: list[float]) -> None:
        """Torques ``[15]`` (N m) for the next control step."""
        bullet.setJointMotorControlArray(self.body, JOINTS, bullet.TORQUE_CONTROL, forces=torques, **self._k)

    def _push(self, wrench: Array) -> None:
        """Force ``[3]`` (N) and torque ``[3]`` (N m) on the torso's centre, world frame, for the next control step."""
        force, torque = wrench[:3].tolist(), wrench[3:].tolist()
        position, _ = bullet.getBasePositionAndOrientation(self.body, **self._k)
        bullet.applyExternalForce(self.body, -1, force, position, bullet.WORLD_FRAME, **self._k)
        bullet.applyExternalTorque(self.body, -1, torque, bullet.WORLD_FRAME, **self._k)

    def close(self) -> None:
        """Free Bullet's memory. A closed world can only be rebuilt."""
        if self._client >= 0:
            bullet.disconnect(self._client)
            self._client = -1

    def place(self, angles: NDArray[np.float64], position: list[float]) -> None:
        """Put the walker somewhere (torso's centre, m), upright and at rest, its hinges at ``[15]`` rad."""
        bullet.resetBasePositionAndOrientation(self.body, position, [0, 0, 0, 1], **self._k)
        bullet.resetBaseVelocity(self.body, [0, 0, 0], [0, 0, 0], **self._k)
        bullet.resetJointStatesMultiDof(
            self.body, JOINTS, [[angle] for angle in angles.tolist()], [[0.0]] * len(JOINTS), **self._k
        )

    def advance(self, torques: NDArray[np.float64]) -> None:
        """Simulate one control step (1/60 s) under these torques ``[15]``, N m, and those of the ligaments."""
        states = bullet.getJointStates(self.body, JOINTS, **self._k)
        self._turn(
            [
                torque - share * (STIFFNESS * state[0] + DAMPING * state[1])
                for torque, share, state in zip(torques.tolist(), self._yields, states, strict=True)
            ]
        )
        if self.level < 1:
            self._help()
        bullet.stepSimulation(**self._k)

    def _help(self) -> None:
        """The helping hand's push for the next control step.

        Force m g (target - x + target' - x') and torques I g (0 - tilt - spin) about the world's axes, where g is the
        gain, m the mass of the whole body and I what the root alone resists a turn with, all made implicit (`level`).
        """
        position, (x, y, z, w), velocity, spin = self.root()
        sign = -2.0 if w < 0 else 2.0  # small angles: twice the vector part of the short way
        lacking = (
            self.speed - velocity[0], self.figure.height - position[1] - velocity[1], -position[2] - velocity[2],
            -sign * x - spin[0], -sign * y - spin[1], -sign * z - spin[2],
        )  # fmt: skip
        self._push(self._hand @ np.array(lacking))

    def root(self) -> tuple[tuple[float, ...], ...]:
        """Position ``[3]``, orientation ``[4]``, velocity ``[3]`` and angular velocity ``[3]`` of the torso."""
        position, orientation = bullet.getBasePositionAndOrientation(self.body, **self._k)
        velocity, spin = bullet.getBaseVelocity(self.body, **self._k)
        return position, orientation, velocity, spin

    def joints(self) -> tuple[Array, Array]:
        """Angles and rates of the hinges, ``[15]`` each."""
        states = bullet.getJointStates(self.body, JOINTS, **self._k)
        return np.array([s[0] for s in states]), np.array([s[1] for s in states])

    def touching(self) -> set[int]:
        """Links that touch the floor; -1 is the torso."""
        return {point[3] for point in bullet.getContactPoints(self.body, self._floor, **self._k)}

    def links(self) -> Array:
        """State of each body ``[9, 10]``: centre of mass (m), orientation (x y z w), velocity (m/s)."""
        position, orientation, velocity, _ = self.root()
        states = bullet.getLinkStates(
            self.body, self._links[1:], computeLinkVelocity=1, computeForwardKinematics=1, **self._k
        )
        return np.array([position + orientation + velocity, *(s[0] + s[1] + s[6] for s in states)])

    def contacts(self) -> tuple[Array, Array]:
        """Force of the floor on each body (N) and where it acts (m), ``[9, 3]`` each, in the step just made.

        Bullet tells the impulse of the last physics step over the length of the control step: a part of the force.
        """
        force, point = np.zeros((len(self._links), 3)), np.zeros((len(self._links), 3))
        weight = np.zeros(len(self._links))
        for seen in bullet.getContactPoints(self.body, self._floor, **self._k):
            body = self._links.index(seen[3])
            normal, first, second = (np.asarray(seen[i]) for i in (7, 11, 13))
            force[body] += STEPS * (seen[9] * normal + seen[10] * first + seen[12] * second)
            point[body] += seen[9] * np.asarray(seen[5])
            weight[body] += seen[9]
        point[weight > 0] /= weight[weight > 0, None]
        return force, point


def _carries(hinge: str) -> bool:
    """Whether a body hangs on the hinge, rather than another hinge."""
    return hinge.endswith(("waist_bend", "pelvis_tilt", "hip_bend", "knee_bend", "ankle_tilt"))
