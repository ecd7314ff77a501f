"""The high jump as a `gymnasium.Env`: the policy aims the athlete's joints ten times a second."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from workers.novelty import Novelty
from workers.physics.athlete import COORDINATES, JOINTS, Joint, poses_of
from workers.physics.limits import Limits, Strain
from workers.physics.world import FRAME, GRAVITY, Contacts, World
from workers.poses.model import PoseModel
from workers.replay import Recorder
from workers.tasks.high_jump import rules, takeoff
from workers.tasks.high_jump.behaviour import Passing, behaviour_of
from workers.tasks.high_jump.run_up import RunUp, end_of
from workers.tasks.high_jump.takeoff import TakeOff

_ACTIVATION: NDArray[np.float64] = np.array([[1 / 3], [2 / 3], [1.0]])
"""Share of a new target in the first frames (25 ms), in which it takes over from the old one. Muscles take as long to
become active, and torques that jump let the foot strike the ground with more than 6 body weights."""


_LATENT_SCALE = 3.0
"""Of an action of 1: latent vectors of captured poses have standard deviations of 2.7 to 3.8, since beta is small."""
_OFFSET_SCALE = 0.5
"""rad of an action of 1: what is wanted of a pose is to be said by the latent vector first."""


class HighJumpEnv(gymnasium.Env[NDArray[np.float64], NDArray[np.float32]]):
    """One athlete before one bar.

    Observation ``[173]``: position of the root (m), the level (height of the bar, or width of the obstacle, m), then
    for each of the 13 bodies its position relative to the root (m), orientation (quaternion), velocity (m/s) and
    angular velocity (rad/s), all in the world frame, whose plane x = 0 goes through the bar or the box's middle.

    Action ``[28]``, unbounded: offset of the target pose from the push-off pose, rad. The target moves there in 25 ms.

    With a pose model of L latent dimensions the action is ``[L + 28]``, latent vector and offset, and the target the
    decoded pose plus the offset (Yin et al. 2021, section 5.1). While the foot bears on the ground, both count from
    what the push-off pose is made of, a natural pose and an offset, so that action 0 pushes; in the air from the
    natural pose alone. Naturalness sees the whole offset.

    Args:
        state: the take-off state.
        control_rate: actions a second; a divisor of 120.
        hard_rate: the same at the hardest levels, likewise; None: always `control_rate`.
        hardness: of a level, which schedules the control rate and how natural a jump has to be.
        offsets: mean offset at which a jump is not natural at all, at the easiest and at the hardest levels, rad.
        obstacle: height of a box to be jumped over by its width, which is then the level, m; None for a bar.
        mat_height: m.
        recorder: keeps the frames of each episode, from the last `reset` on.
        poses: a pose model to act through.
        gravity: m/s^2.
        landing: on which part the athlete may land, `any` or `feet`.
        joints: of the athlete.
        limits: of the body; a jump that goes beyond them fails, and earns little. None: it can do anything. A training
            should learn nothing that the audit refuses.
        run_up: what leads to the jump; without one it begins in the take-off state itself.
        rehearse: begin where the run-up ends instead of running up each time, which takes as long as the jump. To the
            last bits of the contacts it is the same.
        novelty: what the jump is to be unlike. Its reward is then multiplied by how new it is, and only one that would
            count as another strategy succeeds, so that the bar rises with new jumps alone.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - gymnasium declares it so

    def __init__(
        self,
        state: TakeOff,
        *,
        control_rate: int = 10,
        hard_rate: int | None = None,
        hardness: rules.Hardness = rules.hardness_of_bar,
        offsets: tuple[float, float] = rules.OFFSETS,
        obstacle: Callable[[float], float] | None = None,
        mat_height: float = 0.3,
        recorder: Recorder | None = None,
        poses: PoseModel | None = None,
        gravity: float = GRAVITY,
        landing: rules.Landing = "any",
        joints: Sequence[Joint] = JOINTS,
        limits: Limits | None = None,
        run_up: RunUp | None = None,
        rehearse: bool = False,
        novelty: Novelty | None = None,
    ) -> None:
        self.state = state
        self.recorder = recorder
        self.world = World(mat_height, measure_torque=recorder is not None, gravity=gravity, joints=joints)
        self._limits = limits
        self._run_up = run_up
        self._end = None if run_up is None or not rehearse else end_of(run_up, self.world)
        self._unused = self._end is None
        self._weight = float(self.world.athlete.mass.sum()) * GRAVITY
        self._novelty = novelty
        self._rates = (control_rate, control_rate if hard_rate is None else hard_rate)
        self._hardness = hardness
        self._offsets = offsets
        self._obstacle = obstacle
        self._reference = takeoff.push_off_pose()
        self._start = takeoff.start_state(self.world, state)
        athlete = self.world.athlete
        feet = frozenset({athlete.link["left_ankle"], athlete.link["right_ankle"]}) if landing == "feet" else None
        self._rules = rules.Rules(foot=athlete.link[takeoff.TAKE_OFF_FOOT], head=athlete.link["neck"], may_land_on=feet)
        size = 4 + 13 * len(athlete.names)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)
        self._poses = poses
        latent = 0
        if poses is not None:
            latent = poses.latent
            self._latent = poses.encode(takeoff.natural_pose()[None])[0]
            self._natural_offset = self._reference - poses.decode(self._latent[None])[0]
        self.action_space = gymnasium.spaces.Box(-np.inf, np.inf, (latent + COORDINATES,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Back to the take-off state, before a bar as high or a box as wide as `options["level"]` m (0.5 without).

        Nothing is drawn at random, so the seed changes nothing. `options["fresh"]` rebuilds the world.
        """
        super().reset(seed=seed)
        options = options or {}
        if options.get("fresh") and not self._unused:
            self.world.rebuild()
        self._unused = False
        level = options.get("level")
        self._level = 0.5 if level is None else float(level)
        self._frames = round(1 / (rules.rate_at(self._level, *self._rates, self._hardness) * FRAME))
        start = self._start
        if self._obstacle is None:
            self.world.set_bar(self._level)
        else:
            self.world.set_obstacle(self._obstacle(self._level), self._level)
            start = replace(start, position=start.position - np.array([self._level / 2, 0, 0]))
            self._rules = replace(self._rules, edge=self._level / 2)
        self._elapsed = 0
        self._spin = 0.0
        self._offset = 0.0
        self._actions = 0
        self._passing = Passing()
        self._push = 0.0
        self._seen: list[Sequence[Any]] = []
        self._landing = False
        shift = float(start.position[0] - self._start.position[0])
        if self._run_up is None:
            takeoff.apply(self.world, start)
            self.world.settle()
            if self.state.formulation == "support":
                self.world.stand()
            self._target = self._start.pose
            self._record_start()
        elif self._end is not None:
            self._end.apply(self.world, shift)
            self._push, self._seen = self._end.push, list(self._end.seen)
            self._target = self._run_up.targets[-1]
            self._record_start()
        else:
            self._run_up.begin(self.world, shift)
            self._record_start()
            self._run_up.play(self.world, self._see)
            self._target = self._run_up.targets[-1]
        return self._observation(), {}

    def _record_start(self) -> None:
        if self.recorder is not None:
            self.recorder.start(self.world)
            self.recorder.add(self.world, Contacts())

    def _see(self, contacts: Contacts) -> None:
        """Note what a frame, just simulated, asked of the body."""
        self._push = max(self._push, contacts.ground_force)
        if self._limits is not None and not self._landing:
            # as the audit: the frames before the mat is first touched
            self._seen.append(self.world.athlete.seen)
            self._landing = bool(contacts.mat)
        if self.recorder is not None:
            self.recorder.add(self.world, contacts)

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        """Pull towards the push-off pose plus `action` for one control interval, or until the jump is decided."""
        target, offset = self._aim(np.asarray(action, np.float64))
        before, self._target = self._target, target
        self._offset += float(np.abs(offset).sum())
        self._actions += 1
        verdict = None
        commands = self.world.athlete.commands(before + (target - before) * _ACTIVATION)
        for frame in range(self._frames):
            if frame < len(commands):
                self.world.athlete.follow(commands[frame])
            contacts = self.world.advance()
            self._elapsed += 1
            self._spin += self.world.athlete.spin()
            self._see(contacts)
            if self._novelty is not None and self._passing.orientation is None:
                links = self.world.athlete.links()
                self._passing.look(float(self.world.athlete.centre_of_mass(links)[0]), links[0, 3:7])
            verdict = self._rules.verdict(contacts, self._elapsed * FRAME, self._rear() if contacts.mat else None)
            if verdict is not None:
                break
        observation = self._observation()
        if verdict is None:
            # a world that has blown up gives NaN: end the episode, the learner says so
            return observation, 0.0, not bool(np.isfinite(observation).all()), False, {}
        landed = verdict == "landed"
        reward = rules.reward(
            landed=landed,
            head_first=self._rules.head in contacts.mat,
            spin=self._spin / self._elapsed,
            offset=self._offset / self._actions,
            bar=self._level,
            hardness=self._hardness,
            bounds=self._offsets,
        )
        metrics = {f"end_{name}": float(verdict == name) for name in ("wall", "ground", "time", "fall")}
        success = landed
        strain = self._strain()
        metrics |= {
            "hard_push": float(strain.push > 1),
            "fast_joint": float(strain.rate > 1),
            "bent_joint": float(strain.angle > 1),
        }
        if not strain.worst <= 1:
            reward, success = reward * rules.BEYOND, False
        if landed and self._novelty is not None and self._passing.orientation is not None:
            found = behaviour_of(self._passing.orientation, self._novelty.spec)
            metrics["novelty"] = self._novelty.factor(found)
            reward *= metrics["novelty"]
            success = success and self._novelty.is_new(found)
        return observation, reward, True, False, {"success": success, "verdict": verdict, "metrics": metrics}

    def _strain(self) -> Strain:
        """What this jump asked of the body, over what it may."""
        if self._limits is None:
            return Strain(0.0, 0.0, 0.0)
        return self._limits.strain(self._push / self._weight, poses_of(self._seen), FRAME, self.world.joints)

    def _rear(self) -> float:
        """Lowest x of what must have got over, m: see `Rules.verdict`."""
        athlete = self.world.athlete
        if self._obstacle is None:
            return athlete.rear()
        return float(athlete.centre_of_mass(athlete.links())[0])

    def _aim(self, action: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The target pose of an action, and its offset from what counts as natural, ``[28]`` each."""
        if self._poses is None:
            return self._reference + action, action
        latent = self._latent + _LATENT_SCALE * action[: self._poses.latent]
        offset = _OFFSET_SCALE * action[self._poses.latent :]
        if self.world.loaded:
            offset = self._natural_offset + offset
        return self._poses.decode(latent[None])[0] + offset, offset

    @property
    def elapsed(self) -> float:
        """Simulated seconds since the last reset."""
        return self._elapsed * FRAME

    def _observation(self) -> NDArray[np.float64]:
        links = self.world.athlete.links()
        root = links[0, :3].copy()
        links[:, :3] -= root
        return np.concatenate([root, [self._level], links.ravel()])

    def close(self) -> None:
        """Free the world."""
        self.world.close()
