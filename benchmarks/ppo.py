"""Samples a second of a whole training (playing and learning), beside three others in the same run.

    OMP_NUM_THREADS=1 python benchmarks/ppo.py [--samples 20000] [--rounds 3] [--env Pendulum-v1]
    OMP_NUM_THREADS=1 python benchmarks/ppo.py --env high_jump     # the athlete, from a take-off state that jumps

    random     the environment alone, stepped at random: what no learner can exceed on one core
    halma      `workers.learning.ppo.train`: eight environments in turn, inference batched in numpy
    halma-N    as many trainings at once as there are cores, each in a process of its own, as a search runs them
    naive      the same algorithm as tutorials write it: one environment, torch inference for each step, torch's Adam
    sb3        Stable-Baselines3's PPO, eight environments in one process (`DummyVecEnv`), where it is installed
    sb3-sub    the same with an environment process for each core (`SubprocVecEnv`), to compare halma-N with
    sb3-sub-1  the same with one environment process, both on one core, to compare halma with

The samples of halma-N are those of all its trainings together, each as long as `--samples` says.

All of them on one torch thread, with the same environment, network (64-64 tanh), samples an iteration (2048),
mini-batch (128) and epochs (5). The rounds alternate, so that whatever else the machine does hits all alike; medians
are printed. Then what one inference takes in numpy and in torch, and what acting costs beside the
environment's own step.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import functools
import importlib.util
import itertools
import multiprocessing
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

from workers.contracts import Job
from workers.learning.learner import Learner
from workers.learning.policy import forward
from workers.learning.ppo import train
from workers.learning.rollout import action_map, collect
from workers.learning.settings import Budget, NetworkSettings, PPOSettings, TrainingSettings
from workers.local_context import LocalContext
from workers.tasks.gymnasium_task import EnvironmentProblem

JUMP = "high_jump"
HIDDEN, BATCH, MINIBATCH, EPOCHS, ENVIRONMENTS = (64, 64), 2048, 128, 5, 8


def settings(samples: int) -> TrainingSettings:
    ppo = PPOSettings(
        environments=ENVIRONMENTS, samples=BATCH, minibatch=MINIBATCH, epochs=EPOCHS, gamma=0.99,
        kl_stop=1e9, sigma="learnt", normalise_rewards=True,
    )  # fmt: skip
    return TrainingSettings(Budget(samples), NetworkSettings(HIDDEN, "tanh"), ppo)


def make(name: str) -> gymnasium.Env[Any, Any]:
    """An environment by its id, or the athlete's. At module level: environment processes find it here."""
    if name != JUMP:
        return gymnasium.make(name, disable_env_checker=True)
    from workers.tasks.high_jump.env import HighJumpEnv  # noqa: PLC0415 - Bullet, which the others don't need
    from workers.tasks.high_jump.settings import HighJumpSettings  # noqa: PLC0415 - the same

    env = HighJumpEnv(HighJumpSettings(formulation="flight").take_off({"alpha": 0.7, "v_z": -2.0}))
    env.action_space = gymnasium.spaces.Box(-1.0, 1.0, env.action_space.shape)  # Stable-Baselines3 wants bounds
    return env


def random_stepping(name: str, samples: int) -> int:
    env = make(name)
    env.action_space.seed(0)
    env.reset(seed=0)
    for _ in range(samples):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
    return samples


def halma(name: str, samples: int) -> int:
    problem = EnvironmentProblem(lambda: make(name), rebuild=True)
    with tempfile.TemporaryDirectory() as folder:
        job = Job("benchmark", 0, f"gymnasium:{name}", {}, 1)
        return train(job, LocalContext(Path(folder)), problem, settings(samples)).cost.samples


@functools.cache
def workers() -> concurrent.futures.ProcessPoolExecutor:
    """A process for each core."""
    return concurrent.futures.ProcessPoolExecutor(os.cpu_count() or 1, multiprocessing.get_context("spawn"))


