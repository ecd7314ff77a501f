"""Imitation as a `gymnasium.Env`: the policy corrects the poses of a reference thirty times a second."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from workers.physics import rotations
from workers.physics.athlete import COORDINATES, SPHERICAL
from workers.physics.rotations import Array
from workers.physics.world import FRAME, Contacts, World
from workers.replay import Recorder
from workers.tasks.imitation.reference import ENDS, Moment, Reference

FRAMES = 4
"""Frames (1/120 s) of a control step."""
CONTROL = FRAMES * FRAME
"""Seconds of a control step."""
SCALE = 0.25
"""rad that an action of 1 moves a target by."""
LOADED_STEPS = 2
_TURNED = 3 * len(SPHERICAL)


@dataclass(frozen=True, slots=True)
class Bounds:
    """How far an athlete who follows may be from the reference (spacetime bounds, Ma et al. 2021).

    Args:
        away: m between the centres of mass.
        turned: rad between the orientations of the roots.
    """

    away: float = 1.0
    turned: float = math.pi


class ImitationEnv(gymnasium.Env[NDArray[np.float64], NDArray[np.float32]]):
    """One athlete who follows a reference.

    Observation ``[175]``: height of the root (m), the phase as a point on a circle, the root's distance to the
    reference's (m), then for each of the 13 bodies its position relative to the root (m), orientation (quaternion),
    velocity (m/s) and angular velocity (rad/s), all in the world frame, in which the reference always faces the same
    way at the same phase.

    Action ``[28]``, unbounded: what the target pose differs by from the reference's next one, 0.25 rad for 1. Targets
    are those of stable PD control at the athlete's gains.

    Reward: Peng et al. 2018, equations 5 to 9: 0.65 pose + 0.1 velocity + 0.15 end effectors + 0.1 centre of mass, each
    of them in (0, 1]. An episode begins at a random time of the reference (reference state initialisation), ends where
    the trunk touches the ground or the athlete is out of bounds (early termination), and is truncated after
    `options["level"]` steps.

    Args:
        reference: what to follow.
        lead: seconds that the poses which actions correct are ahead of it.
        bounds: how far from it the athlete may be.
        recorder: keeps a frame for each control step of each episode, from the last `reset` on.
        random_start: whether episodes begin at a random time, or all at the beginning.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - gymnasium declares it so
    action_space = gymnasium.spaces.Box(-np.inf, np.inf, (COORDINATES,), np.float32)

    def __init__(
        self,
        reference: Reference,
        *,
        lead: float = 0.0,
        bounds: Bounds = Bounds(),
        recorder: Recorder | None = None,
        random_start: bool = True,
    ) -> None:
        self.reference, self.lead, self.bounds = reference, lead, bounds
        self.recorder, self.random_start = recorder, random_start
        self.world = World(furnished=False, loaded_steps=LOADED_STEPS, measure_torque=recorder is not None)
        athlete = self.world.athlete
        self._unused = True
        self._ends = [athlete.names.index(name) for name in ENDS]
        self._trunk = {athlete.names.index(name) - 1 for name in reference.upright}
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (6 + 13 * len(athlete.names),), np.float64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Into the reference's state at some time; `options["level"]` is the episode's length in steps (30 without)."""
        super().reset(seed=seed)
        options = options or {}
        if options.get("fresh") and not self._unused:
            self.world.rebuild()
        self._unused = False
        level = options.get("level")
        self._steps = 30 if level is None else max(1, round(float(level)))
        self._time = self.np_random.uniform(0.0, self.reference.seconds) if self.random_start else 0.0
        self._elapsed = 0
        moment = self.reference.at(self._time)
        athlete = self.world.athlete
        athlete.bend(moment.pose, moment.rates)
        athlete.place(moment.root, moment.orientation)
        # clips sink into the ground here and there by centimetres, which contact would answer with a blow
        sunk = self.world.sunk()
        if sunk > 0:
            athlete.place(moment.root + np.array([0.0, sunk, 0.0]), moment.orientation)
        athlete.push(moment.velocity, moment.spin)
        athlete.command(moment.pose)
        self.world.settle()
        if self.recorder is not None:
            self.recorder.start(self.world)
            self.recorder.add(self.world, Contacts())
        return self._observation(self.world.athlete.links(), moment), {}

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        """Pull towards the corrected reference for one control step."""
        self._time += CONTROL
        self._elapsed += 1
        moment = self.reference.at(self._time)
        aim = self.reference.at(self._time + self.lead).pose
        self.world.athlete.command(aim + SCALE * np.asarray(action, np.float64))
        fallen = False
        contacts = Contacts()
        for _ in range(FRAMES):
            contacts = self.world.advance()
            fallen = fallen or not self._trunk.isdisjoint(contacts.ground)
        if self.recorder is not None:
            self.recorder.add(self.world, contacts)
        links = self.world.athlete.links()
        reward, parts, away, turned = self._reward(links, moment)
        failed = fallen or away > self.bounds.away or turned > self.bounds.turned
        over = self._elapsed >= self._steps
        info: dict[str, Any] = {}
        if failed or over:
            info = {"success": not failed, "length": self._steps, "metrics": parts}
        return self._observation(links, moment), reward, failed, over and not failed, info

    def _reward(self, links: Array, moment: Moment) -> tuple[float, dict[str, float], float, float]:
        """The reward, its four parts by name, how far centre of mass (m) and root (rad) are from the reference's."""
        athlete = self.world.athlete
        pose, rates = athlete.pose()
        turns = rotations.from_rotation_vector(pose[:_TURNED].reshape(-1, 3))
        # each quaternion's dot product with its reference is the cosine of half the angle between them
        here = np.concatenate([turns, links[:1, 3:7]])
        there = np.concatenate([moment.turns, moment.orientation[None]])
        halves = np.arccos(np.minimum(np.abs(np.einsum("ij,ij->i", here, there)), 1.0))
        angles = pose[_TURNED:] - moment.pose[_TURNED:]
        slower = rates - moment.rates
        ends = links[self._ends, :3] - links[0, :3] - moment.ends
        away = athlete.centre_of_mass(links) - moment.com
        parts = {
            "pose": math.exp(-2.0 * float(4 * halves @ halves + angles @ angles)),  # equation 6
            "velocity": math.exp(-0.1 * float(slower @ slower)),  # equation 7
            "ends": math.exp(-40.0 * float((ends * ends).sum())),  # equation 8
            "centre": math.exp(-10.0 * float(away @ away)),  # equation 9
        }
        reward = 0.65 * parts["pose"] + 0.1 * parts["velocity"] + 0.15 * parts["ends"] + 0.1 * parts["centre"]
        return reward, parts, float(np.linalg.norm(away)), 2 * float(halves[-1])

    def _observation(self, links: Array, moment: Moment) -> NDArray[np.float64]:
        seen = links.copy()
        root = seen[0, :3].copy()
        seen[:, :3] -= root
        return np.concatenate([[root[1], *self.reference.phase(self._time)], moment.root - root, seen.ravel()])

    def close(self) -> None:
        """Free the world."""
        self.world.close()
