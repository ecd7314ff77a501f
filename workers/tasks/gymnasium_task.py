"""Any Gymnasium environment as a task: registered ids, and classes that people bring.

The value is the mean return of the learnt policy over seeded deterministic episodes. What can be searched over are the
learner's settings (`ppo.clip`, `ppo.actor_rate`, ..., `network.activation`) and the arguments of the environment's
constructor, by name. The difficulty is the constructor's argument `z` where it has one, or the argument that the
settings name:

    task: {name: "gymnasium:Pendulum-v1", settings: {difficulty: {argument: g, low: 2.0, high: 10.0}}}
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import gymnasium
import numpy as np

from workers.contracts import (
    JSON,
    BadJob,
    BadSetting,
    Context,
    FeatureSpec,
    Job,
    Outcome,
    ParameterSpec,
    TaskInfo,
)
from workers.learning.ppo import POLICY_ARTIFACT, train
from workers.learning.problem import Curriculum, Diverged, Trained
from workers.learning.rollout import Episode, NotFinite, action_map, in_words, observation_size, play
from workers.learning.settings import Budget, NetworkSettings, PPOSettings, TrainingSettings
from workers.tasks.features import WrongFeatures, declared_features, mean_behaviour, read_behaviour
from workers.user_code import EnvironmentFailed, UnknownTask, import_module, suggestion, user_traceback

Env = gymnasium.Env[Any, Any]

DEFAULTS = TrainingSettings(
    Budget(samples=100_000),
    NetworkSettings((64, 64), "tanh"),
    PPOSettings(samples=2048, gamma=0.99, normalise_rewards=True, sigma_start=0.5, sigma_iterations=50),
)
"""Discounted and with rewards of any size, unlike the jumps' own defaults."""

SPACE: Mapping[str, ParameterSpec] = {
    "ppo.actor_rate": ParameterSpec("float", 3e-5, 3e-3, log=True),
    "ppo.critic_rate": ParameterSpec("float", 3e-5, 1e-2, log=True),
    "ppo.clip": ParameterSpec("float", 0.05, 0.4),
    "ppo.gae_lambda": ParameterSpec("float", 0.8, 1.0),
    "ppo.epochs": ParameterSpec("int", 1, 10),
    "ppo.minibatch": ParameterSpec("int", 32, 512, log=True),
}
"""What is searched where the study file gives no space."""

_SECTION = "task.settings"


@dataclass(frozen=True, slots=True)
class Difficulty:
    """Which constructor argument z stands for: low + z (high - low)."""

    argument: str
    low: float
    high: float

    def at(self, z: float) -> float:
        """The argument's value."""
        return self.low + z * (self.high - self.low)


@dataclass(frozen=True, slots=True)
class EnvironmentSettings:
    """The task's settings.

    Args:
        arguments: of the environment's constructor.
        difficulty: None where z means nothing.
        episodes: how many deterministic ones the value is the mean of.
        max_episode_steps: time limit, None for the environment's own.
        rebuild: whether each iteration begins with new environments. Without it a training is faster where they are
            slow to make, but resumes bit by bit only if `reset` forgets everything.
        features: what `info["features"]` at the end of an episode means; None where behaviour plays no part.
    """

    arguments: Mapping[str, JSON]
    difficulty: Difficulty | None
    episodes: int
    max_episode_steps: int | None
    rebuild: bool
    features: FeatureSpec | None


