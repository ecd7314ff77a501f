"""The walker as a `Task`: build a body, learn to walk with ever less help, then walk for 500 steps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import gymnasium
import numpy as np

from workers.contracts import JSON, BadJob, Context, Job, Outcome, TaskInfo
from workers.learning.policy import Policy, note_of, with_note
from workers.learning.ppo import POLICY_ARTIFACT, train
from workers.learning.problem import Curriculum, Diverged, SuccessCurriculum, Trained
from workers.learning.rollout import Episode, NotFinite, in_words, play
from workers.learning.settings import Budget, TrainingSettings
from workers.replay import Replay
from workers.tasks.high_jump.task import REPLAY_ARTIFACT
from workers.tasks.walker.body import PARAMETERS, Figure, figure
from workers.tasks.walker.env import WalkerEnv
from workers.tasks.walker.recording import WalkRecorder
from workers.tasks.walker.settings import TRAINING, WalkerSettings, check_parameters

LEVEL = "walker.level"
"""Note in a stored policy: how far the help was withdrawn when it was learnt. A child goes on from there."""


@dataclass(slots=True)
class Withdrawal(SuccessCurriculum):
    """Withdraws the help up to the trial's difficulty: as fast as the walker stays up, and at the latest by a deadline.

    Args:
        deadline: iterations after which all is withdrawn.
    """

    PATIENCE: ClassVar[float] = math.inf  # help that has been withdrawn stays withdrawn: who falls has earned something
    deadline: int = 1
    iterations: int = field(default=0, init=False)

    @property
    def level(self) -> float:
        """The higher of what success and deadline ask for."""
        earned = self.start + self.steps * self.step
        top = 1.0 if self.freeze is None else self.freeze
        due = self.start + (top - self.start) * min(1.0, self.iterations / self.deadline)
        return round(min(max(earned, due), top), 9)

    def update(self, returns: Sequence[float], successes: Sequence[bool]) -> None:
        """Raise the level."""
        SuccessCurriculum.update(self, returns, successes)
        self.iterations += 1

    def finished(self) -> bool:
        """Never: at its last level the walker still becomes faster."""
        return False

    def state(self) -> dict[str, JSON]:
        """With the start: a child's is its parent's level, and the parent may be gone when the child goes on."""
        return {**SuccessCurriculum.state(self), "start": self.start, "iterations": self.iterations}

    def load(self, state: Mapping[str, JSON]) -> None:
        """Continue from `state`."""
        SuccessCurriculum.load(self, state)
        self.start, self.iterations = float(state["start"]), int(state["iterations"])


@dataclass(frozen=True, slots=True)
class WalkerProblem:
    """What the learner gets.

    Args:
        settings: of the task.
        figure: the walker's measures.
        z: how far the help is withdrawn in the end, in [0, 1].
        start: how far at the beginning.
        deadline: iterations after which it is withdrawn as far as z.
    """

    settings: WalkerSettings
    figure: Figure
    z: float
    start: float = 0.0
    deadline: int = 1

    def make_env(self) -> gymnasium.Env[Any, Any]:
        """A new environment."""
        return WalkerEnv(self.figure, steps=self.settings.training_steps, hand=self.settings.hand)

    def curriculum(self) -> Curriculum:
        """From whole help to that of the difficulty."""
        return Withdrawal(min(self.start, self.z), self.settings.withdrawal, self.z, self.deadline)

    def walk(self, policy: Policy, seed: int, recorder: WalkRecorder | None = None) -> Episode:
        """One evaluation: a deterministic episode in a new world, with the help of the difficulty."""
        env = WalkerEnv(self.figure, steps=self.settings.steps, hand=self.settings.hand, recorder=recorder)
        try:
            return play(env, policy, seed=seed, level=self.z)
        finally:
            env.close()


class Walker:
    """The task `walker`.

    Its value is the mean reward over 500 control steps, a step after a fall counting 0, with the help that the trial's
    difficulty leaves: none at z = 1.
    """

    def info(self, settings: Mapping[str, JSON]) -> TaskInfo:
        """The task under these settings. Raises `BadSetting`."""
        return TaskInfo(
            name="walker",
            summary="A biped of twelve measures learns to walk fast with little energy",
            parameters=PARAMETERS,
            has_difficulty=True,
            settings=WalkerSettings.parse(settings).to_json(),
            training=TRAINING.to_json(),
        )

    def validate(self, settings: Mapping[str, JSON], training: Mapping[str, JSON], names: Sequence[str]) -> None:
        """Refuse wrong settings, training settings and unknown parameters (`BadSetting`)."""
        WalkerSettings.parse(settings)
        TrainingSettings.parse(training, TRAINING)
        check_parameters(names)

    def budget_at(self, settings: Mapping[str, JSON], training: Mapping[str, JSON], z: float) -> Budget:
        """The budget of a training at difficulty z. Raises `BadSetting`."""
        share = WalkerSettings.parse(settings).budget
        return TrainingSettings.parse(training, TRAINING).budget.part(share + (1 - share) * z)

    def run(self, job: Job, context: Context) -> Outcome:
        """Train, then evaluate. Artifacts: the policy, and the first evaluation's replay."""
        problem = problem_of(job)
        training = TrainingSettings.parse(job.training, TRAINING)
        training = replace(training, budget=self.budget_at(job.task_settings, job.training, problem.z))
        deadline = max(1, round(problem.settings.deadline * iterations_of(training)))
        problem = replace(problem, start=_start(job, context), deadline=deadline)
        trained = train(job, context, problem, training)
        level = problem.start if trained.level is None else trained.level
        policy = trained.policy.to_bytes()
        context.save_artifact(POLICY_ARTIFACT, with_note(policy, LEVEL, level))
        episodes = evaluate(job, problem, trained)
        recorder = WalkRecorder({"name": "walker", "z": problem.z})
        problem.walk(trained.policy, seeds(job, problem)[0], recorder)
        context.save_artifact(REPLAY_ARTIFACT, recorder.replay().to_bytes())
        value = float(np.mean([episode.total for episode in episodes])) / problem.settings.steps
        metrics = [episode.info["metrics"] for episode in episodes]
        details: dict[str, JSON] = {
            "steps": float(np.mean([len(episode) for episode in episodes])),
            "speed": float(np.mean([each["speed"] for each in metrics])),
            "power": float(np.mean([each["power"] for each in metrics])),
            "upright": float(np.mean([bool(episode.success) for episode in episodes])),
            "level": level,
            "mass": problem.figure.mass,
            "iterations": trained.iterations,
            **trained.lineage,
        }
        return Outcome("complete", value, None, trained.cost, details=details)

    def simulate(self, job: Job, policy: bytes) -> Replay:
        """The first evaluation of a stored policy, bit for bit. Raises `BadJob` where it is of another task."""
        problem = problem_of(job)
        recorder = WalkRecorder({"name": "walker", "z": problem.z})
        if note_of(policy, LEVEL) is None:
            raise BadJob("policy: expected one of a walker, found one of another task")
        problem.walk(Policy.from_bytes(policy), seeds(job, problem)[0], recorder)
        return recorder.replay()


