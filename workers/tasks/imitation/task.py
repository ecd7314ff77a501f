"""Imitation as a `Task`: follow a clip for ever longer, until the motion is learnt; how soon is what counts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from workers.contracts import JSON, BadJob, Context, Job, Outcome, TaskInfo
from workers.learning.policy import Policy, note_of, with_note
from workers.learning.ppo import POLICY_ARTIFACT, train
from workers.learning.problem import Curriculum, Diverged, Trained
from workers.learning.rollout import Episode, NotFinite, in_words, play
from workers.learning.settings import Budget, TrainingSettings, check_searched, with_searched
from workers.replay import Recorder, Replay
from workers.tasks.high_jump.task import REPLAY_ARTIFACT
from workers.tasks.imitation import reference
from workers.tasks.imitation.env import CONTROL, Bounds, ImitationEnv
from workers.tasks.imitation.reference import Reference
from workers.tasks.imitation.settings import SHORTEST, SPACE, TRAINING, ImitationSettings, steps_at

LENGTH = "imitation.length"
"""Note in a stored policy: how long the episodes were when it was learnt, steps. A child goes on from there."""
MOST_FAILURES = 0.2
"""Share of an iteration's episodes; where fewer fail, episodes get longer."""


class EpisodeLength:
    """The curriculum: how many control steps episodes last, and whether the motion is learnt.

    Args:
        settings: of the task.
        longest: of an episode, T(z).
        start: its length at the beginning.
    """

    def __init__(self, settings: ImitationSettings, longest: int, start: int) -> None:
        self.settings, self.longest = settings, longest
        self.length = min(start, longest)
        self.best = -math.inf
        self.since_gain = 0
        self.per_step = 0.0
        """Return per step of the last iteration's episodes: what they gained, over their length if none had failed."""
        self._was_whole = False

    @property
    def level(self) -> float:
        """Length of the next iteration's episodes, control steps."""
        return float(self.length)

    def update(self, returns: Sequence[float], successes: Sequence[bool]) -> None:
        """Take note of one iteration's episodes. Raises `BadJob` where the environment reports no success."""
        if not successes:
            raise BadJob('curriculum: expected info["success"] at the end of each episode, found none')
        mean = sum(returns) / len(returns)
        self.per_step = mean / self.length
        self._was_whole = self.length == self.longest
        self.since_gain = 0 if mean > self.best else self.since_gain + 1
        self.best = max(self.best, mean)
        if (len(successes) - sum(successes)) / len(successes) < MOST_FAILURES:
            self.length = min(self.length + self.settings.growth, self.longest)

    def finished(self) -> bool:
        """Whether the motion is learnt at its full length, or no gain has come for too long."""
        learnt = self._was_whole and self.per_step >= self.settings.threshold
        return learnt or self.since_gain >= self.settings.patience

    def state(self) -> dict[str, JSON]:
        """All that `load` needs."""
        best = None if math.isinf(self.best) else self.best
        return {
            "length": self.length,
            "best": best,
            "since_gain": self.since_gain,
            "per_step": self.per_step,
            "was_whole": self._was_whole,
        }

    def load(self, state: Mapping[str, JSON]) -> None:
        """Continue from `state`."""
        self.length, self.since_gain = int(state["length"]), int(state["since_gain"])
        self.best = -math.inf if state["best"] is None else float(state["best"])
        self.per_step, self._was_whole = float(state["per_step"]), bool(state["was_whole"])

    def metrics(self) -> dict[str, float]:
        """Return per step and the episodes' length in seconds."""
        return {"return_per_step": self.per_step, "episode_seconds": self.length * CONTROL}


@dataclass(frozen=True, slots=True)
class ImitationProblem:
    """What the learner gets.

    Args:
        settings: of the task.
        reference: what to follow.
        longest: T(z), control steps.
        start: length of the first episodes.
    """

    settings: ImitationSettings
    reference: Reference
    longest: int
    start: int = SHORTEST

    def make_env(self, recorder: Recorder | None = None) -> ImitationEnv:
        """A new environment; a recorded one begins at the clip's beginning."""
        settings = self.settings
        return ImitationEnv(
            self.reference,
            lead=settings.lead,
            bounds=Bounds(settings.bound, settings.bound_turn),
            recorder=recorder,
            random_start=recorder is None,
        )

    def curriculum(self) -> Curriculum:
        """From the first episodes' length to T(z)."""
        return EpisodeLength(self.settings, self.longest, self.start)

    def follow(self, policy: Policy, seed: int, recorder: Recorder | None = None) -> Episode:
        """One evaluation: a deterministic episode of T(z) steps in a new world; a recorded one from the beginning."""
        env = self.make_env(recorder)
        try:
            return play(env, policy, seed=seed, level=float(self.longest))
        finally:
            env.close()


