"""Motion in BVH files, brought onto the athlete by the names of its joints.

Skeletons differ in their rest poses and in where their axes point, so angles can't be copied. The file's joints are
placed by its own kinematics, and the athlete's angles are those that point its bones the same way: trunk from hips,
shoulders and neck; limbs from their two bones, whose plane gives the twist.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from workers.physics import rotations
from workers.physics.athlete import REVOLUTE, SPHERICAL
from workers.physics.clips import BadClip, Clip, from_joints
from workers.physics.kinematics import skeleton
from workers.physics.rotations import Array
from workers.poses.encoding import quaternions_of

_SIDES = {"left": ("left", "l"), "right": ("right", "r")}
_LIMBS = {
    "hip": ("upleg", "hip", "thigh", "upperleg"),
    "knee": ("leg", "knee", "shin", "lowerleg", "calf"),
    "ankle": ("foot", "ankle"),
    "toe": ("toebase", "toe", "toes", "footend", "ankleend"),
    "shoulder": ("arm", "upperarm", "shoulder"),
    "elbow": ("forearm", "elbow", "lowerarm"),
    "wrist": ("hand", "wrist", "forearmend", "elbowend"),
}
_TRUNK = {
    "root": ("hips", "pelvis", "hip", "root"),
    "chest": ("chest", "torso", "spine1", "spine", "lowerback"),
    "neck": ("neck", "neck1"),
    "head": ("head", "neckend"),
}
"""What files call the joints, in lower case without spaces, underscores and colons; the first that is there counts."""
_MOST_JOINTS = 1000
_LEAST_SPINE = 0.15
"""Share of the way from hips to neck within which a joint of the spine is too near to an end."""
_STRAIGHT = 0.1
"""Sine of the angle below which a limb counts as straight."""


@dataclass(slots=True)
class _Node:
    """One joint of a file."""

    name: str
    parent: int
    offset: Array
    channels: list[str] = field(default_factory=list)
    at: int = 0


def read_bvh(path: Path) -> Clip:
    """The motion of a BVH file, on the athlete. Raises `BadClip`, naming the joints that are missing."""
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise BadClip(f"{path}: expected a BVH file, found nothing to read ({error})") from None
    head, separator, motion = text.partition("MOTION")
    if "HIERARCHY" not in head or not separator:
        raise BadClip(f"{path}: expected a BVH file (HIERARCHY, then MOTION), found something else")
    nodes = _hierarchy(path, head)
    names = _mapped(path, nodes)
    period, values = _motion(path, motion, sum(len(node.channels) for node in nodes))
    places = _places(nodes, values)
    sole = float(np.mean([np.arcsin(_unit(nodes[names[f"{side}_toe"]].offset[None])[0, 1]) for side in _SIDES]))
    return _onto_the_athlete(period, {joint: places[index] for joint, index in names.items()}, sole)


def _hierarchy(path: Path, text: str) -> list[_Node]:
    nodes: list[_Node] = []
    open_nodes: list[int] = []
    pending = -1
    words = iter(text.split())
    channels = 0
    try:
        for word in words:
            if word in {"ROOT", "JOINT", "End"}:
                name = next(words)
                parent = open_nodes[-1] if open_nodes else -1
                nodes.append(_Node(name if word != "End" else f"{nodes[parent].name}End", parent, np.zeros(3)))
                pending = len(nodes) - 1
                if pending > _MOST_JOINTS:
                    raise BadClip(f"{path}: expected at most {_MOST_JOINTS} joints, found more")
            elif word == "{":
                open_nodes.append(pending)
            elif word == "}":
                open_nodes.pop()
            elif word == "OFFSET":
                nodes[open_nodes[-1]].offset = np.array([float(next(words)) for _ in range(3)])
            elif word == "CHANNELS":
                node = nodes[open_nodes[-1]]
                node.at = channels
                node.channels = [next(words) for _ in range(int(next(words)))]
                channels += len(node.channels)
    except (StopIteration, IndexError, ValueError) as error:
        raise BadClip(f"{path}: expected a BVH hierarchy, found one that can't be read ({error!r})") from None
    if not nodes or open_nodes:
        raise BadClip(f"{path}: expected a BVH hierarchy with matching braces, found {len(open_nodes)} left open")
    return nodes


def _motion(path: Path, text: str, channels: int) -> tuple[float, Array]:
    """Seconds a frame, and the frames' values ``[frame, channel]``."""
    lines = [line for line in text.splitlines() if line.strip()]
    about = re.search(r"Frames:\s*(\d+)\s+Frame Time:\s*([0-9.eE+-]+)", text)
    if about is None:
        raise BadClip(f"{path}: expected `Frames:` and `Frame Time:` after MOTION, found none")
    count, period = int(about[1]), float(about[2])
    rows = [line.split() for line in lines[2:]]
    for i, row in enumerate(rows):
        if len(row) != channels:
            raise BadClip(f"{path}: frame {i}: expected {channels} values, found {len(row)}")
    if len(rows) != count or count < 2:
        raise BadClip(f"{path}: expected {max(count, 2)} frames, found {len(rows)}")
    try:
        values = np.array(rows, np.float64)
    except ValueError:
        raise BadClip(f"{path}: expected numbers only, found something else among them") from None
    if not np.isfinite(values).all() or not period > 0:
        raise BadClip(f"{path}: expected finite numbers and a frame time above 0, found others")
    return period, values


