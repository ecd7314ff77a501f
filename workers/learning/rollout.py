"""Playing episodes: environments stepped in turn, their observations through the policy as one batch."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from workers.contracts import JSON, BadJob
from workers.learning.policy import ActionMap, Policy

Sampler = Callable[[NDArray[np.float32]], NDArray[Any]]
"""From the network's outputs ``[n, size]`` to actions: network units ``[n, size]``, or choices ``[n]``."""


class NotFinite(Exception):
    """An environment gave a NaN or an infinity.

    Args:
        quantity: `observation` or `reward`.
        value: what it gave.
        samples: steps that were played until then, which nobody has counted yet.
    """

    def __init__(self, quantity: str, value: float, samples: int = 0) -> None:
        super().__init__(f"{quantity} became {in_words(value)}")
        self.quantity = quantity
        self.value = value
        self.samples = samples


def in_words(value: float) -> str:
    """`NaN` or `infinite`."""
    return "NaN" if math.isnan(value) else "infinite"


@dataclass(slots=True)
class Episode:
    """One episode. ``T`` steps.

    Args:
        observations: what the policy saw before each step, T rows of ``[observation]``.
        actions: what it did, T rows in network units ``[size]``, or T choices from 0.
        rewards: T of them.
        last: the observation after the last step ``[observation]``.
        terminated: whether it ended by itself; else it was truncated, and `last` has a value.
        info: of the last step.
    """

    observations: list[NDArray[np.float64]] = field(default_factory=list)
    actions: list[Any] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    last: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    terminated: bool = True
    info: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of steps."""
        return len(self.rewards)

    @property
    def total(self) -> float:
        """Undiscounted return."""
        return math.fsum(self.rewards)

    @property
    def success(self) -> bool | None:
        """`info["success"]`, or None where the environment gives none."""
        return None if "success" not in self.info else bool(self.info["success"])


def observation_size(env: gymnasium.Env[Any, Any]) -> int:
    """Length of the environment's observations. Raises `BadJob` where they aren't one-dimensional."""
    space = env.observation_space
    if not isinstance(space, gymnasium.spaces.Box) or len(space.shape) != 1:
        raise BadJob(f"environment: expected a Box of one dimension as observation space, found {space}")
    return int(space.shape[0])


def action_map(env: gymnasium.Env[Any, Any]) -> ActionMap:
    """The environment's action space. Raises `BadJob` where it is neither a one-dimensional Box nor Discrete."""
    space = env.action_space
    if isinstance(space, gymnasium.spaces.Discrete):
        return ActionMap("discrete", int(space.n), start=int(space.start))
    if isinstance(space, gymnasium.spaces.Box) and len(space.shape) == 1:
        return ActionMap.box(space.low, space.high)
    raise BadJob(f"environment: expected a Box of one dimension or a Discrete as action space, found {space}")


def collect(
    envs: Sequence[gymnasium.Env[Any, Any]],
    policy: Policy,
    sample: Sampler,
    *,
    samples: int,
    level: float | None,
    seeds: Callable[[], int],
    episode_limit: int,
) -> list[Episode]:
    """Play whole episodes until they have at least `samples` steps together.

    Every episode that is begun is played to its end and counts, so that short ones are not favoured. A new one begins
    where those at play, if they get as long as those that ended, will not do.

    Args:
        envs: how many play at a time; none of them is used again within this call before its episode has ended.
        policy: gives the network's outputs.
        sample: gives the actions.
        samples: steps wanted; a little more than that are made.
        level: for the environments.
        seeds: gives the seed of each episode, in the order they begin.
        episode_limit: a longer episode raises `BadJob`.

    Raises:
        NotFinite: where an observation or a reward is.
        BadJob: where an observation has another shape than its space, or an episode doesn't end.
    """
    actions = policy.actions
    shape = (policy.observation_size,)
    discrete = actions.kind == "discrete"
    current = np.empty((len(envs), *shape))
    playing: list[Episode] = [Episode() for _ in envs]
    finished: list[Episode] = []
    active = list(range(len(envs)))
    done = 0

    def begin(i: int, *, fresh: bool) -> None:
        options: dict[str, JSON] = {"level": level, "fresh": fresh}
        observation, _ = envs[i].reset(seed=seeds(), options=options)
        _check_shape(observation, shape)
        current[i] = observation
        playing[i] = Episode()

    def played() -> int:
        return sum(map(len, finished)) + sum(len(playing[i]) for i in active)

    for i in active:
        begin(i, fresh=True)
    while active:
        observations = current[active]
        _check_finite(observations, played)
        chosen = sample(policy.output(observations))
        given: Sequence[Any] = (chosen + actions.start).tolist() if discrete else list(actions.to_environment(chosen))
        still = []
        for row, i in enumerate(active):
            observation, reward, terminated, truncated, info = envs[i].step(given[row])
            reward = float(reward)
            if not math.isfinite(reward):
                raise NotFinite("reward", reward, played() + 1)
            episode = playing[i]
            episode.observations.append(observations[row])
            episode.actions.append(chosen[row])
            episode.rewards.append(reward)
            if getattr(observation, "shape", None) != shape:
                _check_shape(observation, shape)
            current[i] = observation
            if not (terminated or truncated):
                if len(episode) >= episode_limit:
                    raise BadJob(
                        f"environment: expected an episode to end within {episode_limit} steps (ppo.episode_limit), "
                        "found one that goes on; give the environment a time limit"
                    )
                still.append(i)
                continue
            episode.last = current[i].copy()
            _check_finite(episode.last, played)
            episode.terminated, episode.info = bool(terminated), info
            finished.append(episode)
            done += len(episode)
            at_play = len(still) + len(active) - row - 1
            if done + at_play * (done / len(finished)) < samples:
                begin(i, fresh=False)
                still.append(i)
        active = still
    return finished


def play(
    env: gymnasium.Env[Any, Any], policy: Policy, *, seed: int, level: float | None, episode_limit: int = 10_000
) -> Episode:
    """One deterministic episode in a fresh environment, for evaluation.

    Args:
        env: reset with `fresh`.
        policy: its mean or its likeliest action is taken.
        seed: of the episode.
        level: for the environment.
        episode_limit: as in `collect`, which also says what is raised.
    """

    def greedy(output: NDArray[np.float32]) -> NDArray[Any]:
        return output.argmax(1) if policy.actions.kind == "discrete" else output

    (episode,) = collect([env], policy, greedy, samples=1, level=level, seeds=lambda: seed, episode_limit=episode_limit)
    return episode


def _check_finite(observations: NDArray[np.float64], played: Callable[[], int]) -> None:
    if math.isfinite(observations.sum()):  # one sum tells of all, and is the common case
        return
    bad = observations[~np.isfinite(observations)]
    if bad.size:
        raise NotFinite("observation", float(bad[0]), played())


def _check_shape(observation: Any, shape: tuple[int, ...]) -> None:
    if np.shape(observation) != shape:
        raise BadJob(
            f"environment: expected observations of shape {shape} as its observation space says, found shape "
            f"{np.shape(observation)}"
        )