def halma_on_each_core(name: str, samples: int) -> int:
    """Trainings side by side, in processes that live on, as workers do."""
    count = os.cpu_count() or 1
    return sum(workers().map(halma, [name] * count, [samples] * count))


def naive(name: str, samples: int) -> int:
    """PPO as tutorials write it."""
    env = make(name)
    size, out = env.observation_space.shape[0], env.action_space.shape[0]

    def network(outputs: int) -> torch.nn.Sequential:
        a, b = HIDDEN
        linear, tanh = torch.nn.Linear, torch.nn.Tanh
        return torch.nn.Sequential(linear(size, a), tanh(), linear(a, b), tanh(), linear(b, outputs))

    actor, critic, log_sigma = network(out), network(1), torch.nn.Parameter(torch.zeros(out))
    parameters = [*actor.parameters(), *critic.parameters(), log_sigma]
    optimiser = torch.optim.Adam(parameters, lr=3e-4)
    done, observation = 0, env.reset(seed=0)[0]
    while done < samples:
        observations, actions, log_ps, rewards, values, ends = [], [], [], [], [], []
        for _ in range(BATCH):
            x = torch.as_tensor(observation, dtype=torch.float32)
            with torch.no_grad():
                normal = torch.distributions.Normal(actor(x), log_sigma.exp())
                action = normal.sample()
                log_ps.append(normal.log_prob(action).sum())
                values.append(critic(x)[0])
            observations.append(x)
            actions.append(action)
            observation, reward, terminated, truncated, _ = env.step(action.numpy())
            rewards.append(float(reward))
            ends.append(terminated or truncated)
            if ends[-1]:
                observation, _ = env.reset()
        A, advantage, following = torch.zeros(BATCH), 0.0, 0.0
        for t in reversed(range(BATCH)):
            going_on = 1.0 - ends[t]
            advantage = rewards[t] + 0.99 * following * going_on - float(values[t]) + 0.99 * 0.95 * going_on * advantage
            A[t], following = advantage, float(values[t])
        returns = A + torch.stack(values)
        X, U, old = torch.stack(observations), torch.stack(actions), torch.stack(log_ps)
        A = (A - A.mean()) / A.std()
        for _ in range(EPOCHS):
            order = torch.randperm(BATCH)
            for start in range(0, BATCH, MINIBATCH):
                rows = order[start : start + MINIBATCH]
                log_p = torch.distributions.Normal(actor(X[rows]), log_sigma.exp()).log_prob(U[rows]).sum(1)
                r = (log_p - old[rows]).exp()
                loss = -torch.min(r * A[rows], r.clamp(0.8, 1.2) * A[rows]).mean()
                loss = loss + 0.5 * (critic(X[rows])[:, 0] - returns[rows]).square().mean()
                optimiser.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(parameters, 0.5)
                optimiser.step()
        done += BATCH
    return done


def sb3(name: str, samples: int, processes: int) -> int:
    """With so many environment processes; 0: all environments in this one."""
    from stable_baselines3 import PPO  # noqa: PLC0415 - an extra
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv  # noqa: PLC0415 - the same

    count = processes or ENVIRONMENTS
    makers: list[Callable[[], gymnasium.Env[Any, Any]]] = [functools.partial(make, name) for _ in range(count)]
    vector = SubprocVecEnv(makers) if processes else DummyVecEnv(makers)
    model = PPO(
        "MlpPolicy", vector, n_steps=BATCH // len(makers), batch_size=MINIBATCH, n_epochs=EPOCHS, device="cpu",
        policy_kwargs={"net_arch": list(HIDDEN)},
    )  # fmt: skip
    model.learn(samples)
    vector.close()
    return int(model.num_timesteps)


def sb3_on_one_core(name: str, samples: int) -> int:
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})  # the environment process has it from this one
    try:
        return sb3(name, samples, 1)
    finally:
        os.sched_setaffinity(0, cores)


def microseconds(work: Callable[[], Any], times: int = 300) -> float:
    """Of the fastest of ten batches."""
    found = []
    for _ in range(10):
        start = time.perf_counter()
        for _ in range(times):
            work()
        found.append((time.perf_counter() - start) / times)
    return 1e6 * min(found)


