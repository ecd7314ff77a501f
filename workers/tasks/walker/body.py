"""The walker's body: twelve factors in, a URDF out.

Nine bodies hang on fifteen hinges: torso, waist and pelvis (three hinges between them), and for each leg a thigh (three
in the hip), what is below the knee (one), and a foot (two in the ankle). The factors multiply lengths and radii; masses
follow from the volumes, the muscles' torques stay what they are.

World and body frames: x forward, y up, z to the right. In the pose 0 the walker stands upright.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from workers.contracts import JSON, ParameterSpec, Scalar

PARTS = ("torso", "waist", "pelvis", "thigh", "knee", "foot")
"""What has a length and a radius; `knee` is the part between knee and ankle."""
LENGTH = {"torso": 0.30, "waist": 0.10, "pelvis": 0.20, "thigh": 0.40, "knee": 0.40, "foot": 0.20}
"""m, from joint to joint; the pelvis' is the distance of the hips."""
RADIUS = {"torso": 0.13, "waist": 0.11, "pelvis": 0.10, "thigh": 0.07, "knee": 0.05, "foot": 0.035}
"""m. A foot is a box, twice its radius high and three times as wide."""
DENSITY = 1000.0
"""kg/m^3. The body weighs 69 kg where all factors are 1."""
ROTOR = 0.02
"""kg m^2 that each hinge's drive adds to the body it moves, as motors and muscles do. Without it a small foot (1e-4) is
turned by 90 N m to any speed within one step."""

PARAMETERS: Mapping[str, ParameterSpec] = {
    **{f"{part}_length": ParameterSpec("float", 0.3, 2.0, unit="x") for part in PARTS},
    **{f"{part}_radius": ParameterSpec("float", 0.5, 1.5, unit="x") for part in PARTS},
}
"""The thesis' space (Yang 2021): factors of lengths and radii."""

Axis = Literal["x", "y", "z"]


@dataclass(frozen=True, slots=True)
class Hinge:
    """One of the fifteen joints.

    Args:
        name: of the joint.
        axis: x tilts to the side, y turns, z bends forward (positive swings what hangs below forward).
        torque: most that it gives, N m.
        low, high: its range, rad.
    """

    name: str
    axis: Axis
    torque: float
    low: float
    high: float


HINGES: tuple[Hinge, ...] = (
    Hinge("waist_turn", "y", 60.0, -0.8, 0.8),
    Hinge("waist_bend", "z", 90.0, -0.5, 1.0),
    Hinge("pelvis_tilt", "x", 60.0, -0.6, 0.6),
    *(
        Hinge(f"{side}_{name}", axis, torque, low, high)  # type: ignore[arg-type] # the tuples below hold axes
        for side in ("right", "left")
        for name, axis, torque, low, high in (
            ("hip_tilt", "x", 80.0, -0.6, 0.6),
            ("hip_turn", "y", 40.0, -0.7, 0.7),
            ("hip_bend", "z", 120.0, -0.7, 2.0),
            ("knee_bend", "z", 90.0, -2.5, 0.0),
            ("ankle_bend", "z", 60.0, -0.8, 0.6),
            ("ankle_tilt", "x", 30.0, -0.4, 0.4),
        )
    ),
)
"""In the order of actions and of Bullet's joints."""


@dataclass(frozen=True, slots=True)
class Solid:
    """What a body is made of: a capsule or a box, about its own centre of mass.

    Args:
        shape: `capsule` along `axis`, or `box`.
        size: radius and length of the straight part, or the three edges, m.
        axis: of the capsule.
        offset: from the body's joint to its centre ``[3]``, m.
    """

    shape: Literal["capsule", "box"]
    size: tuple[float, ...]
    axis: Axis
    offset: tuple[float, float, float]

    @property
    def mass(self) -> float:
        """Of the whole solid, kg."""
        if self.shape == "box":
            return DENSITY * math.prod(self.size)
        r, length = self.size
        return DENSITY * math.pi * r * r * (length + 4 / 3 * r)

    @property
    def inertia(self) -> tuple[float, float, float]:
        """Moments about x, y and z through the centre, kg m^2."""
        if self.shape == "box":
            a, b, c = (edge * edge for edge in self.size)
            m = self.mass / 12
            return m * (b + c), m * (a + c), m * (a + b)
        r, length = self.size
        tube, caps = DENSITY * math.pi * r * r * length, DENSITY * math.pi * r**3 * 4 / 3
        along = tube * r * r / 2 + caps * r * r * 2 / 5
        across = tube * (length**2 / 12 + r * r / 4) + caps * (r * r * 2 / 5 + length**2 / 4 + length * r * 3 / 8)
        x, y, z = (along if axis == self.axis else across for axis in "xyz")
        return x, y, z

    @property
    def rotation(self) -> tuple[float, float, float, float]:
        """From the shape's own frame, in which capsules lie along z, to the body's (x y z w)."""
        half = math.sqrt(0.5)
        turned = {"x": (0.0, half, 0.0, half), "y": (-half, 0.0, 0.0, half), "z": (0.0, 0.0, 0.0, 1.0)}
        return turned[self.axis]


@dataclass(frozen=True, slots=True)
class Body:
    """A body of the walker.

    Args:
        name: `torso`, `right_thigh`, ...
        parent: name of the body that it hangs on, None for the torso.
        hinges: between the two, the parent's end first.
        at: where they are, from the parent's joint (the torso's centre) ``[3]``, m.
        solid: what it is made of.
    """

    name: str
    parent: str | None
    hinges: tuple[Hinge, ...]
    at: tuple[float, float, float]
    solid: Solid


