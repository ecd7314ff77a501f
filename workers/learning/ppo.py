"""A training from its first iteration to its last, deterministic and resumable at every one.

A training is a function of its job. The random numbers of iteration k come from the job's seed, their purpose and k,
so a checkpoint need hold no generator: weights, optimiser moments, statistics, curriculum and counters are all.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from workers.contracts import JSON, BadJob, Checkpoint, Context, Cost, Interrupted, Job
from workers.learning.learner import Learner, stream
from workers.learning.policy import Policy
from workers.learning.problem import Curriculum, Diverged, Problem, Trained
from workers.learning.rollout import Episode, NotFinite, action_map, in_words, observation_size
from workers.learning.settings import TrainingSettings

POLICY_ARTIFACT = "policy.safetensors"


@dataclass(slots=True)
class Progress:
    """The counters of a training. `length` is the mean length of the last episodes, 0 before any."""

    iteration: int = 0
    samples: int = 0
    seconds: float = 0.0
    length: float = 0.0

    @property
    def cost(self) -> Cost:
        """As reports and outcomes want it."""
        return Cost(self.samples, self.seconds)


def train(job: Job, context: Context, problem: Problem, settings: TrainingSettings) -> Trained:
    """Train from the newest checkpoint, the parent's policy, or scratch, until the budget or the curriculum ends.

    torch is set to one thread for the whole process: a training has one core, and more threads change last bits.

    Raises:
        Interrupted: at an iteration boundary where the context asks for it; the checkpoint is safe.
        Diverged: where a reward, an observation, a loss or a weight is NaN or infinite.
        BadJob: where environment, parent or checkpoint don't fit.
    """
    torch.set_num_threads(1)
    envs = [problem.make_env() for _ in range(settings.ppo.environments)]
    try:
        return _Training(job, context, problem.curriculum(), settings, envs).run()
    finally:
        for env in envs:
            env.close()


class _Training:
    """One call of `train`: the loop around the learner."""

    def __init__(
        self,
        job: Job,
        context: Context,
        curriculum: Curriculum | None,
        settings: TrainingSettings,
        envs: Sequence[Any],
    ) -> None:
        self.job, self.context, self.curriculum, self.settings, self.envs = job, context, curriculum, settings, envs
        self.learner = Learner(job, settings, observation_size(envs[0]), action_map(envs[0]))
        self.progress = Progress()
        self.unpaid = 0
        """Samples that were played and are not counted yet."""
        self.metrics: Mapping[str, float] = {}
        self.lineage: Mapping[str, JSON] = {}

    @property
    def level(self) -> float | None:
        return None if self.curriculum is None else self.curriculum.level

    def run(self) -> Trained:
        mark = time.perf_counter()
        self.begin()
        progress = self.progress
        while not self.spent():
            samples = progress.samples
            try:
                metrics = self.iterate()
            except NotFinite as error:
                progress.seconds += time.perf_counter() - mark
                progress.samples += error.samples + self.unpaid
                raise Diverged(progress.iteration + 1, error.quantity, in_words(error.value), progress.cost) from error
            elapsed = time.perf_counter() - mark
            mark += elapsed
            progress.seconds += elapsed
            progress.iteration += 1
            self.metrics = {
                **metrics,
                "samples": progress.samples,
                "samples_per_second": (progress.samples - samples) / elapsed,
            }
            self.context.report(progress.iteration, self.metrics, progress.cost)
            self.context.save_checkpoint(self.checkpoint())
            if not self.spent() and self.context.stop_requested():
                raise Interrupted(f"stopped at the checkpoint of iteration {progress.iteration}")
        return Trained(
            self.learner.policy(),
            progress.iteration,
            progress.cost,
            self.level,
            self.curriculum,
            self.mastered,
            self.metrics,
            self.lineage,
        )

    def begin(self) -> None:
        """From the checkpoint, from the parent, or from scratch."""
        checkpoint = self.context.load_checkpoint()
        if checkpoint is not None:
            self.restore(checkpoint)
        elif self.job.parent is not None:
            try:
                taken = self.learner.warm_start(Policy.from_bytes(self.context.parent_artifact(POLICY_ARTIFACT)))
            except BadJob as error:
                raise BadJob(f"warm start from trial {self.job.parent}: {error}") from None
            self.context.log(f"trial {self.job.parent}: {taken.message}")
            self.lineage = {"warm_start": {"parent": self.job.parent, **dataclasses.asdict(taken)}}

    @property
    def mastered(self) -> bool:
        """Whether the curriculum has nothing more to teach."""
        return self.curriculum is not None and self.curriculum.finished()

    def spent(self) -> bool:
        """Whether this training is at its end."""
        budget, progress = self.settings.budget, self.progress
        return (
            self.mastered
            or (budget.samples is not None and progress.samples >= budget.samples)
            or (budget.iterations is not None and progress.iteration >= budget.iterations)
        )

    def iterate(self) -> dict[str, float]:
        """One iteration: play, learn, move the curriculum. Returns its metrics."""
        ppo, learner, progress = self.settings.ppo, self.learner, self.progress
        iteration, level = progress.iteration + 1, self.level
        if learner.normaliser.count == 0:
            # Actions sampled under other statistics would be off the policy: the first ones only give statistics.
            warm_up = learner.rollout(self.envs, self.job, iteration, sampling=0, level=level)
            self.watch(warm_up)
            progress.length = float(np.mean([len(e) for e in warm_up]))
        # Environments that all begin an episode at once all finish it: no more of them than the iteration has room for.
        room = max(1, round(ppo.samples / progress.length)) if progress.length else ppo.environments
        episodes = learner.rollout(self.envs[:room], self.job, iteration, sampling=iteration, level=level)
        self.unpaid = sum(len(e) for e in episodes)
        batch = learner.batch(episodes)
        learnt = learner.update(batch, iteration, stream(self.job, "minibatches", iteration))
        if iteration <= ppo.normaliser_iterations:
            self.watch(episodes)
        else:
            progress.samples += self.unpaid
        self.unpaid = 0
        progress.length = float(np.mean([len(e) for e in episodes]))
        returns = [e.total for e in episodes]
        successes = [e.success for e in episodes if e.success is not None]
        metrics = {"return_mean": float(np.mean(returns)), **learnt}
        metrics |= {"episodes": len(episodes), "episode_length": progress.length}
        if successes:
            metrics["success_rate"] = sum(successes) / len(successes)
        metrics |= environment_metrics(episodes)
        if self.curriculum is not None:
            metrics["level"] = self.curriculum.level
            self.curriculum.update(returns, successes)
            metrics |= self.curriculum.metrics()
        return metrics

    def watch(self, episodes: Sequence[Episode]) -> None:
        """Count the episodes' samples, and take them into the observation statistics."""
        observations = np.concatenate([e.observations for e in episodes])
        self.learner.normaliser = self.learner.normaliser.updated(observations)
        self.progress.samples += len(observations)

    def checkpoint(self) -> Checkpoint:
        """All that the next iteration needs."""
        state: dict[str, JSON] = {
            "progress": dataclasses.asdict(self.progress),
            "curriculum": None if self.curriculum is None else self.curriculum.state(),
            "metrics": dict(self.metrics),
            "lineage": dict(self.lineage),
        }
        return Checkpoint(self.progress.iteration, self.learner.tensors(), state)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint."""
        self.learner.load(checkpoint.tensors)
        self.progress = Progress(**checkpoint.state["progress"])
        self.metrics = checkpoint.state["metrics"]
        self.lineage = checkpoint.state.get("lineage", {})  # checkpoints of halma 0.1.0 don't tell
        if self.curriculum is not None:
            self.curriculum.load(checkpoint.state["curriculum"])


def environment_metrics(episodes: Sequence[Episode]) -> dict[str, float]:
    """The mean of each of the environment's own metrics, over the episodes that gave it a finite one."""
    gathered: dict[str, list[float]] = {}
    for episode in episodes:
        for name, value in episode.info.get("metrics", {}).items():
            if math.isfinite(value):
                gathered.setdefault(name, []).append(float(value))
    return {name: float(np.mean(values)) for name, values in gathered.items()}
