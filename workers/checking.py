"""Does a task keep its promises? What `halma task check` looks at, with what was found and what to mend."""

from __future__ import annotations

import dataclasses
import itertools
import math
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from workers.contracts import JSON, BadJob, Cost, Interrupted, Job, Outcome, ParameterSpec, Scalar, Task, TaskInfo
from workers.learning.problem import Diverged
from workers.local_context import LocalContext
from workers.tasks.function import FunctionTask
from workers.user_code import user_traceback

Verdict = Literal["good", "doubtful", "bad"]

LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
EPISODE_SECONDS = 20.0
"""An episode that takes longer is not waited for."""
TINY: Mapping[str, JSON] = {
    "budget": {"iterations": 2},
    "network": {"hidden": [8]},
    "ppo": {"environments": 2, "samples": 16, "minibatch": 8, "epochs": 1},
}
"""A training that is over at once."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at.

    Args:
        check: what.
        verdict: `bad` will not work, `doubtful` works but not as one may think.
        found: what was found.
        remedy: what to do, where not all is good.
    """

    check: str
    verdict: Verdict
    found: str
    remedy: str = ""


class _Wrong(Exception):
    """A check that did not pass.

    Args:
        found: what was found.
        remedy: what to do.
        verdict: how bad it is.
    """

    def __init__(self, found: str, remedy: str, verdict: Verdict = "bad") -> None:
        super().__init__(found)
        self.finding = (verdict, found, remedy)


Check = Callable[[], str]
"""Says what was found; raises `_Wrong`, `BadJob`, or whatever the user's code raises."""


def check_task(
    task: Task,
    *,
    name: str,
    settings: Mapping[str, JSON],
    space: Mapping[str, ParameterSpec] | None = None,
    training: Mapping[str, JSON] | None = None,
) -> list[Finding]:
    """Look whether a task keeps its promises, in some seconds.

    Args:
        task: what to look at.
        name: as the study file writes it.
        settings: of the task.
        space: parameters to draw candidates from; None for the task's own.
        training: of the study, to tell what difficulties cost; None for the task's own.

    Returns:
        One finding for each check, in order; after a bad one of the first two nothing more is looked at.
    """
    looked = _look("settings", lambda: f"{task.info(settings).summary}")
    if looked.verdict == "bad":
        return [looked]
    info = task.info(settings)
    subject = _Subject(task, info, name, settings, space or info.parameters, training or {})
    found = [looked, _look("spaces", subject.spaces)]
    if found[-1].verdict == "bad":
        return found
    if hasattr(task, "maker"):
        found += [_look(check, run) for check, run in _environment_checks(subject)]
    found += [_look("determinism", subject.determinism), _look("difficulty", subject.difficulty)]
    if info.trains:
        found.append(_look("resumption", subject.resumption))
    return found


def _look(check: str, run: Check) -> Finding:
    try:
        return Finding(check, "good", run())
    except _Wrong as wrong:
        return Finding(check, *wrong.finding)
    except BadJob as error:
        return Finding(check, "bad", str(error), "mend what the message names")
    except Diverged as error:
        return Finding(check, "bad", f"a training diverged: {error}", "rewards and observations must be finite")
    except Exception as error:  # noqa: BLE001 - the user's code may raise anything, and it is told to the user
        return Finding(check, "bad", user_traceback(error), "mend the error in your code")


