"""Is a recorded jump believable? Every criterion as a number beside its bound, from the recorded poses and forces.

What a learner cannot do with its muscles it does with the simulator's weaknesses, if it has any: constraint motors leak
momentum, joints without limits fold backwards, thin walls are passed between two steps. A bar counts as cleared only in
a replay that passes this audit.

The jump is judged until the athlete first touches the mat: how soft that is, is no part of the jump.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workers.contracts import JSON
from workers.physics import rotations
from workers.physics.athlete import RATE, SPHERICAL, ranges, torque_bound
from workers.physics.rotations import Array
from workers.physics.world import GRAVITY
from workers.replay import Replay

BALLISTIC = 0.03
"""m that the centre of mass may leave its parabola by: the integrator's own error is below 0.01 m in 1 s."""
ANGLE = 0.35
"""rad that a joint may be beyond its range: the penalty is a spring, and flexible people differ by as much."""
RATE_FACTOR = 1.0
"""Largest rate of a joint over what a human reaches."""
RATE_FRAMES = 4
"""Frames (1/30 s) that a rate is measured over: human rates come from motion capture, filtered at about 15 Hz."""
TORQUE_FACTOR = 1.002
"""Largest torque over what muscles (and, beyond a joint's range, ligaments) give; float32 rounds."""
PENETRATION = 0.02
"""m that a body may sink into ground or wall."""
OVERLAP = 0.02
"""m that two bodies may overlap: about what flesh gives."""
PUSH = 6.0
"""Force of the foot over body weight, mean of 1/120 s; elite high jumpers are measured at 4 to 6."""


@dataclass(frozen=True, slots=True)
class Check:
    """One criterion.

    Args:
        name: which.
        found: the largest value of the jump.
        bound: what it may be at most; None for a figure that is told and decides nothing.
        unit: of both.
    """

    name: str
    found: float
    bound: float | None
    unit: str

    @property
    def passed(self) -> bool:
        """Whether the jump keeps to the bound; NaN does not."""
        return self.bound is None or bool(self.found <= self.bound)


@dataclass(frozen=True, slots=True)
class Audit:
    """What the audit found.

    Args:
        checks: all criteria, whether passed or not.
    """

    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)

    @property
    def failures(self) -> tuple[str, ...]:
        """Names of the checks that did not pass."""
        return tuple(check.name for check in self.checks if not check.passed)

    def to_json(self) -> dict[str, JSON]:
        """`{"passed": bool, "checks": {name: {"found", "bound", "unit", "passed"}}}`; NaN becomes null."""
        return {
            "passed": self.passed,
            "checks": {
                c.name: {
                    "found": c.found if np.isfinite(c.found) else None,
                    "bound": c.bound,
                    "unit": c.unit,
                    "passed": c.passed,
                }
                for c in self.checks
            },
        }


def audit(replay: Replay) -> Audit:
    """Judge a recorded jump."""
    touching = replay.arrays["touching"]
    on_mat = np.flatnonzero(touching[:, 2] > 0)
    # the frame of the landing itself is left out: its rates are those after the blow
    end = int(on_mat[0]) if len(on_mat) else replay.frames
    jump = {name: array[:end].astype(np.float64) for name, array in replay.arrays.items()}
    masses = np.array(replay.header["masses"])
    period = float(replay.header["frame_seconds"])
    gravity = float(replay.header.get("gravity", GRAVITY))
    # muscles and bones are the same anywhere: body weights are those on Earth
    weight = masses.sum() * GRAVITY
    joints = replay.joints()
    low, high = ranges(joints)
    beyond = np.maximum(jump["pose"] - high, low - jump["pose"])
    return Audit(
        (
            Check("ballistic_flight", flight_error(jump, masses, period, gravity), BALLISTIC, "m"),
            Check("joint_angle", _largest(beyond), ANGLE, "rad beyond range"),
            Check(
                "joint_rate", _largest(joint_rates(jump["pose"], period) / RATE), RATE_FACTOR, "of the human maximum"
            ),
            # a frame's torque is that at its start: in the pose of the frame before
            Check(
                "torque",
                _largest(np.abs(jump["torque"][1:]) / torque_bound(jump["pose"][:-1], joints)),
                TORQUE_FACTOR,
                "of the limit",
            ),
            Check("penetration", _largest(jump["penetration"]), PENETRATION, "m"),
            Check("self_intersection", _largest(jump["overlap"]), OVERLAP, "m"),
            Check("foot_push", float(_largest(jump["ground_force"]) / weight), PUSH, "body weights"),
            Check("wall_touched", _largest(touching[:, 1].astype(np.float64)), 0.0, "bodies"),
            Check("missed_landing", float(len(on_mat) == 0), 0.0, "jumps"),
        )
    )


def flight_error(jump: dict[str, Array], masses: Array, period: float, gravity: float = GRAVITY) -> float:
    """Furthest that the centre of mass gets (m) from the parabola of its last moment on the ground.

    Args:
        jump: arrays of a replay, up to the landing.
        masses: of the bodies ``[13]``, kg.
        period: seconds of a frame.
        gravity: m/s^2.

    The centre of mass is computed from the bodies' positions, so that a pose that was tampered with shows. The parabola
    is the one that fits the flight best (least squares in its starting point and velocity, gravity given).
    """
    grounded = np.flatnonzero(jump["touching"][:, 0] > 0)
    start = int(grounded[-1]) + 1 if len(grounded) else 0
    com = np.einsum("b,fbi->fi", masses / masses.sum(), jump["position"][start:])
    if len(com) < 3:
        return 0.0
    t = np.arange(len(com)) * period
    level = com + np.outer(t * t, [0.0, gravity / 2, 0.0])  # without gravity: a straight line
    basis = np.stack([np.ones_like(t), t], 1)
    straight = basis @ np.linalg.lstsq(basis, level, rcond=None)[0]
    return float(np.linalg.norm(level - straight, axis=1).max())


def joint_rates(pose: Array, period: float) -> Array:
    """Mean magnitudes of the joints' rates over `RATE_FRAMES` ``[frame - RATE_FRAMES, 28]``, rad/s.

    From the recorded poses ``[frame, 28]`` rather than the recorded rates, which a blow changes for one frame.
    """
    if len(pose) <= RATE_FRAMES:
        return np.zeros((0, pose.shape[1]))
    turned = 3 * len(SPHERICAL)
    quaternions = rotations.from_rotation_vector(pose[:, :turned].reshape(len(pose), -1, 3))
    turns = rotations.multiply(rotations.conjugate(quaternions[:-RATE_FRAMES]), quaternions[RATE_FRAMES:])
    angles = rotations.to_rotation_vector(turns).reshape(len(turns), -1)
    hinges = pose[RATE_FRAMES:, turned:] - pose[:-RATE_FRAMES, turned:]
    rates: Array = np.abs(np.concatenate([angles, hinges], 1)) / (RATE_FRAMES * period)
    return rates


def _largest(values: NDArray[np.float64]) -> float:
    """Largest value, NaN where there is any, 0 where there is none."""
    return float(np.max(values)) if values.size else 0.0
