"""Where the athlete's bodies are in a pose, without a world: forward kinematics of many poses at once."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import pybullet as bullet
from numpy.typing import NDArray

from workers.physics import rotations
from workers.physics.athlete import JOINTS, SPHERICAL, Athlete
from workers.physics.rotations import Array


@dataclass(frozen=True, slots=True)
class Skeleton:
    """The athlete's measures, in the order of `Athlete.names`: the root first.

    Args:
        names: of the bodies.
        parent: index of each body's parent ``[13]``, a lower one; -1 for the root.
        arm: from the parent's centre of mass to the joint, in the parent's frame ``[13, 3]``, m.
        offset: from the joint to the body's centre of mass, in the body's frame ``[13, 3]``, m.
        mass: of the bodies ``[13]``, kg.
        hinges: axis of each hinge by name ``[3]``, in the parent's frame.
    """

    names: tuple[str, ...]
    parent: tuple[int, ...]
    arm: Array
    offset: Array
    mass: Array
    hinges: dict[str, Array]

    def forward(self, pose: NDArray[Any], position: NDArray[Any], orientation: NDArray[Any]) -> Bodies:
        """Bodies in poses ``[..., 28]`` of an athlete whose root is at ``[..., 3]`` (m), turned by ``[..., 4]``."""
        turns = joint_rotations(pose, self.hinges)
        places: list[Array] = [np.asarray(position, np.float64)]
        joints: list[Array] = [places[0]]
        turned: list[Array] = [np.asarray(orientation, np.float64)]
        order = {joint.name: i for i, joint in enumerate(JOINTS)}
        for body in range(1, len(self.names)):
            parent = self.parent[body]
            joint = places[parent] + rotations.rotate(turned[parent], self.arm[body])
            turn = rotations.multiply(turned[parent], turns[..., order[self.names[body]], :])
            joints.append(joint)
            turned.append(turn)
            places.append(joint + rotations.rotate(turn, self.offset[body]))
        return Bodies(np.stack(places, -2), np.stack(joints, -2), np.stack(turned, -2))

    def centre_of_mass(self, position: NDArray[Any]) -> Array:
        """Of the whole body ``[..., 3]`` from those of its parts ``[..., 13, 3]``."""
        return np.asarray(np.einsum("b,...bi->...i", self.mass / self.mass.sum(), position))


@dataclass(frozen=True, slots=True)
class Bodies:
    """Where the bodies of some poses are.

    Args:
        position: their centres of mass ``[..., 13, 3]``, m.
        joint: where each hangs on its parent ``[..., 13, 3]``, m; for the root its centre of mass.
        orientation: ``[..., 13, 4]``.
    """

    position: Array
    joint: Array
    orientation: Array


def joint_rotations(pose: NDArray[Any], hinges: dict[str, Array]) -> Array:
    """The joints' rotations ``[..., 12, 4]`` in poses ``[..., 28]``, in the order of `JOINTS`."""
    pose = np.asarray(pose, np.float64)
    turned = 3 * len(SPHERICAL)
    vectors = pose[..., :turned].reshape(*pose.shape[:-1], -1, 3)
    axes = np.stack([hinges[joint.name] for joint in JOINTS if len(joint.low) == 1])
    return rotations.from_rotation_vector(np.concatenate([vectors, pose[..., turned:, None] * axes], -2))


@functools.cache
def skeleton() -> Skeleton:
    """The measures of `Athlete`, as Bullet read them."""
    from workers.physics.world import quiet  # noqa: PLC0415 - the world needs the athlete, and no skeleton

    with quiet():
        client = bullet.connect(bullet.DIRECT)
        try:
            athlete = Athlete(client)
            infos = [bullet.getJointInfo(athlete.body, j, physicsClientId=client) for j in range(len(athlete.link))]
            offsets = [bullet.getLinkState(athlete.body, j, physicsClientId=client)[2] for j in range(len(infos))]
        finally:
            bullet.disconnect(client)
    names = athlete.names
    # all joints and inertial frames of this model are parallel to their parents: a test holds `forward` against Bullet
    return Skeleton(
        names,
        (-1, *(info[16] + 1 for info in infos)),
        np.array([(0.0, 0.0, 0.0), *(info[14] for info in infos)]),
        np.array([(0.0, 0.0, 0.0), *offsets]),
        athlete.mass,
        {info[12].decode(): np.array(info[13]) for info in infos if len(info[13]) and any(info[13])},
    )