def iterations_of(training: TrainingSettings) -> float:
    """About how many iterations a budget lasts for."""
    samples, iterations = training.budget.samples, training.budget.iterations
    bounds = [] if samples is None else [samples / training.ppo.samples]
    return min([*bounds, *([] if iterations is None else [float(iterations)])])


def problem_of(job: Job) -> WalkerProblem:
    """What a job trains, checked. Raises `BadSetting`."""
    check_parameters(job.params)
    settings = WalkerSettings.parse(job.task_settings)
    return WalkerProblem(settings, figure(job.params), 1.0 if job.z is None else job.z)


def seeds(job: Job, problem: WalkerProblem) -> list[int]:
    """Of the evaluations."""
    return [int(seed) for seed in job.rng("evaluation").integers(2**31, size=problem.settings.episodes)]


def evaluate(job: Job, problem: WalkerProblem, trained: Trained) -> list[Episode]:
    """The evaluations of a learnt policy. Raises `Diverged`."""
    try:
        return [problem.walk(trained.policy, seed) for seed in seeds(job, problem)]
    except NotFinite as error:
        quantity = f"{error.quantity} of the evaluation"
        raise Diverged(trained.iterations, quantity, in_words(error.value), trained.cost) from error


def _start(job: Job, context: Context) -> float:
    """How far the help is withdrawn at the beginning: as far as the parent had got.

    Where there is a checkpoint it knows, and the parent may be gone. A parent that can't be read is refused by the
    learner, in its own words.
    """
    if job.parent is None or context.load_checkpoint() is not None:
        return 0.0
    try:
        level = note_of(context.parent_artifact(POLICY_ARTIFACT), LEVEL)
    except BadJob:
        return 0.0
    return 0.0 if level is None else level
