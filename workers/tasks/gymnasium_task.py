"""Any Gymnasium environment as a task: registered ids, and classes that people bring.

The value is the mean return of the learnt policy over seeded deterministic episodes. What can be searched over are the
learner's settings (`ppo.clip`, `ppo.actor_rate`, ..., `network.activation`) and the arguments of the environment's
constructor, by name. The difficulty is the constructor's argument `z` where it has one, or the argument that the
settings name; it may also be how long a training lasts (`budget`: the share of it at z = 0), or both:

    task: {name: "gymnasium:Pendulum-v1", settings: {difficulty: {argument: g, low: 2.0, high: 10.0, budget: 0.2}}}
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np

from workers.contracts import (
    JSON,
    BadJob,
    Context,
    FeatureSpec,
    Job,
    Outcome,
    ParameterSpec,
    Scalar,
    TaskInfo,
)
from workers.learning import sb3
from workers.learning.ppo import POLICY_ARTIFACT, train
from workers.learning.problem import Curriculum, Diverged, Trained
from workers.learning.rollout import Episode, NotFinite, action_map, in_words, observation_size, play
from workers.learning.settings import (
    Budget,
    NetworkSettings,
    PPOSettings,
    TrainingSettings,
    check_searched,
    with_searched,
)
from workers.tasks.features import WrongFeatures, mean_behaviour, read_behaviour
from workers.tasks.gymnasium_settings import Arguments, EnvironmentSettings, read_settings
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

TRAINERS = ("halma", "sb3")
"""Our PPO, or Stable-Baselines3's where it is installed."""


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
        self._arguments = Arguments(make)

    def info(self, settings: Mapping[str, JSON]) -> TaskInfo:
        """The environment under these settings. Raises `BadSetting`."""
        read = read_settings(settings, self._arguments)
        return TaskInfo(
            self.name,
            self.summary,
            SPACE,
            read.features,
            has_difficulty=read.difficulty is not None or "z" in self._arguments.names,
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
        read = read_settings(settings, self._arguments)
        parsed = TrainingSettings.parse(training, DEFAULTS, trainers=TRAINERS)
        for name in names:
            self._check_name(name)
        if parsed.trainer == "sb3":
            sb3.check(training, names)
        if self._arguments.needed <= {*read.arguments, "z", *([read.difficulty.argument] if read.difficulty else [])}:
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
        read = read_settings(job.task_settings, self._arguments)
        training, arguments = self._apply(job)
        if read.difficulty is not None and job.z is not None:
            training = replace(training, budget=read.difficulty.part_of(training.budget, job.z))
        problem = EnvironmentProblem(self._maker(read, arguments, job.z), rebuild=read.rebuild)
        if training.trainer == "sb3":
            learner = {name: value for name, value in job.params.items() if "." in name}
            trained = sb3.train(job, context, problem, training, with_searched(job.training, learner))
        else:
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

    def _check_name(self, name: str) -> None:
        if "." in name:
            check_searched(name)
        else:
            self._arguments.check(name, name, "space")

    def _apply(self, job: Job) -> tuple[TrainingSettings, dict[str, JSON]]:
        """The candidate's parameters, sorted into training settings and constructor arguments."""
        for name in job.params:
            self._check_name(name)
        learner = {name: value for name, value in job.params.items() if "." in name}
        arguments: dict[str, JSON] = {name: value for name, value in job.params.items() if "." not in name}
        return TrainingSettings.parse(with_searched(job.training, learner), DEFAULTS, trainers=TRAINERS), arguments

    def maker(self, settings: Mapping[str, JSON], params: Mapping[str, Scalar], z: float | None) -> Callable[[], Env]:
        """How to make the environment of a candidate, e.g. to look at it. Raises `BadSetting`."""
        arguments = {name: value for name, value in params.items() if "." not in name}
        return self._maker(read_settings(settings, self._arguments), arguments, z)

    def budget_at(self, settings: Mapping[str, JSON], training: Mapping[str, JSON], z: float) -> Budget:
        """The budget of a training at difficulty z. Raises `BadSetting`."""
        difficulty = read_settings(settings, self._arguments).difficulty
        whole = TrainingSettings.parse(training, DEFAULTS, trainers=TRAINERS).budget
        return whole if difficulty is None else difficulty.part_of(whole, z)

    def _maker(self, read: EnvironmentSettings, arguments: Mapping[str, JSON], z: float | None) -> Callable[[], Env]:
        """How to make the environment of one candidate."""
        given = {**read.arguments, **arguments}
        if read.difficulty is not None and read.difficulty.argument is not None:
            given[read.difficulty.argument] = read.difficulty.at(1.0 if z is None else z)
        elif "z" in self._arguments.names and (z is not None or "z" not in given):
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


def _missing(name: str, error: Exception) -> UnknownTask:
    return UnknownTask(f"task {name!r}: a package it needs is missing: {error}")
