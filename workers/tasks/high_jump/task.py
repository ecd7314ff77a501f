"""Jumps as tasks: train from a take-off state, then find the highest bar, or the widest obstacle, that is cleared.

The level of a jump is the height of its bar, or the width of its obstacle, m.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar

import gymnasium
import numpy as np

from workers.audit import Audit, audit
from workers.contracts import JSON, BadJob, Context, Job, Outcome, TaskInfo
from workers.learning.policy import Policy, note_of, with_note
from workers.learning.ppo import POLICY_ARTIFACT, train
from workers.learning.problem import Curriculum, Diverged, Trained
from workers.learning.rollout import play
from workers.learning.settings import TrainingSettings
from workers.novelty import Novelty
from workers.physics.limits import HUMAN, Limits
from workers.physics.rendering import render_frame
from workers.replay import Recorder, Replay
from workers.tasks.high_jump import behaviour, takeoff
from workers.tasks.high_jump.approach import captured_run
from workers.tasks.high_jump.env import HighJumpEnv
from workers.tasks.high_jump.jump_settings import JumpSettings
from workers.tasks.high_jump.naming import name_jump
from workers.tasks.high_jump.run_up import RunUp, arrival, run_up_to
from workers.tasks.high_jump.settings import TRAINING, HighJumpSettings, ObstacleJumpSettings

REPLAY_ARTIFACT = "replay.bin"
POSE_ARTIFACT = "pose.png"
_MARGIN = 0.97
"""Of what the audit lets a body do: a training keeps that much away from it."""
_BACK = 0.1
"""m below the bar that a policy clears: with noise, where it goes on learning, it clears no more."""
_REACH = 0.4
"""m above the curriculum's level that the policy is tried at: without exploration noise it jumps higher."""


@dataclass(frozen=True, slots=True)
class JumpProblem:
    """What the learner gets.

    Args:
        settings: of the task.
        state: the take-off state.
        novelty: what the jump that is learnt is to be unlike, or None.
        cleared: the level that the policy it starts from clears, m; None from scratch.
    """

    settings: JumpSettings
    state: takeoff.TakeOff
    novelty: Novelty | None = None
    cleared: float | None = None

    def make_env(self) -> gymnasium.Env[Any, Any]:
        """A new environment to train in."""
        return self.env(None, limits=HUMAN.times(_MARGIN), novelty=self.novelty, rehearse=True)

    def env(
        self,
        recorder: Recorder | None,
        *,
        limits: Limits | None = None,
        novelty: Novelty | None = None,
        rehearse: bool = False,
    ) -> HighJumpEnv:
        """A new environment that tells a recorder."""
        s = self.settings
        return HighJumpEnv(
            self.state,
            control_rate=s.control_rate,
            hard_rate=s.control_rate_hard,
            hardness=s.hardness,
            offsets=(s.offset_easy, s.offset_hard),
            obstacle=s.obstacle,
            mat_height=s.mat_height,
            recorder=recorder,
            poses=s.pose_model(),
            gravity=s.gravity,
            landing=s.landing,
            joints=s.joints(),
            limits=limits,
            run_up=self.run_up(),
            rehearse=rehearse,
            novelty=novelty,
        )

    def run_up(self) -> RunUp | None:
        """What leads to the take-off state, or None where the jump begins in it."""
        s = self.settings
        return run_up_to(self.state, s.joints(), s.gravity, s.run_up_clip) if s.run_up else None

    def curriculum(self) -> Curriculum:
        """The levels, from the first to the one that ends the training.

        A training that goes on with a policy begins a little below what that clears, one for something new at the
        first level: a new jump is learnt like the first.
        """
        levels, curriculum = self.settings.levels, self.settings.new_curriculum()
        if self.cleared is not None and self.novelty is None:
            # in steps, which a checkpoint keeps: a training that is resumed may have no parent any more
            curriculum.steps = max(0, int((self.cleared - _BACK - levels.first) / levels.step + 1e-9))
        return curriculum

    def levels_from(self, level: float) -> list[float]:
        """Levels to try (m), highest first: from above the curriculum's down to the lowest, in its steps."""
        levels = self.settings.levels
        top = min(level + _REACH, levels.highest)
        count = int(np.floor((top - levels.lowest) / levels.step + 1e-9))
        return [round(levels.lowest + i * levels.step, 9) for i in range(count, -1, -1)]


@dataclass(frozen=True, slots=True)
class Jump:
    """A deterministic jump that landed.

    Args:
        level: what it cleared, m.
        replay: the recording.
        audit: what the audit says of it.
        reward: what it earned.
    """

    level: float
    replay: Replay
    audit: Audit
    reward: float


