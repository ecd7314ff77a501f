"""What a task gives the learner, and what the learner gives back.

The way of one training, `workers.learning.ppo.train(job, context, problem, settings) -> Trained`:

    for each iteration
        level = curriculum.level
        each of N environments plays whole episodes, stepped in turn, their observations through the policy as one batch
            reset(seed=..., options={"level": level, "fresh": first episode of this environment in this iteration})
            step(action) until terminated or truncated
        one PPO update from all episodes; curriculum.update(returns, successes)
        checkpoint -> report -> Interrupted, where the context asks for it

Observations are one-dimensional `Box` spaces; actions are a one-dimensional `Box` or a `Discrete` space. Where a `Box`
has finite bounds, the policy's output 0 is their middle, +-1 the bounds, and what goes beyond is clipped; where it has
none (use +-inf), the environment gets the policy's output as it is and decides on its own scale.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from workers.contracts import JSON, BadJob, Cost, WorkerError
from workers.learning.policy import Policy

if TYPE_CHECKING:
    import gymnasium  # for the annotations alone: whoever only wants `Diverged` need not wait for it


class Curriculum(Protocol):
    """Decides how hard the next iteration's episodes are.

    A curriculum is deterministic: the same updates lead to the same levels.
    """

    @property
    def level(self) -> float:
        """Difficulty of the next iteration, in the task's own unit (m of bar, m of obstacle)."""

    def update(self, returns: Sequence[float], successes: Sequence[bool]) -> None:
        """Take note of one iteration's episodes.

        Args:
            returns: undiscounted return of each episode.
            successes: `info["success"]` of each episode; empty where the environment gives none.
        """

    def finished(self) -> bool:
        """Whether there is nothing harder to learn; the training ends before its budget is spent."""

    def state(self) -> dict[str, JSON]:
        """All that `load` needs to go on, for the checkpoint."""

    def load(self, state: Mapping[str, JSON]) -> None:
        """Continue from what `state` gave."""

    def metrics(self) -> dict[str, float]:
        """Named figures for the learning curve, beside `level`."""


class Problem(Protocol):
    """A task under one candidate: what the learner needs to train it."""

    def make_env(self) -> gymnasium.Env[Any, Any]:
        """A new environment. Called N times at the start of a training (and again when it is resumed).

        `reset(seed=int, options={"level": float | None, "fresh": bool})`: each episode is a function of its seed, its
        level and the actions, and of nothing that came before. With `fresh` true, the first episode of each iteration
        for each environment, the environment must behave as newly constructed (rebuild the physics world: solver
        caches remember), so that a training resumed at an iteration boundary continues bit by bit.

        The `info` of an episode's last step may hold `success` (bool) and `metrics` (name -> float, averaged over the
        iteration's episodes and reported under their names).
        """

    def curriculum(self) -> Curriculum | None:
        """A new curriculum at its start, or None: then `level` is None."""


@dataclass(slots=True)
class Ladder:
    """Levels in equal steps, and how far one has come: what curricula have in common.

    Args:
        start: first level.
        step: one step, in the level's unit.
        freeze: the highest level; reached and mastered, the training is finished. None: never.
    """

    start: float
    step: float
    freeze: float | None = None
    steps: int = field(default=0, init=False)
    mastered: float | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        if not self.step > 0:
            raise BadJob(f"curriculum: expected a step above 0, found {self.step}")
        if self.freeze is not None and self.freeze < self.start:
            raise BadJob(
                f"curriculum: expected a freeze level of at least the start level {self.start}, found {self.freeze}"
            )

    @property
    def level(self) -> float:
        """Start plus whole steps (counted, so that rounding does not add up), at most `freeze`."""
        level = round(self.start + self.steps * self.step, 9)
        return level if self.freeze is None else min(level, self.freeze)

    def climb(self, steps: int) -> None:
        """The level is mastered: so many steps up."""
        self.mastered = self.level if self.mastered is None else max(self.mastered, self.level)
        self.steps += steps

    def back(self) -> None:
        """One step down, not below the first level."""
        top = self.steps if self.freeze is None else math.ceil((self.freeze - self.start) / self.step - 1e-9)
        self.steps = max(0, min(self.steps, top) - 1)

    def finished(self) -> bool:
        """Whether `freeze` has been mastered."""
        return self.freeze is not None and self.mastered is not None and self.mastered >= self.freeze

    def metrics(self) -> dict[str, float]:
        """The highest level mastered, once there is one."""
        return {} if self.mastered is None else {"level_mastered": self.mastered}