def inference() -> None:
    print("\none inference, microseconds (network 197-256-128-28, relu)")
    print("observations   numpy   torch")
    rng = np.random.default_rng(0)
    sizes = (197, 256, 128, 28)
    layers = [
        (rng.normal(size=(a, b)).astype(np.float32), rng.normal(size=b).astype(np.float32))
        for a, b in itertools.pairwise(sizes)
    ]
    modules: list[torch.nn.Module] = []
    for a, b in itertools.pairwise(sizes):
        modules += [torch.nn.Linear(a, b), torch.nn.ReLU()]
    network = torch.nn.Sequential(*modules[:-1])
    for n in (1, 4, 8, 16):
        x = rng.normal(size=(n, sizes[0])).astype(np.float32)
        with torch.inference_mode():
            theirs = microseconds(lambda x=x: network(torch.from_numpy(x)).numpy())
        print(f"{n:12d} {microseconds(lambda x=x: forward(layers, x, 'relu')):7.1f} {theirs:7.1f}")


class Still(gymnasium.Env[np.ndarray, np.ndarray]):
    """Costs nothing: what is left is ours."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (197,), np.float64)
    action_space = gymnasium.spaces.Box(-np.inf, np.inf, (28,), np.float32)
    seen = np.zeros(197)

    def reset(self, **_: Any) -> tuple[np.ndarray, dict[str, Any]]:
        self.t = 0
        return self.seen, {}

    def step(self, _: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        self.t += 1
        return self.seen, 0.0, self.t >= 10, False, {}


def overhead() -> None:
    print("\nacting beside the environment's own step, microseconds a control step (197 observations, 28 actions)")
    for n in (1, 4, 8, 16):
        ppo = PPOSettings(environments=n, samples=2000)
        learner = Learner(Job("b", 0, "still", {}, 1), TrainingSettings(ppo=ppo), 197, action_map(Still()))
        envs, best = [Still() for _ in range(n)], float("inf")
        policy, rng = learner.policy(shared=True), np.random.default_rng(0)
        for _ in range(5):
            start = time.perf_counter()
            episodes = collect(
                envs, policy, lambda o, rng=rng: o + 0.4 * rng.standard_normal(o.shape, np.float32),
                samples=2000, level=None, seeds=lambda: 1, episode_limit=100,
            )  # fmt: skip
            best = min(best, (time.perf_counter() - start) / sum(map(len, episodes)))
        print(f"{n:3d} environments {1e6 * best:6.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--env", default="Pendulum-v1")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows: dict[str, Callable[[str, int], int]] = {
        "random": random_stepping,
        "halma": halma,
        f"halma-{os.cpu_count()}": halma_on_each_core,
        "naive": naive,
    }
    if importlib.util.find_spec("stable_baselines3") is not None:
        rows["sb3"] = functools.partial(sb3, processes=0)
        rows["sb3-sub"] = functools.partial(sb3, processes=os.cpu_count() or 1)
        rows["sb3-sub-1"] = sb3_on_one_core
    for work in rows.values():
        work(options.env, BATCH)  # imports and first calls don't count
    wall: dict[str, list[float]] = {name: [] for name in rows}
    for _ in range(options.rounds):
        for name, work in rows.items():
            start = time.perf_counter()
            made = work(options.env, options.samples)
            wall[name].append(made / (time.perf_counter() - start))
    load = os.getloadavg()[0]
    print(f"{options.env}, {options.samples} samples, median of {options.rounds} rounds, load average {load:.1f}")
    print("            samples/s   lowest  highest   of halma")
    ours = statistics.median(wall["halma"])
    for name, rates in wall.items():
        middle = statistics.median(rates)
        print(f"{name:10s} {middle:10.0f} {min(rates):8.0f} {max(rates):8.0f} {middle / ours:9.2f}")
    if "sb3" not in rows:
        print("sb3: not installed (it comes with the extra dev)")
    inference()
    overhead()


if __name__ == "__main__":
    main()