def _mapped(path: Path, nodes: list[_Node]) -> dict[str, int]:
    """Which node is which joint of ours."""
    known = {
        re.sub(r"[^a-z0-9]", "", node.name.split(":")[-1].lower()): i for i, node in reversed(list(enumerate(nodes)))
    }
    found: dict[str, int] = {}
    for joint, words in _TRUNK.items():
        for word in reversed(words):
            if word in known:
                found[joint] = known[word]
    for joint, words in _LIMBS.items():
        for side, marks in _SIDES.items():
            for word in reversed(words):
                for name in (f"{mark}{word}" for mark in reversed(marks)):
                    if name in known:
                        found[f"{side}_{joint}"] = known[name]
    wanted = [*_TRUNK, *(f"{side}_{joint}" for joint in _LIMBS for side in _SIDES)]
    missing = [joint for joint in wanted if joint not in found]
    if missing:
        there = ", ".join(node.name for node in nodes[:40])
        raise BadClip(
            f"{path}: expected the joints of a person, found none for {', '.join(missing)}; the file has {there}"
        )
    return found


def _places(nodes: list[_Node], values: Array) -> list[Array]:
    """World positions ``[frame, 3]`` of each joint, in the file's unit."""
    frames = len(values)
    places: list[Array] = []
    turns: list[Array] = []
    for node in nodes:
        shift, turn = np.tile(node.offset, (frames, 1)), np.tile(rotations.IDENTITY, (frames, 1))
        for i, channel in enumerate(node.channels):
            column = values[:, node.at + i]
            axis = "XYZ".index(channel[0].upper())
            if channel.lower().endswith("position"):
                shift[:, axis] = column if node.parent < 0 else shift[:, axis] + column
            else:
                turn = rotations.multiply(
                    turn, rotations.from_rotation_vector(np.radians(column)[:, None] * np.eye(3)[axis])
                )
        if node.parent < 0:
            places.append(shift)
            turns.append(turn)
        else:
            above = turns[node.parent]
            places.append(places[node.parent] + rotations.rotate(above, shift))
            turns.append(rotations.multiply(above, turn))
    return places