class HighJump:
    """The task `high_jump`.

    Its value is the highest bar (m) that the deterministic policy clears in a replay that passes the audit.
    """

    name: ClassVar[str] = "high_jump"
    summary: ClassVar[str] = "A full athlete learns to jump over a bar from a given take-off state"
    Settings: ClassVar[type[JumpSettings]] = HighJumpSettings
    level: ClassVar[str] = "bar"
    """What the level is called among the details."""

    def info(self, settings: Mapping[str, JSON]) -> TaskInfo:
        """The task under these settings. Raises `BadSetting`."""
        parsed = self.Settings.parse(settings)
        return TaskInfo(
            name=self.name,
            summary=self.summary,
            parameters=self.Settings.parameters,
            features=behaviour.FEATURES[parsed.feature],
            seeks_novelty=True,
            settings=parsed.to_json(),
            training=TRAINING.to_json(),
        )

    def validate(self, settings: Mapping[str, JSON], training: Mapping[str, JSON], names: Sequence[str]) -> None:
        """Refuse wrong settings, training settings and unknown parameters (`BadSetting`)."""
        self.Settings.parse(settings)
        TrainingSettings.parse(training, TRAINING)
        self.Settings.check_parameters(names)

    def problem_of(self, job: Job) -> JumpProblem:
        """What a job trains, checked. Raises `BadSetting`."""
        settings = self.Settings.parse(job.task_settings)
        settings.check_parameters(job.params)
        novelty = Novelty.of(job, behaviour.FEATURES[settings.feature])
        return JumpProblem(settings, settings.take_off(job.params), novelty)

    def run(self, job: Job, context: Context) -> Outcome:
        """Train, then look for the highest bar. Artifacts: the policy; of a cleared bar its replay and a picture."""
        problem = replace(self.problem_of(job), cleared=_cleared_by_parent(job, context))
        try:
            trained = train(job, context, problem, TrainingSettings.parse(job.training, TRAINING))
        except Diverged as error:
            details = {"iteration": error.iteration, "quantity": error.quantity}
            return Outcome("diverged", cost=error.cost, message=str(error), details=details)
        context.log(f"trained to {trained.level:.2f} m; looking for the highest {self.level} it clears believably")
        best, refused = highest_jump(problem, trained)
        if best is None:
            context.save_artifact(POLICY_ARTIFACT, trained.policy.to_bytes())
            return _infeasible(problem, trained, refused, self.level)
        context.save_artifact(POLICY_ARTIFACT, with_bar(trained.policy.to_bytes(), best.level))
        context.save_artifact(REPLAY_ARTIFACT, best.replay.to_bytes())
        passing = behaviour.over_the_bar(best.replay)
        if passing is None:  # the rules let nobody land who has not passed the bar
            raise BadJob(f"jump over {best.level:g} m: expected its centre of mass to pass the bar's plane, found none")
        time, orientation = passing
        context.save_artifact(POSE_ARTIFACT, render_frame(best.replay, time))
        facing = behaviour.facing(orientation)
        found = behaviour.behaviour_of(orientation, behaviour.FEATURES[problem.settings.feature])
        return Outcome(
            "complete",
            value=best.level,
            features=found,
            cost=trained.cost,
            details={
                **name_jump(best.replay).to_json(),
                self.level: best.level,
                "cleared": True,
                "facing": facing,
                "rotation": [float(v) for v in orientation],
                "reward": best.reward,
                "audit": best.audit.to_json(),
                **_common(problem, trained),
            },
        )

    def simulate(self, job: Job, policy: bytes) -> Replay:
        """The best jump of a stored policy, simulated again, bit for bit the same.

        Args:
            job: of the trial that learnt the policy.
            policy: its artifact `policy.safetensors`.

        Raises `BadJob` where the policy is of another task or never cleared a bar.
        """
        bar = bar_of(policy)
        jump = recorded_jump(self.problem_of(job), Policy.from_bytes(policy), bar)
        if jump is None:
            raise BadJob(
                f"policy: expected one that clears {bar:g} m as trial {job.trial} did, found one that doesn't; "
                "was it simulated by another version of halma or on another kind of machine?"
            )
        return jump.replay

    def audit(self, job: Job, policy: bytes, rollouts: int) -> Audit:
        """See `auditing.audit_policy`."""
        from workers.tasks.high_jump.auditing import audit_policy  # noqa: PLC0415 - it needs this module

        return audit_policy(self.problem_of(job), job, policy, rollouts)


