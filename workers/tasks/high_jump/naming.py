"""What would a person call this jump? From how the body lies as it passes the bar, and from what gets over it first.

"face-up layout, head first"; "upright, left side to the bar, left leg first". It takes off from the right foot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workers.contracts import JSON
from workers.physics import rotations
from workers.physics.kinematics import skeleton
from workers.physics.rotations import Array
from workers.replay import Replay
from workers.tasks.high_jump import behaviour, captured

_UPRIGHT = np.radians(50)
"""The trunk is upright within this angle of the vertical, and upside down within as much of its opposite."""
_FACING = np.radians(60)
"""The chest faces up, or down, within this angle."""
_TOGETHER = 0.05
"""s within which two parts get over the bar together."""
_LEADS = {"neck": "head", "left_ankle": "left leg", "right_ankle": "right leg"}
_PARTS = {
    "root": "hip", "chest": "back", "neck": "head", "right_ankle": "feet", "left_ankle": "feet", "right_knee": "feet",
    "left_knee": "feet", "right_elbow": "hands", "left_elbow": "hands", "right_shoulder": "shoulder",
    "left_shoulder": "shoulder", "right_hip": "legs", "left_hip": "legs",
}  # fmt: skip
"""What a body is called where it lands."""


@dataclass(frozen=True, slots=True)
class Naming:
    """A jump in words.

    Args:
        name: what tells it from other jumps.
        landing: the part that it lands on.
        clips: its distance to each captured jump, m; empty where none are at hand.
    """

    name: str
    landing: str
    clips: dict[str, float]

    def to_json(self) -> dict[str, JSON]:
        """As details of an outcome; `clips` only where there are some."""
        named: dict[str, JSON] = {"name": self.name, "landing": self.landing}
        return named | {"clips": {k: round(v, 4) for k, v in self.clips.items()}} if self.clips else named


def name_jump(replay: Replay, jumps: dict[str, captured.Flight] | None = None) -> Naming:
    """The words for a jump that passed the bar.

    Args:
        replay: of the jump.
        jumps: captured ones to compare it with; None for those that `HALMA_CLIPS` names.
    """
    passing = behaviour.over_the_bar(replay)
    orientation = replay.arrays["orientation"][-1, 0].astype(np.float64) if passing is None else passing[1]
    over = "box" if replay.header.get("task", {}).get("name") == "obstacle_jump" else "bar"
    if jumps is None:  # the captured ones are high jumps
        jumps = dict(captured.captured_jumps()) if over == "bar" else {}
    found = captured.distances(replay, jumps)
    words = [posture(orientation, over), lead(replay)]
    like = captured.likeness(found)
    if like is not None:
        words.append(f"like a {like.name}")
    return Naming(", ".join(word for word in words if word), landing(replay, orientation), found)


def posture(orientation: Array, over: str = "bar") -> str:
    """How the body lies or stands over the bar or the box, from the root's orientation ``[4]``."""
    forward, up, right = (rotations.rotate(orientation, axis) for axis in np.eye(3))
    inclination = np.arccos(np.clip(up[1], -1, 1))
    if inclination < _UPRIGHT:
        return f"upright, {_heading(forward, right, over)}"
    if inclination > np.pi - _UPRIGHT:
        return "upside down"
    facing = behaviour.facing(orientation)
    if facing < _FACING:
        return "face-up layout"
    if facing > np.pi - _FACING:
        return "face-down layout"
    return f"layout on the {'left' if right[1] > 0 else 'right'} side"


def _heading(forward: Array, right: Array, over: str) -> str:
    """Which way an upright body looks: x points over the bar."""
    if abs(forward[0]) >= abs(right[0]):
        return f"facing the {over}" if forward[0] > 0 else f"back to the {over}"
    return f"{'right' if right[0] > 0 else 'left'} side to the {over}"


def lead(replay: Replay) -> str:
    """What gets over the bar first: the head, a leg, or several of them within a twentieth of a second."""
    names = skeleton().names
    x = replay.arrays["position"][:, :, 0]
    times = {}
    for body, word in _LEADS.items():
        over = np.flatnonzero(x[:, names.index(body)] > 0)
        if len(over):
            times[word] = float(over[0]) * float(replay.header["frame_seconds"])
    if not times:
        return ""
    first = min(times.values())
    together = [word for word in _LEADS.values() if word in times and times[word] <= first + _TOGETHER]
    if len(together) == len(_LEADS):
        return "head and legs together"
    if together == ["left leg", "right leg"]:
        return "feet first"
    return f"{' and '.join(together)} first"


def landing(replay: Replay, orientation: Array) -> str:
    """The part that is lowest as the mat is first touched, or at the end; the chest is `back` or `front`.

    Args:
        replay: of the jump.
        orientation: of the root as it passed the bar ``[4]``, for a jump without a landing.
    """
    on_mat = np.flatnonzero(replay.arrays["touching"][:, 2] > 0)
    frame = int(on_mat[0]) if len(on_mat) else replay.frames - 1
    position, turned = (replay.arrays[name][frame].astype(np.float64) for name in ("position", "orientation"))
    lowest = min(replay.header["shapes"], key=lambda shape: _lowest_point(shape, position, turned))
    part = _PARTS[skeleton().names[lowest["body"]]]
    if part == "back" and behaviour.facing(turned[0] if len(on_mat) else orientation) > np.pi / 2:
        return "front"
    return part


def _lowest_point(shape: JSON, position: Array, turned: Array) -> float:
    """Height of a collision shape's lowest point, m (see `World.body_shapes`)."""
    body = shape["body"]
    q = turned[body]
    centre = position[body] + rotations.rotate(q, np.array(shape["offset"]))
    axes = rotations.rotate(rotations.multiply(q, np.array(shape["rotation"])), np.eye(3))
    size = shape["size"]
    if shape["shape"] == "sphere":
        return float(centre[1] - size[0])
    if shape["shape"] == "capsule":
        return float(centre[1] - size[0] - abs(axes[2, 1]) * size[1] / 2)
    return float(centre[1] - np.abs(axes[:, 1]) @ np.array(size) / 2)