@dataclass(frozen=True, slots=True)
class _Subject:
    """A task and the candidate that it is tried with: the middle of each range."""

    task: Task
    info: TaskInfo
    name: str
    settings: Mapping[str, JSON]
    space: Mapping[str, ParameterSpec]
    training: Mapping[str, JSON]

    def params(self) -> dict[str, Scalar]:
        return {name: _middle(parameter) for name, parameter in self.space.items()}

    def job(self, z: float | None, *, iterations: int = 2) -> Job:
        tiny = {**TINY, "budget": {"iterations": iterations}} if self.info.trains else {}
        # What is searched of the learner would undo its tininess, and is halma's own affair.
        params = {name: value for name, value in self.params().items() if "." not in name}
        return Job("check", 0, self.name, params or {}, 7, self.settings, tiny, z if self.info.has_difficulty else None)

    def spaces(self) -> str:
        if not self.space:
            raise _Wrong(
                "no parameters: this task has none of its own",
                "check it with its study file, which has a space: halma task check FILE.yaml",
            )
        self.task.validate(self.settings, self.training, list(self.space))
        if self.info.features is None:
            return f"parameters {', '.join(self.space)}; no behaviour"
        return f"parameters {', '.join(self.space)}; behaviour {', '.join(self.info.features.names)}"

    def run(self, folder: Path, z: float | None = 1.0) -> Outcome:
        return self.task.run(self.job(z), LocalContext(folder))

    def determinism(self) -> str:
        with _folders(2) as folders:
            one, other = (_timeless(self.run(folder)) for folder in folders)
            kept = [_artifacts(folder) for folder in folders]
        if one.status in {"failed", "diverged"}:
            raise _Wrong(f"{one.status}: {one.message}", "mend it: no trial of a search would end better")
        if one != other or kept[0] != kept[1]:
            raise _Wrong(
                f"two runs of the same job differ: value {one.value!r} and {other.value!r}",
                "draw all random numbers from self.np_random (environments) or from an argument rng (functions)",
            )
        return f"two runs of the same job are equal: {one.status}, value {one.value!r}"

    def resumption(self) -> str:
        with _folders(2) as (whole, parts):
            undisturbed = _timeless(self.task.run(self.job(1.0, iterations=3), LocalContext(whole)))
            context = LocalContext(parts)
            context.stop = lambda: len(context.reports()) == 1
            try:
                self.task.run(self.job(1.0, iterations=3), context)
            except Interrupted:
                resumed = _timeless(self.task.run(self.job(1.0, iterations=3), LocalContext(parts)))
            else:
                return "not looked at: the training was over after one iteration"
            equal = undisturbed == resumed and _artifacts(whole) == _artifacts(parts)
        if not equal:
            raise _Wrong(
                "a training interrupted after an iteration and continued gives other weights",
                "let reset() forget everything, or leave task.settings.rebuild true",
                "doubtful",
            )
        return "a training interrupted and continued gives the same weights, bit for bit"

    def difficulty(self) -> str:
        if not self.info.has_difficulty:
            return "none; cmfbo and other strategies that choose difficulties can't be used"
        if self.info.trains and not hasattr(self.task, "budget_at"):
            return "yes; what easy levels save shows in whole trainings only"
        costs = [self._cost(z) for z in LEVELS]
        shown = ", ".join(f"{cost:,} at z = {z:g}" for z, cost in zip(LEVELS, costs, strict=True))
        if any(b < a for a, b in itertools.pairwise(costs)):
            raise _Wrong(
                f"the cost in samples falls as z rises: {shown}",
                "turn z round: 0 is the easiest and cheapest version, 1 the real task",
            )
        if costs[0] == costs[-1]:
            remedy = (
                "return value, features, cost from the function"
                if isinstance(self.task, FunctionTask)
                else "give easy levels a part of the budget, e.g. task.settings.difficulty.budget: 0.2"
            )
            raise _Wrong(
                f"every difficulty costs the same ({costs[0]:,} samples), so that easy ones save nothing",
                remedy,
                "doubtful",
            )
        return f"cost in samples: {shown}"

    def _cost(self, z: float) -> int:
        """What a trial at a difficulty costs: known for environments, tried out for functions and other tasks."""
        if hasattr(self.task, "budget_at"):
            budget = self.task.budget_at(self.settings, self.training, z)
            return int(budget.samples or budget.iterations)
        with _folders(1) as (folder,):
            return self.run(folder, z).cost.samples


