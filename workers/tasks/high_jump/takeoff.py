"""How a jump begins: the take-off state x = (alpha, omega_x, omega_z, v_z) made into a state of the athlete.

Conventions are those of the published jumping system (Yin et al. 2021 and its released environment). In the athlete's
heading frame x points forward, y up, z to the right. The bar's plane is at angle `alpha` (rad): 0 means that the bar is
parallel to the run-up, to the athlete's left; pi/2 that it lies straight ahead. `v_z` (m/s) is the sideways velocity,
negative to the left, towards the bar. The spin is (omega_x, 3, omega_z) rad/s: negative omega_x leans the body to the
left, positive omega_z leans it back. The athlete takes off from the right foot, the one further from the bar.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from workers.contracts import ParameterSpec
from workers.physics import clips, rotations
from workers.physics.athlete import COORDINATES, JOINTS, SPHERICAL, held_within
from workers.physics.rotations import Array
from workers.physics.world import World

Formulation = Literal["support", "flight"]

OMEGA_Y = 3.0
"""rad/s; hardly differs between published strategies."""
TAKE_OFF_FOOT = "right_ankle"
_STANCE_LEG = ("right_hip", "right_knee", "right_ankle")
RUN = "run"
MID_SUPPORT_FRAME = 1
_TOE_OFF_FRAME = 4
_BENT = -0.7
"""rad that the knee of the stance leg is bent by at the start."""
_SWUNG = 0.9
"""rad that a swing leg is brought forward by at the start where its knee can't bend: its foot is 13 cm above the floor,
which it would reach before the take-off foot otherwise."""
_RATE_BOUND = 20.0
"""rad/s; no joint of the stance leg starts faster than this."""

_MOST = {"rad": 3.2, "rad/s": 15.0, "m/s": 8.0}
"""Largest amounts of a take-off state, by their units: no athlete takes off with more."""


def _parameter(low: float, high: float, unit: str) -> ParameterSpec:
    return ParameterSpec("float", low, high, unit=unit, least=-_MOST[unit], most=_MOST[unit])


# The published strategies of the high jump lie at alpha -0.05 to 2.09, omega_x -3 to 1, omega_z -1 to 1, v_z -2.4 to
# -0.5; with the slower run-up here, too, each of them learns to jump a metre or nearly so. omega_z is wider, as in the
# published obstacle jumps (-2 to 3.9): in the short flight over a low bar it is what turns the body.
PARAMETERS: Mapping[str, ParameterSpec] = {
    "alpha": _parameter(-0.1, 2.1, "rad"),
    "omega_x": _parameter(-3.0, 1.0, "rad/s"),
    "omega_z": _parameter(-4.0, 4.0, "rad/s"),
    "v_z": _parameter(-2.5, -0.5, "m/s"),
}

# The published strategies over an obstacle lie at omega_x -2.67 to 3, omega_y -2.15 to 3, omega_z -2 to 3.89.
SPINS: Mapping[str, ParameterSpec] = {
    "omega_x": _parameter(-3.0, 3.0, "rad/s"),
    "omega_y": _parameter(-3.0, 3.0, "rad/s"),
    "omega_z": _parameter(-3.0, 4.0, "rad/s"),
}


def coordinate(joint: str, axis: int = 0) -> int:
    """Index in a pose of one axis of a joint (hinges have axis 0)."""
    at = 0
    for spec in JOINTS:
        if spec.name == joint:
            return at + axis
        at += len(spec.low)
    raise KeyError(joint)


@dataclass(frozen=True, slots=True)
class TakeOff:
    """A take-off state and what stands around it.

    Args:
        alpha: angle of the bar's plane, rad.
        omega_x, omega_z: spin about the forward and the right axis, rad/s.
        v_z: sideways velocity, m/s.
        forward: forward velocity, m/s.
        rise: upward velocity at the start, m/s.
        time_to_bar: the bar stands where the athlete gets in so many seconds (between 0.6 and 1.5 m away).
        formulation: `support` begins in the middle of the last support, `flight` as the foot leaves the ground.
        omega_y: spin about the vertical, rad/s.
        gap: from the root to the bar's plane or to the obstacle, m, where it does not follow from the approach.
    """

    alpha: float
    omega_x: float
    omega_z: float
    v_z: float
    forward: float
    rise: float
    time_to_bar: float
    formulation: Formulation
    omega_y: float = OMEGA_Y
    gap: float | None = None

    @property
    def approach(self) -> float:
        """Velocity towards the bar, m/s."""
        return float(self.forward * np.sin(self.alpha) - self.v_z * np.cos(self.alpha))

    @property
    def distance(self) -> float:
        """Distance of the root from the bar's plane or from the obstacle, m."""
        if self.gap is not None:
            return self.gap
        return float(np.clip(self.approach * self.time_to_bar, 0.6, 1.5))


@dataclass(frozen=True, slots=True)
class StartState:
    """What `World` is set to at the start of an episode: see `Athlete.place`, `push` and `bend`."""

    position: Array
    orientation: Array
    velocity: Array
    angular_velocity: Array
    pose: Array
    rates: Array