@dataclass(slots=True)
class SuccessCurriculum(Ladder):
    """Raises the level by how often the last iteration succeeded.

    At half the episodes one step (then the level counts as mastered), above 0.8 two, above 0.9 five. After `PATIENCE`
    iterations in a row without a single success each further one takes a step back: where success is all that is
    rewarded nothing is learnt there, and five steps at once may have been too many.
    """

    PATIENCE: ClassVar[float] = 3
    success_rate: float = field(default=0.0, init=False)
    fruitless: int = field(default=0, init=False)

    def update(self, returns: Sequence[float], successes: Sequence[bool]) -> None:  # noqa: ARG002 - only success counts
        """Raise the level. Raises `BadJob` where the environment reports no success."""
        if not successes:
            raise BadJob('curriculum: expected info["success"] at the end of each episode, found none')
        rate = sum(successes) / len(successes)
        self.success_rate = rate
        self.fruitless = 0 if any(successes) else self.fruitless + 1
        if rate >= 0.5:
            self.climb(5 if rate > 0.9 else 2 if rate > 0.8 else 1)
        elif self.fruitless > self.PATIENCE:
            self.back()

    def state(self) -> dict[str, JSON]:
        """Steps taken, the last success rate, iterations without success, and the highest level mastered."""
        return {
            "steps": self.steps,
            "success_rate": self.success_rate,
            "mastered": self.mastered,
            "fruitless": self.fruitless,
        }

    def load(self, state: Mapping[str, JSON]) -> None:
        """Continue from `state`."""
        self.steps, self.success_rate, self.mastered = state["steps"], state["success_rate"], state["mastered"]
        self.fruitless = state.get("fruitless", 0)  # checkpoints of halma 0.1.0 don't count them


@dataclass(slots=True)
class RewardCurriculum(Ladder):
    """Raises the level one step whenever the mean returns of the iterations add up to a threshold (Yin et al. 2021).

    Args:
        threshold: of the accumulated mean return; it counts from 0 at each level, which is then mastered.
    """

    threshold: float = 30.0
    accumulated: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        Ladder.__post_init__(self)
        if not self.threshold > 0:
            raise BadJob(f"curriculum: expected a threshold above 0, found {self.threshold}")

    def update(self, returns: Sequence[float], successes: Sequence[bool]) -> None:  # noqa: ARG002 - only reward counts
        """Add the mean return, and raise the level where the sum has come to the threshold."""
        self.accumulated += sum(returns) / max(1, len(returns))
        if self.accumulated >= self.threshold:
            self.climb(1)
            self.accumulated = 0.0

    def state(self) -> dict[str, JSON]:
        """Steps taken, what has added up, and the highest level mastered."""
        return {"steps": self.steps, "accumulated": self.accumulated, "mastered": self.mastered}

    def load(self, state: Mapping[str, JSON]) -> None:
        """Continue from `state`."""
        self.steps, self.accumulated, self.mastered = state["steps"], state["accumulated"], state["mastered"]

    def metrics(self) -> dict[str, float]:
        """What has added up at this level, and the highest level mastered, once there is one."""
        return {"accumulated_return": self.accumulated, **Ladder.metrics(self)}


class Diverged(WorkerError):
    """A quantity of the training became NaN or infinite.

    Args:
        iteration: the iteration it happened in, from 1.
        quantity: `observation`, `reward`, `loss`, `weights`, ...
        value: what it became: `NaN` or `infinite`.
        cost: what the training has cost until then.
    """

    def __init__(self, iteration: int, quantity: str, value: str, cost: Cost) -> None:
        super().__init__(f"iteration {iteration}: {quantity} became {value}")
        self.iteration = iteration
        self.quantity = quantity
        self.value = value
        self.cost = cost


@dataclass(frozen=True, slots=True)
class Trained:
    """What a training led to.

    Args:
        policy: with its normaliser and its critic; `policy.to_bytes()` is what `policy.safetensors` keeps.
        iterations: finished iterations, over all attempts.
        cost: over all attempts.
        level: the curriculum's level for the next iteration, None without one.
        curriculum: the curriculum as it ended, None without one.
        finished: whether the curriculum ended the training before its budget was spent.
        metrics: of the last iteration, as reported.
        lineage: for the outcome's details: `warm_start` with `parent` (its trial), `networks` (whether they were taken
            over, or only the statistics) and `message`; empty for a training from scratch.
    """

    policy: Policy
    iterations: int
    cost: Cost
    level: float | None
    curriculum: Curriculum | None
    finished: bool
    metrics: Mapping[str, float]
    lineage: Mapping[str, JSON] = field(default_factory=dict)