class Imitation:
    """The task `imitation`.

    Its value is equation 6.5 of the thesis: the return per step of the deterministic policy over T(z) = 30 + 570 z
    control steps (a step after a failure counts 0), times exp(-N / C), N the samples that the training took. A training
    ends once the motion is learnt (`threshold`), so that settings which learn it sooner are worth more.
    """

    def info(self, settings: Mapping[str, JSON]) -> TaskInfo:
        """The task under these settings. Raises `BadSetting`."""
        return TaskInfo(
            name="imitation",
            summary="The athlete learns to follow a motion clip (walk, run, backflip, ...)",
            parameters=SPACE,
            has_difficulty=True,
            settings=ImitationSettings.parse(settings).to_json(),
            training=TRAINING.to_json(),
        )

    def validate(self, settings: Mapping[str, JSON], training: Mapping[str, JSON], names: Sequence[str]) -> None:
        """Refuse wrong settings, training settings, unknown parameters and files that hold no motion (`BadSetting`)."""
        reference.read(ImitationSettings.parse(settings).clip)
        TrainingSettings.parse(training, TRAINING)
        for name in names:
            check_searched(name)

    def budget_at(self, settings: Mapping[str, JSON], training: Mapping[str, JSON], z: float) -> Budget:
        """The budget of a training at difficulty z. Raises `BadSetting`."""
        share = ImitationSettings.parse(settings).budget
        return TrainingSettings.parse(training, TRAINING).budget.part(share + (1 - share) * z)

    def run(self, job: Job, context: Context) -> Outcome:
        """Train, then evaluate. Artifacts: the policy, and the replay of an evaluation from the clip's beginning."""
        problem = replace(problem_of(job), start=_start(job, context))
        training = TrainingSettings.parse(with_searched(job.training, job.params), TRAINING)
        z = 1.0 if job.z is None else job.z
        training = replace(training, budget=self.budget_at(job.task_settings, job.training, z))
        trained = train(job, context, problem, training)
        length = problem.start if trained.level is None else trained.level
        context.save_artifact(POLICY_ARTIFACT, with_note(trained.policy.to_bytes(), LENGTH, length))
        episodes = evaluate(job, problem, trained)
        context.save_artifact(REPLAY_ARTIFACT, recorded(problem, trained.policy).to_bytes())
        per_step = float(np.mean([episode.total for episode in episodes])) / problem.longest
        value = per_step * math.exp(-trained.cost.samples / problem.settings.cost_scale)
        details: dict[str, JSON] = {
            "return_per_step": per_step,
            "learnt": trained.finished and per_step >= problem.settings.threshold,
            "seconds_followed": float(np.mean([len(episode) for episode in episodes])) * CONTROL,
            "of_seconds": problem.longest * CONTROL,
            "iterations": trained.iterations,
            "clip": problem.settings.clip,
            **trained.lineage,
        }
        return Outcome("complete", value, None, trained.cost, details=details)

    def simulate(self, job: Job, policy: bytes) -> Replay:
        """The recorded evaluation of a stored policy, bit for bit. Raises `BadJob` where it is of another task."""
        problem = problem_of(job)
        if note_of(policy, LENGTH) is None:
            raise BadJob("policy: expected one of an imitation, found one of another task")
        return recorded(problem, Policy.from_bytes(policy))


def problem_of(job: Job) -> ImitationProblem:
    """What a job trains, checked. Raises `BadSetting`."""
    settings = ImitationSettings.parse(job.task_settings)
    longest = steps_at(1.0 if job.z is None else job.z, settings.longest)
    return ImitationProblem(settings, reference.read(settings.clip), longest)


def recorded(problem: ImitationProblem, policy: Policy) -> Replay:
    """An evaluation from the clip's beginning, a frame for each control step."""
    recorder = Recorder("none", {"name": "imitation", "clip": problem.settings.clip}, CONTROL)
    problem.follow(policy, 0, recorder)
    return recorder.replay()


def evaluate(job: Job, problem: ImitationProblem, trained: Trained) -> list[Episode]:
    """The evaluations of a learnt policy. Raises `Diverged`."""
    seeds = job.rng("evaluation").integers(2**31, size=problem.settings.episodes)
    try:
        return [problem.follow(trained.policy, int(seed)) for seed in seeds]
    except NotFinite as error:
        quantity = f"{error.quantity} of the evaluation"
        raise Diverged(trained.iterations, quantity, in_words(error.value), trained.cost) from error


def _start(job: Job, context: Context) -> int:
    """Length of the first episodes: as long as the parent's had got.

    Where there is a checkpoint it knows, and the parent may be gone. A parent that can't be read is refused by the
    learner, in its own words.
    """
    if job.parent is None or context.load_checkpoint() is not None:
        return SHORTEST
    try:
        length = note_of(context.parent_artifact(POLICY_ARTIFACT), LENGTH)
    except BadJob:
        return SHORTEST
    return SHORTEST if length is None else round(length)
