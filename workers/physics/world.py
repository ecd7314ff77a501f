"""The athlete's world: ground, wall and mat, looked at 120 times a second.

Stable PD control ignores contact, so a long step between two of its solutions starves the push-off. While a foot bears
on the ground, physics runs at 600 Hz and the controllers are solved at every step; in the air it runs at 240 Hz, the
controllers at 120 Hz: there the centre of mass then keeps to its parabola within 3 mm as a rule, 14 mm at worst
(at 600 Hz 1 and 6 mm), and a frame takes three fifths of the time. The joints' ranges are watched at 120 Hz in both.

A world remembers: contact caches and warm-started impulses differ between a used and a new one in the last bits. A
training that can be interrupted rebuilds its worlds at each iteration (`World.rebuild`).
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pybullet as bullet

from workers.physics.athlete import JOINTS, Athlete, Joint
from workers.physics.rotations import Array

FRAME = 1 / 120
"""Seconds between two looks at the world."""
LOADED_STEPS = 5
"""Physics steps in a frame while a foot bears on the ground; each of them solves the controllers."""
FLIGHT_STEPS = 2
"""Physics steps in a frame in the air."""
GRAVITY = 9.81
"""m/s^2, downwards."""
WALL_HALF_THICKNESS = 0.02
"""m; the bar's plane is the middle of the wall."""
_WALL_HALF_HEIGHT = 1.5
_HALF_WIDTH = 5.0
_GROUND = 100.0
"""m that the ground extends to each side."""
_MAT_HALF_LENGTH = 2.0
_SOLVER_ITERATIONS = 10
_LINE = 0.005
"""m that a line on the ground rises over it, so that what touches it is seen."""
_TOUCH = 0.002
"""Bodies closer than this (m) touch: Bullet reports contact points before they bear load."""
_LOADED_AFTER_CONTACT = 1.5 * FRAME
"""A foot counts as loaded for so many seconds after its last contact: it may skip a step or two."""