def _onto_the_athlete(period: float, at: dict[str, Array], sole: float) -> Clip:
    """The athlete's clip from the file's joint positions ``[frame, 3]`` by name.

    Args:
        period: seconds between two frames.
        at: the positions.
        sole: slope of the foot's bone where the foot is flat, rad.
    """
    shoulders, hips = at["right_shoulder"] - at["left_shoulder"], at["right_hip"] - at["left_hip"]
    middle = (at["right_hip"] + at["left_hip"]) / 2
    waist = _waist(middle, at["chest"], at["neck"])
    root = _frame(waist - middle, hips)
    chest = _frame(at["neck"] - waist, shoulders)
    joints = {"chest": _relative(root, chest)}
    joints["neck"] = _relative(chest, _frame(at["head"] - at["neck"], shoulders))
    hinges: dict[str, Array] = {}
    for side in _SIDES:
        for upper, lower, end, base, sign in (
            ("hip", "knee", "ankle", root, -1.0),
            ("shoulder", "elbow", "wrist", chest, 1.0),
        ):
            bone = at[f"{side}_{lower}"] - at[f"{side}_{upper}"]
            other = at[f"{side}_{end}"] - at[f"{side}_{lower}"]
            limb = _limb(bone, other, sign, rotations.rotate(base, np.array([0.0, 0.0, 1.0])))
            joints[f"{side}_{upper}"] = _relative(base, limb)
            hinges[f"{side}_{lower}"] = sign * _angle(bone, other)
            if upper == "hip":
                shin = rotations.multiply(limb, _about_z(hinges[f"{side}_{lower}"]))
                foot = rotations.rotate(rotations.conjugate(shin), at[f"{side}_toe"] - at[f"{side}_ankle"])
                joints[f"{side}_ankle"] = _about_z(np.arctan2(foot[:, 1], foot[:, 0]) - sole)
    quaternions = np.stack([joints[name] for name in SPHERICAL], 1)
    angles = np.stack([hinges[name] for name in REVOLUTE], 1)
    return from_joints(period, middle * _scale(at), root, quaternions, angles)


def _scale(at: dict[str, Array]) -> float:
    """From the file's unit to metres: the athlete's legs over those in the file."""
    bones = [at[f"{side}_{b}"] - at[f"{side}_{a}"] for side in _SIDES for a, b in (("hip", "knee"), ("knee", "ankle"))]
    body = skeleton()
    index = {joint: body.names.index(f"left_{joint}") for joint in ("hip", "knee", "ankle")}
    ours = sum(
        float(np.linalg.norm(body.offset[index[a]] + body.arm[index[b]]))
        for a, b in (("hip", "knee"), ("knee", "ankle"))
    )
    return ours / float(sum(np.linalg.norm(bone, axis=1).mean() for bone in bones) / 2)


def _waist(middle: Array, chest: Array, neck: Array) -> Array:
    """Where the trunk bends: the file's joint, or halfway where that is too near to an end to point anywhere."""
    share = float(np.linalg.norm(chest - middle, axis=1).mean() / np.linalg.norm(neck - middle, axis=1).mean())
    return chest if _LEAST_SPINE < share < 1 - _LEAST_SPINE else (middle + neck) / 2


def _frame(up: Array, right: Array) -> Array:
    """Rotations ``[frame, 4]`` whose y is along `up` and whose z is as near to `right` as that allows."""
    y = _unit(up)
    z = _unit(right - (right * y).sum(1, keepdims=True) * y)
    return _quaternions(np.cross(y, z), y, z)


def _limb(bone: Array, other: Array, sign: float, right: Array) -> Array:
    """Rotations ``[frame, 4]`` of an upper limb that hangs along -y and whose hinge is z.

    The hinge is the normal of the plane of both bones, `sign` times what their order gives (knees bend backwards); of a
    straight limb it is the body's right.
    """
    y = -_unit(bone)
    normal = sign * np.cross(_unit(bone), _unit(other))
    straight = np.linalg.norm(normal, axis=1) < _STRAIGHT
    z = np.where(straight[:, None], right, normal)
    z = _unit(z - (z * y).sum(1, keepdims=True) * y)
    return _quaternions(np.cross(y, z), y, z)


def _quaternions(x: Array, y: Array, z: Array) -> Array:
    return quaternions_of(np.stack([x, y, z], -1))


def _relative(parent: Array, child: Array) -> Array:
    return rotations.multiply(rotations.conjugate(parent), child)


def _about_z(angle: Array) -> Array:
    return rotations.from_rotation_vector(angle[:, None] * np.array([0.0, 0.0, 1.0]))


def _angle(a: Array, b: Array) -> Array:
    return np.asarray(np.arccos(np.clip((_unit(a) * _unit(b)).sum(1), -1, 1)))


def _unit(v: Array) -> Array:
    return np.asarray(v / (np.linalg.norm(v, axis=1, keepdims=True) + 1e-12))