class ObstacleJump(HighJump):
    """The task `obstacle_jump`: a straight run at a box, or with a height of 0 a long jump.

    Its value is the widest obstacle (m) that the deterministic policy clears in a replay that passes the audit.
    """

    name = "obstacle_jump"
    summary = "A full athlete learns to jump over a box from a straight run; without the box a long jump"
    Settings = ObstacleJumpSettings
    level = "width"


def simulate(job: Job, policy: bytes) -> Replay:
    """See `HighJump.simulate`."""
    return HighJump().simulate(job, policy)


def highest_jump(problem: JumpProblem, trained: Trained) -> tuple[Jump | None, Jump | None]:
    """The highest believable jump of the deterministic policy, or None; beside it the highest one the audit refused."""
    start = problem.settings.levels.first if trained.level is None else trained.level
    refused: Jump | None = None
    scout = problem.env(None)
    try:
        for level in problem.levels_from(start):
            # without a recorder first: recording triples the time, and most bars above the level are missed
            if not play(scout, trained.policy, seed=0, level=level).success:
                continue
            jump = recorded_jump(problem, trained.policy, level)
            if jump is not None and jump.audit.passed:
                return jump, refused
            refused = refused or jump
    finally:
        scout.close()
    return None, refused


def recorded_jump(problem: JumpProblem, policy: Policy, level: float) -> Jump | None:
    """One deterministic jump in a new world, recorded and audited; None where it fails."""
    recorder = Recorder(
        takeoff.TAKE_OFF_FOOT, {"name": problem.settings.task, "formulation": problem.settings.formulation}
    )
    env = problem.env(recorder)
    try:
        episode = play(env, policy, seed=0, level=level)
    finally:
        env.close()
    if not episode.success:
        return None
    replay = recorder.replay()
    return Jump(level, replay, audit(replay), episode.total)


def problem_of(job: Job) -> JumpProblem:
    """See `HighJump.problem_of`."""
    return HighJump().problem_of(job)


def _cleared_by_parent(job: Job, context: Context) -> float | None:
    """The bar that the policy a job starts from clears, m; None where there is none, or it cleared none."""
    if job.parent is None:
        return None
    try:
        return bar_of(context.parent_artifact(POLICY_ARTIFACT))
    except BadJob:
        return None  # a resumed training needs its parent no more, and a new one is told by the learner what is wrong


def _common(problem: JumpProblem, trained: Trained) -> dict[str, JSON]:
    """Details of every outcome of a finished training."""
    return {
        "level": trained.level,
        "iterations": trained.iterations,
        "approach": problem.state.approach,
        "distance": problem.state.distance,
        "policy_sha256": trained.policy.sha256(),
        **problem.settings.poses_used(),
        **_arrival(problem),
        **trained.lineage,
    }


def _arrival(problem: JumpProblem) -> dict[str, JSON]:
    """As details of an outcome: how far from the take-off state the run-up ends, and which clip it follows."""
    run_up, settings = problem.run_up(), problem.settings
    if run_up is None:
        return {}
    missed = arrival(run_up, problem.state, settings.joints(), settings.gravity)
    followed = captured_run(settings.run_up_clip).sha256
    clip = {} if followed is None else {"clip_sha256": followed}
    return {"run_up": {"seconds": run_up.seconds, **asdict(missed), **clip}}


def _infeasible(problem: JumpProblem, trained: Trained, refused: Jump | None, name: str) -> Outcome:
    """No level was cleared, or none believably."""
    details = {name: None, "cleared": False, "facing": None, "rotation": None, **_common(problem, trained)}
    message = f"the policy clears no {name} of {problem.settings.levels.lowest:g} m or more"
    if refused is not None:
        details |= {"audit": refused.audit.to_json()}
        message = f"the audit refused every jump; the highest, over {refused.level:g} m, for: " + ", ".join(
            refused.audit.failures
        )
    return Outcome("infeasible", cost=trained.cost, message=message, details=details)


_BAR = "high_jump.bar"


def with_bar(policy: bytes, bar: float) -> bytes:
    """A stored policy that knows the bar (m) of its best jump; the learner reads it like any other."""
    return with_note(policy, _BAR, bar)


def bar_of(policy: bytes) -> float:
    """The bar that `with_bar` noted. Raises `BadJob` where there is none."""
    bar = note_of(policy, _BAR)
    if bar is None:
        raise BadJob(
            "policy: expected one of a trial that cleared a bar, found one without; it has no jump to simulate"
        )
    return bar