@dataclass(slots=True)
class Contacts:
    """What the athlete touched in one frame, by Bullet link index (-1: root).

    Args:
        ground, wall, mat: links that touched each.
        ground_force: normal force of the ground, mean over the frame, N.
        ground_peak: largest of its steps, N.
        penetration: deepest overlap of a body with ground, wall or mat, m.
        overlap: deepest overlap of two bodies of the athlete, m.
        torque: of the muscles at the start of the frame ``[28]``, N m; only where the world measures it.
        pushes: for each link touched, the force on it (N, mean over the frame) and the sum of where it acts times its
            normal part, as ``[force x y z, normal force, weighted point x y z]``; only where the world measures torque.
    """

    ground: set[int] = field(default_factory=set)
    wall: set[int] = field(default_factory=set)
    mat: set[int] = field(default_factory=set)
    ground_force: float = 0.0
    ground_peak: float = 0.0
    penetration: float = 0.0
    overlap: float = 0.0
    torque: Array | None = None
    pushes: dict[int, Array] = field(default_factory=dict)

    def add_push(self, link: int, point: Sequence[Any], *, is_first: bool, share: float) -> None:
        """Add one of Bullet's contact points to the link's push, for a step that is `share` of the frame."""
        # Bullet's normal leads from the second body to the first; friction acts on the first along its two directions.
        sign = 1.0 if is_first else -1.0
        normal, first, second = (np.asarray(point[i]) for i in (7, 11, 13))
        force = sign * (point[9] * normal + point[10] * first + point[12] * second)
        at = np.asarray(point[5 if is_first else 6])
        row = self.pushes.setdefault(link, np.zeros(7))
        row += share * np.concatenate([force, [point[9]], point[9] * at])


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Bullet prints from C while it loads: send file descriptor 1 elsewhere for so long."""
    sys.stdout.flush()
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


class World:
    """One Bullet world with an athlete, without display.

    The wall stands in the plane x = 0, the mat begins behind it.

    Args:
        mat_height: thickness of the mat, m.
        measure_torque: whether `advance` tells the muscles' torques and the contact forces, which takes longer than
            the frame itself.
        gravity: m/s^2, downwards.
        joints: of the athlete.
        furnished: whether there are wall and mat; without them `mat_height` is 0.
        loaded_steps: physics steps in a frame while a foot bears on the ground. Two (240 Hz) do for moving on the
            ground at half the time; the push of a jump needs five.
    """

    athlete: Athlete

    def __init__(
        self,
        mat_height: float = 0.3,
        *,
        measure_torque: bool = False,
        gravity: float = GRAVITY,
        joints: Sequence[Joint] = JOINTS,
        furnished: bool = True,
        loaded_steps: int = LOADED_STEPS,
    ) -> None:
        self.gravity = gravity
        self.joints = tuple(joints)
        self.furnished = furnished
        self.loaded_steps = loaded_steps
        self.mat_height = mat_height if furnished else 0.0
        self.measure_torque = measure_torque
        self._client = -1
        self.rebuild()

    def rebuild(self) -> None:
        """Begin again as newly constructed, bit for bit.

        Bullet makes a new dynamics world with new caches; connecting anew would do no more and take five times as long.
        """
        with quiet():
            if self._client < 0:
                self._client = bullet.connect(bullet.DIRECT)
            self._k = {"physicsClientId": self._client}
            bullet.resetSimulation(**self._k)
            bullet.setGravity(0, -self.gravity, 0, **self._k)
            self.athlete = Athlete(self._client, self.joints)
            # A box, no plane: against a plane Bullet finds one point of a rolling foot at a time, while its other end
            # sinks by centimetres under the body's weight, and a simulated second costs a fifth more.
            self._ground = self._box([_GROUND, 1.0, _GROUND])
            self._put(self._ground, 0.0, -1.0)
            bullet.changeDynamics(self._ground, -1, lateralFriction=1.0, **self._k)
            self.wall_half_thickness = WALL_HALF_THICKNESS
            self._wall = self._mat = -1
            if self.furnished:
                self._wall = self._box([WALL_HALF_THICKNESS, _WALL_HALF_HEIGHT, _HALF_WIDTH])
                self._mat = self._box([_MAT_HALF_LENGTH, self.mat_height / 2, _HALF_WIDTH])
        if self.furnished:
            self._put_mat()
        bullet.setPhysicsEngineParameter(
            numSolverIterations=_SOLVER_ITERATIONS, deterministicOverlappingPairs=1, numSubSteps=0, **self._k
        )
        self._in_flight = True
        self._set_flight(in_flight=False)
        self.set_bar(0.0)
        self.settle()

    def close(self) -> None:
        """Free Bullet's memory. A closed world can only be rebuilt."""
        if self._client >= 0:
            bullet.disconnect(self._client)
            self._client = -1

    def _box(self, half: list[float]) -> int:
        shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half, **self._k)
        return int(bullet.createMultiBody(0, shape, -1, [0, -10, 0], **self._k))

    def _put(self, body: int, x: float, y: float) -> None:
        bullet.resetBasePositionAndOrientation(body, [x, y, 0], [0, 0, 0, 1], **self._k)

    def _set_flight(self, *, in_flight: bool) -> None:
        """Let one call of Bullet make a loaded step, or all the steps of a frame in the air."""
        if in_flight == self._in_flight:
            return
        self._in_flight = in_flight
        bullet.setPhysicsEngineParameter(numSubSteps=FLIGHT_STEPS if in_flight else 0, **self._k)
        bullet.setTimeStep(FRAME if in_flight else FRAME / self.loaded_steps, **self._k)

    def set_bar(self, height: float) -> None:
        """Raise the wall to `height`, m; 0 buries it. Above 3 m its foot would leave the ground."""
        self.bar = height
        if self.furnished:
            self._put(self._wall, 0.0, height - _WALL_HALF_HEIGHT)

    def _put_mat(self) -> None:
        """The mat begins where the wall ends."""
        self._put(self._mat, self.wall_half_thickness + _MAT_HALF_LENGTH, self.mat_height / 2)

    def set_obstacle(self, height: float, width: float) -> None:
        """Put a box in place of the wall, its middle in the plane x = 0.

        Args:
            height: m; 0 is a line on the ground that must not be trodden on.
            width: along x, m.
        """
        if width / 2 != self.wall_half_thickness:
            # Bullet's shapes can't be stretched: another body takes the wall's place, and always after a `rebuild`.
            bullet.removeBody(self._wall, **self._k)
            self.wall_half_thickness = width / 2
            self._wall = self._box([width / 2, _WALL_HALF_HEIGHT, _HALF_WIDTH])
            self._put_mat()
        self.set_bar(max(height, _LINE))

    def settle(self) -> None:
        """Forget the contacts of the last episode; call after placing the athlete."""
        self._since_ground = np.inf

    @property
    def loaded(self) -> bool:
        """Whether the athlete bears on the ground (or did until a moment ago)."""
        return self._since_ground < _LOADED_AFTER_CONTACT

    @property
    def since_ground(self) -> float:
        """Seconds since the athlete last touched the ground, inf before it ever did."""
        return self._since_ground

    def resume(self, since_ground: float) -> None:
        """Say when the athlete, just placed, last touched the ground: what `since_ground` was then."""
        self._since_ground = since_ground

    def stand(self) -> None:
        """Say that the athlete bears on the ground from the first step on."""
        self._since_ground = 0.0

    def advance(self) -> Contacts:
        """Simulate one frame (1/120 s) and tell what was touched."""
        seen = Contacts()
        loaded = self.loaded
        self._set_flight(in_flight=not loaded)
        if loaded:
            dt = FRAME / self.loaded_steps
            for step in range(self.loaded_steps):
                self.athlete.actuate(watch_limits=step == 0)
                if step == 0 and self.measure_torque:
                    seen.torque = self.athlete.torques(dt)
                bullet.stepSimulation(**self._k)
                self._look(seen, dt, 1 / self.loaded_steps)
        else:
            self.athlete.actuate(watch_limits=True)
            if self.measure_torque:
                seen.torque = self.athlete.torques(FRAME)
            bullet.stepSimulation(**self._k)
            self._look(seen, FRAME, 1.0)
        return seen

    def _look(self, seen: Contacts, dt: float, share: float) -> None:
        """Add the contacts of the step just made to those `seen` in its frame."""
        self._since_ground += dt
        body = self.athlete.body
        points = bullet.getContactPoints(body, **self._k)
        if not points:
            return
        force = 0.0
        for point in points:
            distance = point[8]
            if distance > _TOUCH:
                continue
            is_first = point[1] == body
            link, other = (point[3], point[2]) if is_first else (point[4], point[1])
            if other == body:
                seen.overlap = max(seen.overlap, -distance)
                continue
            seen.penetration = max(seen.penetration, -distance)
            if self.measure_torque:
                seen.add_push(link, point, is_first=is_first, share=share)
            if other == self._ground:
                seen.ground.add(link)
                self._since_ground = 0.0
                force += point[9]
            elif other == self._wall:
                seen.wall.add(link)
            elif other == self._mat:
                seen.mat.add(link)
        seen.ground_force += force * share
        seen.ground_peak = max(seen.ground_peak, force)

    def sunk(self) -> float:
        """How deep the athlete, just placed, is in the ground, m."""
        self.athlete.links()  # or Bullet looks where the bodies were
        points = bullet.getClosestPoints(self.athlete.body, self._ground, 0.0, **self._k)
        return max((-point[8] for point in points), default=0.0)

    def body_shapes(self) -> list[dict[str, object]]:
        """Collision shapes of the athlete's bodies, for pictures.

        Each is `{"body": index, "shape": "sphere" | "capsule" | "box", "size": [...], "offset": [x, y, z],
        "rotation": [x, y, z, w]}` in the frame of the body's centre of mass; size is [radius], [radius, length along
        the shape's z] or [x, y, z], m.
        """
        kinds = {bullet.GEOM_SPHERE: "sphere", bullet.GEOM_CAPSULE: "capsule", bullet.GEOM_BOX: "box"}
        shapes: list[dict[str, object]] = []
        for body in range(len(self.athlete.names)):
            for data in bullet.getCollisionShapeData(self.athlete.body, body - 1, **self._k):
                kind = kinds[data[2]]
                length, radius = data[3][0], data[3][1]
                size = {"sphere": [length], "capsule": [radius, length], "box": list(data[3])}[kind]
                shapes.append(
                    {"body": body, "shape": kind, "size": size, "offset": list(data[5]), "rotation": list(data[6])}
                )
        return shapes