class Renewed(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Gives our `reset` its meaning for an environment that knows nothing of it: `fresh` makes a new one.

    Args:
        make: a new environment.
        rebuild: whether `fresh` counts.
    """

    def __init__(self, make: Callable[[], Env], *, rebuild: bool) -> None:
        super().__init__(make())
        self._make, self._rebuild, self._used = make, rebuild, False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """The options are ours, not the environment's."""
        if (options or {}).get("fresh") and self._rebuild and self._used:
            self.env.close()
            self.env = self._make()
        self._used = True
        return self.env.reset(seed=seed)


class EnvironmentProblem:
    """One candidate of a Gymnasium environment, for the learner."""

    def __init__(self, make: Callable[[], Env], *, rebuild: bool) -> None:
        self._make, self._rebuild = make, rebuild

    def make_env(self) -> Env:
        """A new environment."""
        return Renewed(self._make, rebuild=self._rebuild)

    def curriculum(self) -> Curriculum | None:
        """None: the difficulty of a trial is fixed."""
        return None


class GymnasiumTask:
    """The task that an environment makes.

    Args:
        name: as the study file writes it.
        summary: one line.
        make: the environment's constructor.
    """

    def __init__(self, name: str, summary: str, make: Callable[..., Env]) -> None:
        self.name, self.summary, self._make = name, summary, make
        parameters = _constructor(make)
        self._arguments = {p.name for p in parameters if p.kind in {p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY}}
        self._takes_any = any(p.kind is p.VAR_KEYWORD for p in parameters)

    def info(self, settings: Mapping[str, JSON]) -> TaskInfo:
        """The environment under these settings. Raises `BadSetting`."""
        read = self._read(settings)
        return TaskInfo(
            self.name,
            self.summary,
            SPACE,
            read.features,
            has_difficulty=read.difficulty is not None or "z" in self._arguments,
            settings={
                "arguments": dict(read.arguments),
                "difficulty": settings.get("difficulty"),
                "episodes": read.episodes,
                "max_episode_steps": read.max_episode_steps,
                "rebuild": read.rebuild,
                "features": settings.get("features"),
            },
            training=DEFAULTS.to_json(),
        )

    def validate(self, settings: Mapping[str, JSON], training: Mapping[str, JSON], names: Sequence[str]) -> None:
        """Refuse wrong settings and names, and environments whose spaces can't be learnt.

        An environment whose constructor needs an argument that the space gives can't be made yet; its spaces are
        looked at when a trial runs.
        """
        read = self._read(settings)
        TrainingSettings.parse(training, DEFAULTS)
        for name in names:
            self._check_name(name)
        needed = {p.name for p in _constructor(self._make) if p.default is p.empty and p.name in self._arguments}
        if needed <= {*read.arguments, "z"} | ({read.difficulty.argument} if read.difficulty else set()):
            env = self._first(self._maker(read, {}, None))
            try:
                observation_size(env)
                action_map(env)
            finally:
                env.close()

    def _first(self, make: Callable[[], Env]) -> Env:
        """An environment to look at. Raises `EnvironmentFailed` with the user's traceback."""
        try:
            return make()
        except BadJob:
            raise
        except Exception as error:  # noqa: BLE001 - the user's code may raise anything, and it is told to the user
            raise EnvironmentFailed(self.name, user_traceback(error)) from None

    def run(self, job: Job, context: Context) -> Outcome:
        """Train, then play deterministic episodes; their mean return is the value."""
        read = self._read(job.task_settings)
        training, arguments = self._apply(job)
        problem = EnvironmentProblem(self._maker(read, arguments, job.z), rebuild=read.rebuild)
        trained = train(job, context, problem, training)
        context.save_artifact(POLICY_ARTIFACT, trained.policy.to_bytes())
        episodes = self._evaluate(job, problem, trained, read.episodes, training.ppo.episode_limit)
        returns = [e.total for e in episodes]
        details: dict[str, JSON] = {
            "return_std": float(np.std(returns)),
            "episode_length": float(np.mean([len(e) for e in episodes])),
            "iterations": trained.iterations,
            **trained.lineage,
        }
        successes = [e.success for e in episodes if e.success is not None]
        if successes:
            details["success_rate"] = sum(successes) / len(successes)
        features = self._behaviour(read.features, episodes)
        if features is not None and not all(map(math.isfinite, features)):
            bad = next(f for f in features if not math.isfinite(f))
            raise Diverged(trained.iterations, "features", in_words(bad), trained.cost)
        return Outcome("complete", float(np.mean(returns)), features, trained.cost, details=details)

    def _evaluate(
        self, job: Job, problem: EnvironmentProblem, trained: Trained, count: int, limit: int
    ) -> list[Episode]:
        """Seeded deterministic episodes, each in a fresh environment."""
        seeds = job.rng("evaluation").integers(2**31, size=count)
        env = problem.make_env()
        try:
            return [play(env, trained.policy, seed=int(s), level=None, episode_limit=limit) for s in seeds]
        except NotFinite as error:
            quantity = f"{error.quantity} of the evaluation"
            raise Diverged(trained.iterations, quantity, in_words(error.value), trained.cost) from error
        finally:
            env.close()

    def _behaviour(self, spec: FeatureSpec | None, episodes: Sequence[Episode]) -> tuple[float, ...] | None:
        if spec is None:
            return None
        try:
            rows = [read_behaviour(spec, e.info.get("features")) for e in episodes]
        except WrongFeatures as error:
            raise BadJob(f'task {self.name!r}: info["features"] at the end of an episode: {error}') from None
        return mean_behaviour(spec, [r for r in rows if r is not None])

    def _read(self, settings: Mapping[str, JSON]) -> EnvironmentSettings:
        known = [f.name for f in fields(EnvironmentSettings)]
        for key in settings:
            if key not in known:
                raise BadSetting(_SECTION, key, f"unknown setting{suggestion(key, known)}")
        arguments = settings.get("arguments") or {}
        if not isinstance(arguments, Mapping):
            raise BadSetting(_SECTION, "arguments", f"expected a mapping, found {arguments!r}")
        for name in arguments:
            self._check_argument("arguments", name)
        rebuild = settings.get("rebuild", True)
        if not isinstance(rebuild, bool):
            raise BadSetting(_SECTION, "rebuild", f"expected true or false, found {rebuild!r}")
        limit = settings.get("max_episode_steps")
        return EnvironmentSettings(
            arguments,
            self._difficulty(settings.get("difficulty")),
            _count("episodes", settings.get("episodes", 10)),
            None if limit is None else _count("max_episode_steps", limit),
            rebuild,
            declared_features(settings),
        )

    def _difficulty(self, given: JSON) -> Difficulty | None:
        if given is None:
            return None
        if not isinstance(given, Mapping) or set(given) != {"argument", "low", "high"}:
            raise BadSetting(_SECTION, "difficulty", f"expected a mapping with argument, low and high, found {given!r}")
        self._check_argument("difficulty.argument", given["argument"])
        for key in ("low", "high"):
            if not isinstance(given[key], int | float) or not math.isfinite(given[key]):
                raise BadSetting(_SECTION, f"difficulty.{key}", f"expected a number, found {given[key]!r}")
        return Difficulty(given["argument"], float(given["low"]), float(given["high"]))

    def _check_argument(self, field: str, name: str, section: str = _SECTION) -> None:
        if name not in self._arguments and not self._takes_any:
            known = ", ".join(sorted(self._arguments)) or "none"
            raise BadSetting(section, field, f"the environment's constructor has no argument {name!r}; it has {known}")

    def _check_name(self, name: str) -> None:
        head, _, tail = name.partition(".")
        learner: Mapping[str, list[str]] = {
            "ppo": [f.name for f in fields(PPOSettings)],
            "network": ["activation"],
        }
        if not tail:
            self._check_argument(name, name, "space")
        elif tail not in learner.get(head, []):
            known = [f"{h}.{t}" for h, names in learner.items() for t in names]
            raise BadSetting("space", name, f"no setting of the learner{suggestion(name, known)}")

    def _apply(self, job: Job) -> tuple[TrainingSettings, dict[str, JSON]]:
        """The candidate's parameters, sorted into training settings and constructor arguments."""
        training: dict[str, JSON] = dict(job.training)
        arguments: dict[str, JSON] = {}
        for name, value in job.params.items():
            self._check_name(name)
            head, _, tail = name.partition(".")
            if tail:
                training[head] = {**(training.get(head) or {}), tail: value}
            else:
                arguments[name] = value
        return TrainingSettings.parse(training, DEFAULTS), arguments

    def _maker(self, read: EnvironmentSettings, arguments: Mapping[str, JSON], z: float | None) -> Callable[[], Env]:
        """How to make the environment of one candidate."""
        given = {**read.arguments, **arguments}
        if read.difficulty is not None:
            given[read.difficulty.argument] = read.difficulty.at(1.0 if z is None else z)
        elif "z" in self._arguments and (z is not None or "z" not in given):
            given["z"] = 1.0 if z is None else z

        def make() -> Env:
            env = self._make(**given)
            if read.max_episode_steps is not None:
                env = gymnasium.wrappers.TimeLimit(env, read.max_episode_steps)
            space = env.observation_space
            flat = isinstance(space, gymnasium.spaces.Box) and len(space.shape) == 1
            return env if flat else gymnasium.wrappers.FlattenObservation(env)

        return make


def registered(identifier: str) -> GymnasiumTask:
    """The task of a registered id, e.g. `CartPole-v1`.

    Raises `UnknownTask` where there is none, naming the nearest, or where its package is missing, naming it.
    """
    name = f"gymnasium:{identifier}"
    module, _, plain = identifier.rpartition(":")
    if module:
        import_module(name, module)  # Gymnasium's own form `module:ID`: the module registers the id
    try:
        spec = gymnasium.spec(plain)
    except gymnasium.error.Error:
        near = suggestion(plain, gymnasium.registry)
        raise UnknownTask(f"task {name!r}: Gymnasium knows no environment {plain!r}{near}") from None
    try:
        entry = spec.entry_point
        constructor: Any = gymnasium.envs.registration.load_env_creator(entry) if isinstance(entry, str) else entry
    except (ImportError, gymnasium.error.Error) as error:
        raise _missing(name, error) from None

    def make(**arguments: JSON) -> Env:
        try:
            return gymnasium.make(spec, disable_env_checker=True, **arguments)
        except (ImportError, gymnasium.error.DependencyNotInstalled) as error:
            raise _missing(name, error) from None

    # Its signature is the constructor's, so that arguments are checked like those of a class.
    make.__signature__ = inspect.signature(constructor)  # type: ignore[attr-defined] # inspect reads it from functions
    return GymnasiumTask(name, f"Gymnasium's {identifier}", make)


def from_class(name: str, found: type) -> GymnasiumTask:
    """The task of a user's environment class. Raises `UnknownTask` where it is something else."""
    if not issubclass(found, gymnasium.Env):
        raise UnknownTask(
            f"task {name!r}: expected a function, a gymnasium.Env class or a Task, found the class {found.__name__}"
        )
    summary = (inspect.getdoc(found) or "an environment").splitlines()[0]
    return GymnasiumTask(name, summary, found)


def _constructor(make: Callable[..., Env]) -> list[inspect.Parameter]:
    return [p for p in inspect.signature(make).parameters.values() if p.name not in {"self", "render_mode"}]


def _missing(name: str, error: Exception) -> UnknownTask:
    return UnknownTask(f"task {name!r}: a package it needs is missing: {error}")


def _count(field: str, value: JSON) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise BadSetting(_SECTION, field, f"expected a whole number of at least 1, found {value!r}")
    return value
