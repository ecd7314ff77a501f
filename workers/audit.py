"""Is a recorded jump believable? Every criterion as a number beside its bound, from the recorded poses and forces.

What a learner cannot do with its muscles it does with the simulator's weaknesses, if it has any: constraint motors leak
momentum, joints without limits fold backwards, thin walls are passed between two steps. A bar counts as cleared only in
a replay that passes this audit.

The jump is judged until the athlete first touches the mat: how soft that is, is no part of the jump.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workers.contracts import JSON
from workers.physics.athlete import RATE, torque_bound
from workers.physics.limits import HUMAN, beyond_range, joint_rates, largest
from workers.physics.rotations import Array
from workers.physics.world import GRAVITY
from workers.replay import Replay

BALLISTIC = 0.03
"""m that the centre of mass may leave its parabola by: the integrator's own error is below 0.01 m in 1 s."""
TORQUE_FACTOR = 1.002
"""Largest torque over what muscles (and, beyond a joint's range, ligaments) give; float32 rounds."""
PENETRATION = 0.02
"""m that a body may sink into ground or wall."""
OVERLAP = 0.02
"""m that two bodies may overlap: about what flesh gives."""


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
    return Audit(
        (
            Check("ballistic_flight", flight_error(jump, masses, period, gravity), BALLISTIC, "m"),
            Check("joint_angle", largest(beyond_range(jump["pose"], joints)), HUMAN.angle, "rad beyond range"),
            Check("joint_rate", largest(joint_rates(jump["pose"], period) / RATE), HUMAN.rate, "of the human maximum"),
            # a frame's torque is that at its start: in the pose of the frame before
            Check(
                "torque",
                largest(np.abs(jump["torque"][1:]) / torque_bound(jump["pose"][:-1], joints)),
                TORQUE_FACTOR,
                "of the limit",
            ),
            Check("penetration", largest(jump["penetration"]), PENETRATION, "m"),
            Check("self_intersection", largest(jump["overlap"]), OVERLAP, "m"),
            Check("foot_push", float(largest(jump["ground_force"]) / weight), HUMAN.push, "body weights"),
            Check("wall_touched", largest(touching[:, 1].astype(np.float64)), 0.0, "bodies"),
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