def _environment_checks(subject: _Subject) -> list[tuple[str, Check]]:
    """Of an environment itself."""
    task: Any = subject.task
    make = task.maker(subject.settings, subject.params(), 1.0)

    def gymnasiums() -> str:
        from gymnasium.utils.env_checker import check_env  # noqa: PLC0415 - with what only a check needs

        env = make()
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                check_env(env.unwrapped, skip_render_check=True)
        except AssertionError as error:
            raise _Wrong(str(error), "Gymnasium's own checker asks for it; see its documentation of Env") from None
        finally:
            env.close()
        told = sorted({_plain(str(warning.message)) for warning in caught})
        told = [each for each in told if "infinity" not in each]  # the learner normalises: no bounds are fine
        if told:
            raise _Wrong("; ".join(told), "Gymnasium's own checker advises it", "doubtful")
        return "Gymnasium's checker has nothing to say"

    def episodes() -> str:
        lengths = [_play(make, seed).length for seed in range(3)]
        return f"episodes of random actions end after {min(lengths)} to {max(lengths)} steps, all numbers finite"

    def seeding() -> str:
        first, again = _play(make, 11), _play(make, 11)
        if first.digest != again.digest:
            raise _Wrong(
                "two episodes with the same seed and the same actions differ",
                "call super().reset(seed=seed) and draw all random numbers from self.np_random",
            )
        used = _play(make, 11, after=3)
        if used.digest != first.digest:
            raise _Wrong(
                "an episode depends on the one before it: the same seed gives another one in a used environment",
                "let reset() set back everything; until then leave task.settings.rebuild true",
                "doubtful",
            )
        return "the same seed gives the same episode, also in a used environment"

    return [("gymnasium", gymnasiums), ("episodes", episodes), ("seeding", seeding)]


@dataclass(frozen=True, slots=True)
class _Played:
    length: int
    digest: bytes


def _play(make: Callable[[], Any], seed: int, after: int | None = None) -> _Played:
    """One episode of random actions; `after` plays one with that seed in the same environment first."""
    env = make()
    try:
        if after is not None:
            _episode(env, after)
        return _episode(env, seed)
    finally:
        env.close()


def _episode(env: Any, seed: int) -> _Played:
    space = env.observation_space
    env.action_space.seed(seed)
    observation, _ = env.reset(seed=seed)
    seen = []
    limit = 10_000
    until = time.monotonic() + EPISODE_SECONDS
    for step in range(1, limit + 1):
        _check_observation(observation, space)
        seen.append(np.asarray(observation).tobytes())
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        if not math.isfinite(reward):
            raise _Wrong(f"the reward of step {step} is {reward}", "rewards must be finite: look for a division by 0")
        seen.append(repr(float(reward)).encode())
        if terminated or truncated:
            _check_observation(observation, space)
            return _Played(step, b"".join(seen))
        if time.monotonic() > until:
            break
    raise _Wrong(
        f"an episode had not ended after {step:,} steps",
        "end episodes (terminated), or give a time limit: task.settings.max_episode_steps: 500",
    )


def _check_observation(observation: Any, space: Any) -> None:
    if np.shape(observation) != space.shape:
        raise _Wrong(
            f"an observation has shape {np.shape(observation)}, the observation space {space.shape}",
            "make both the same",
        )
    if not np.isfinite(np.asarray(observation, np.float64)).all():
        raise _Wrong("an observation holds NaN or an infinity", "observations must be finite")


def _middle(parameter: ParameterSpec) -> Scalar:
    """The middle of a range, on its own scale; the first choice."""
    if parameter.kind == "categorical":
        return parameter.choices[0]
    if parameter.kind == "angle" or parameter.low is None or parameter.high is None:
        return 0.0
    mean = math.sqrt(parameter.low * parameter.high) if parameter.log else (parameter.low + parameter.high) / 2
    return round(mean) if parameter.kind == "int" else mean


def _timeless(outcome: Outcome) -> Outcome:
    return dataclasses.replace(outcome, cost=Cost(outcome.cost.samples))


def _artifacts(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((folder / "artifacts").iterdir())}


@contextmanager
def _folders(count: int) -> Iterator[list[Path]]:
    with tempfile.TemporaryDirectory(prefix="halma-check-") as root:
        yield [Path(root) / str(i) for i in range(count)]


def _plain(message: str) -> str:
    """Gymnasium's warnings without their colours."""
    return message.replace("\x1b[33m", "").replace("\x1b[0m", "").removeprefix("WARN: ").strip()