@dataclass(frozen=True, slots=True)
class Figure:
    """A walker of certain measures.

    Args:
        bodies: the torso first, each after its parent.
        height: of the torso's centre where it stands upright, m.
    """

    bodies: tuple[Body, ...]
    height: float

    @property
    def mass(self) -> float:
        """Of all bodies, kg."""
        return math.fsum(body.solid.mass for body in self.bodies)

    def shapes(self) -> list[dict[str, JSON]]:
        """The bodies' shapes as a replay's header names them, each in the frame of its centre of mass."""
        return [
            {
                "body": i,
                "shape": body.solid.shape,
                "size": list(body.solid.size),
                "offset": [0.0, 0.0, 0.0],
                "rotation": list(body.solid.rotation),
            }
            for i, body in enumerate(self.bodies)
        ]

    def urdf(self) -> str:
        """The walker as URDF. Links between two hinges of the same joint have no mass, only the drive's inertia."""
        parts = ['<robot name="walker">']
        for body in self.bodies:
            above = body.parent
            for i, hinge in enumerate(body.hinges):
                last = i == len(body.hinges) - 1
                below = body.name if last else f"{hinge.name}_link"
                place = body.at if i == 0 else (0.0, 0.0, 0.0)
                if not last:
                    parts.append(_link(below, None))
                parts.append(_joint(hinge, str(above), below, place))
                above = below
            parts.append(_link(body.name, body.solid))
        parts.append("</robot>")
        return "\n".join(parts)


def figure(params: Mapping[str, Scalar]) -> Figure:
    """The walker of a candidate; factors that it does not name are 1."""
    length = {part: LENGTH[part] * float(params.get(f"{part}_length", 1.0)) for part in PARTS}
    radius = {part: RADIUS[part] * float(params.get(f"{part}_radius", 1.0)) for part in PARTS}
    hinge = {each.name: each for each in HINGES}

    def capsule(part: str, axis: Axis, offset: tuple[float, float, float]) -> Solid:
        return Solid("capsule", (radius[part], length[part]), axis, offset)

    bodies = [
        Body("torso", None, (), (0.0, 0.0, 0.0), capsule("torso", "y", (0.0, 0.0, 0.0))),
        Body(
            "waist",
            "torso",
            (hinge["waist_turn"], hinge["waist_bend"]),
            (0.0, -length["torso"] / 2, 0.0),
            capsule("waist", "y", (0.0, -length["waist"] / 2, 0.0)),
        ),
        Body(
            "pelvis",
            "waist",
            (hinge["pelvis_tilt"],),
            (0.0, -length["waist"], 0.0),
            capsule("pelvis", "z", (0.0, 0.0, 0.0)),
        ),
    ]
    r, foot = radius["foot"], length["foot"]
    for side, sign in (("right", 1.0), ("left", -1.0)):
        bodies += [
            Body(
                f"{side}_thigh",
                "pelvis",
                tuple(hinge[f"{side}_hip_{way}"] for way in ("tilt", "turn", "bend")),
                (0.0, 0.0, sign * length["pelvis"] / 2),
                capsule("thigh", "y", (0.0, -length["thigh"] / 2, 0.0)),
            ),
            Body(
                f"{side}_knee",
                f"{side}_thigh",
                (hinge[f"{side}_knee_bend"],),
                (0.0, -length["thigh"], 0.0),
                capsule("knee", "y", (0.0, -length["knee"] / 2, 0.0)),
            ),
            Body(
                f"{side}_foot",
                f"{side}_knee",
                (hinge[f"{side}_ankle_bend"], hinge[f"{side}_ankle_tilt"]),
                (0.0, -length["knee"], 0.0),
                # a quarter of the foot is behind the ankle, its sole two radii below
                Solid("box", (foot, 2 * r, 3 * r), "z", (foot / 4, -r, 0.0)),
            ),
        ]
    height = length["torso"] / 2 + length["waist"] + length["thigh"] + length["knee"] + 2 * r
    return Figure(tuple(bodies), height)


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _link(name: str, solid: Solid | None) -> str:
    """A link with its inertia; without a solid only that of a drive."""
    mass, inertia, offset, shape = 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), ""
    if solid is not None:
        mass, inertia, offset = solid.mass, solid.inertia, solid.offset
        if solid.shape == "box":
            drawn, turn = f'<box size="{_numbers(solid.size)}"/>', (0.0, 0.0, 0.0)
        else:
            drawn = f'<capsule radius="{solid.size[0]:.9g}" length="{solid.size[1]:.9g}"/>'
            turn = (-math.pi / 2, 0.0, 0.0) if solid.axis == "y" else (0.0, 0.0, 0.0)
        origin = f'<origin xyz="{_numbers(offset)}" rpy="{_numbers(turn)}"/>'
        shape = f"<collision>{origin}<geometry>{drawn}</geometry></collision>"
    x, y, z = (moment + ROTOR for moment in inertia)
    return (
        f'<link name="{name}"><inertial><origin xyz="{_numbers(offset)}"/><mass value="{mass:.9g}"/>'
        f'<inertia ixx="{x:.9g}" iyy="{y:.9g}" izz="{z:.9g}" ixy="0" ixz="0" iyz="0"/></inertial>{shape}</link>'
    )


def _joint(hinge: Hinge, parent: str, child: str, at: tuple[float, float, float]) -> str:
    axis = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}[hinge.axis]
    return (
        f'<joint name="{hinge.name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_numbers(at)}"/><axis xyz="{axis}"/>'
        f'<limit lower="{hinge.low}" upper="{hinge.high}" effort="{hinge.torque}" velocity="100"/></joint>'
    )