def start_state(world: World, state: TakeOff) -> StartState:
    """The athlete at take-off, standing on the ground or just above it. Leaves `world` in that state."""
    clip = clips.load(RUN)
    support = state.formulation == "support"
    frame = MID_SUPPORT_FRAME if support else _TOE_OFF_FRAME
    pose = clip.pose[frame].copy()
    rates = np.zeros(COORDINATES)
    lean = 0.0
    knee = next(joint for joint in world.joints if joint.name == "right_knee")
    if support:
        lean = _plant(pose, float(np.clip(_BENT, knee.low[0], knee.high[0])) if knee.held else _BENT)
        rates = clip.rates[frame] * np.hypot(state.forward, state.v_z) / np.linalg.norm(clip.velocity(frame)[[0, 2]])
    within = held_within(world.joints)
    if within is not None:
        pose = np.clip(pose, *within)
        rates = np.where(np.isfinite(within[0]), 0.0, rates)
        if np.isfinite(within[0][coordinate("left_knee")]):
            hip = coordinate("left_hip", 2)
            pose[hip] = max(pose[hip], _SWUNG)
    yaw = state.alpha - np.pi / 2
    heading = rotations.from_rotation_vector(np.array([0, yaw, 0]))
    forward, up, right = (rotations.rotate(heading, axis) for axis in np.eye(3))
    orientation = rotations.multiply(heading, rotations.from_rotation_vector(np.array([0, 0, lean])))
    spin = forward * state.omega_x + up * state.omega_y + right * state.omega_z
    velocity = forward * state.forward + up * state.rise + right * state.v_z

    athlete = world.athlete
    athlete.place([0, 1, 0], orientation)
    athlete.bend(pose, rates)
    athlete.push(np.zeros(3), np.zeros(3))
    links = athlete.links()
    low = athlete.bounds()[0][1]
    position = np.array([-state.distance, 1 - low + (0.0 if support else 0.03), 0.0])
    if not support:  # the centre of mass gets the velocity, whatever the spin does to the root
        velocity = velocity - np.cross(spin, athlete.centre_of_mass(links) - links[0, :3])
    athlete.place(position, orientation)
    athlete.push(velocity, spin)
    if support:
        rates = _rest_the_foot(world, pose, rates)
    start = StartState(position, orientation, velocity, spin, pose, rates)
    apply(world, start)
    return start


def apply(world: World, start: StartState) -> None:
    """Put the world's athlete into a start state."""
    world.athlete.place(start.position, start.orientation)
    world.athlete.bend(start.pose, start.rates)
    world.athlete.push(start.velocity, start.angular_velocity)


def _plant(pose: Array, knee: float) -> float:
    """Bend the stance leg of `pose` for the take-off, its knee so far (rad), the sole flat on the ground.

    Returns the body's lean, rad.
    """
    hip, lean = 0.75, -0.1
    for joint, angle in zip(_STANCE_LEG, (hip, knee, -(hip + knee + lean)), strict=True):
        if joint in SPHERICAL:
            at = coordinate(joint)
            pose[at : at + 3] = (0, 0, angle)
        else:
            pose[coordinate(joint)] = angle
    return lean


def natural_pose() -> Array:
    """The captured pose at mid-support ``[28]``."""
    pose: Array = clips.load(RUN).pose[MID_SUPPORT_FRAME].copy()
    return pose


def push_off_pose() -> Array:
    """The pose that action 0 pulls to ``[28]``: stance leg driving down and back, the other knee and the arms up.

    A reference for the PD controllers, not a pose to be reached: hip and knee aim beyond their ranges, which makes
    them push. Without it a random policy hardly ever leaves the ground.
    """
    pose = natural_pose()
    aims = {
        "right_hip": -1.2, "right_ankle": -0.5, "left_hip": 1.2,
        "chest": 0.1, "right_shoulder": 0.5, "left_shoulder": 0.5,
    }  # fmt: skip
    for joint, angle in aims.items():
        at = coordinate(joint)
        pose[at : at + 3] = (0, 0, angle)
    pose[coordinate("right_knee")] = 1.0
    pose[coordinate("left_knee")] = -1.2
    return pose


def _rest_the_foot(world: World, pose: Array, rates: Array) -> Array:
    """Rates ``[28]`` with those of the stance leg such that its foot is at rest while the body moves over it.

    The foot's velocity is linear in the rates, so its columns come from trying each rate alone; least squares, because
    seven rates meet six conditions, with turning of the foot weighing a fifth of sliding.
    """
    athlete = world.athlete
    held = {joint.name for joint in world.joints if joint.held}
    leg = [joint for joint in _STANCE_LEG if joint not in held]
    stance = [coordinate(joint, axis) for joint in leg for axis in range(3 if joint in SPHERICAL else 1)]
    foot = athlete.names.index(TAKE_OFF_FOOT)
    weight = np.array([1, 1, 1, 0.2, 0.2, 0.2])

    def foot_velocity(values: Array) -> Array:
        tried = rates.copy()
        tried[stance] = values
        athlete.bend(pose, tried)
        return np.asarray(athlete.links()[foot, 7:13] * weight)

    rest = foot_velocity(np.zeros(len(stance)))
    columns = np.stack([foot_velocity(row) - rest for row in np.eye(len(stance))], 1)
    ridge = 0.01 * np.eye(len(stance))
    values = np.linalg.lstsq(np.vstack([columns, ridge]), np.concatenate([-rest, np.zeros(len(stance))]), rcond=None)[0]
    resting: Array = rates.copy()
    resting[stance] = np.clip(values, -_RATE_BOUND, _RATE_BOUND)
    return resting
