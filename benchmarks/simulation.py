"""How fast is the simulation, and where does its time go?

    python benchmarks/simulation.py [--seconds 20]

Plays random episodes of the high jump (push-off pose plus noise) and prints control steps a CPU second and simulated
seconds a CPU second, with the split between Bullet's stepping, its stable PD controllers, its other calls, and Python.
Beside it, in the same run and for the same CPU time, the DeepMimic environment that pybullet carries (the same
humanoid, 240 Hz, actions at 30 Hz). CPU seconds of this process, so that a busy machine changes little.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import sys
import time
import types
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
import pybullet_data

from workers.physics.world import quiet
from workers.tasks.high_jump.env import HighJumpEnv
from workers.tasks.high_jump.settings import HighJumpSettings

TAKE_OFF = {"alpha": 0.4, "omega_x": -3.0, "omega_z": 1.0, "v_z": -2.4}
PARTS = {"stepSimulation": "stepping", "setJointMotorControlMultiDofArray": "stable PD"}


@contextlib.contextmanager
def stopwatch() -> Iterator[dict[str, float]]:
    """Seconds inside Bullet's functions, by part, while the block runs.

    Of the wall clock: asking for the CPU's takes 0.9 us, as long as many of Bullet's calls, and would be
    counted as Python's. Another process that takes the core for a while hits all parts alike.
    """
    spent: dict[str, float] = defaultdict(float)
    originals = {name: f for name, f in vars(pybullet).items() if isinstance(f, types.BuiltinFunctionType)}

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        part = PARTS.get(name, "other calls")

        def call(*args: Any, **kwargs: Any) -> Any:
            start = time.perf_counter_ns()
            result = function(*args, **kwargs)
            spent[part] += (time.perf_counter_ns() - start) / 1e9
            return result

        return call

    for name, function in originals.items():
        setattr(pybullet, name, timed(name, function))
    try:
        yield spent
    finally:
        for name, function in originals.items():
            setattr(pybullet, name, function)


def jump(seconds: float, control_rate: int) -> tuple[int, float, float]:
    """Control steps, simulated seconds and CPU seconds of random high jumps."""
    env = HighJumpEnv(HighJumpSettings().take_off(TAKE_OFF), control_rate=control_rate)
    rng = np.random.default_rng(0)
    steps, simulated, start = 0, 0.0, time.process_time()
    while time.process_time() - start < seconds:
        env.reset(options={"level": 0.3})
        done = False
        while not done:
            _, _, done, _, _ = env.step(0.3 * rng.standard_normal(28))
            steps += 1
        simulated += env.elapsed
    spent = time.process_time() - start
    env.close()
    return steps, simulated, spent


def rebuild_seconds(times: int = 20) -> float:
    """CPU seconds of building a world anew, which each environment does once an iteration."""
    env = HighJumpEnv(HighJumpSettings().take_off(TAKE_OFF))
    start = time.process_time()
    for _ in range(times):
        env.world.rebuild()
    spent = (time.process_time() - start) / times
    env.close()
    return spent


def deep_mimic(seconds: float) -> tuple[int, float, float]:
    """The same of pybullet's own DeepMimic environment, at its own 240 Hz and 30 Hz, with random actions."""
    # the package's __init__ asks for the retired gym, only to register names: go round it
    package = types.ModuleType("pybullet_envs")
    package.__path__ = [str(Path(pybullet_data.getDataPath()).parent / "pybullet_envs")]
    sys.modules.setdefault("pybullet_envs", package)
    module = importlib.import_module("pybullet_envs.deep_mimic.env.pybullet_deep_mimic_env")

    arguments = importlib.import_module("pybullet_utils.arg_parser").ArgParser()
    arguments.load_file(str(Path(pybullet_data.getDataPath()) / "args" / "run_humanoid3d_run_args.txt"))
    with contextlib.redirect_stdout(io.StringIO()), quiet():
        env = module.PyBulletDeepMimicEnv(
            arguments, time_step=1 / 240, init_strategy=module.InitializationStrategy.START
        )
    agent = 0
    low, high = np.array(env.build_action_bound_min(agent)), np.array(env.build_action_bound_max(agent))
    mean = -np.array(env.build_action_offset(agent))
    rng = np.random.default_rng(0)
    steps, start = 0, time.process_time()
    while time.process_time() - start < seconds:
        env.reset()
        ended = False  # asked only after a step: the contacts of the last episode would end this one
        while not ended and time.process_time() - start < seconds:
            env.calc_reward(agent)
            env.set_action(agent, np.clip(mean + 0.1 * rng.standard_normal(len(low)), low, high))
            for _ in range(8):
                env.update(1 / 240)
            env.record_state(agent)
            ended = env.is_episode_end()
            steps += 1
    return steps, steps / 30, time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description="speed of the simulation")
    parser.add_argument("--seconds", type=float, default=20.0, help="CPU seconds for each measurement")
    seconds = parser.parse_args().seconds

    print(f"{'':34}{'control steps/s':>16}{'simulated s/s':>16}")
    for rate in (10, 30):
        steps, simulated, spent = jump(seconds, rate)
        print(f"{f'high_jump, {rate} actions a second':34}{steps / spent:>16.0f}{simulated / spent:>16.2f}")
    steps, simulated, spent = deep_mimic(seconds)
    print(f"{'pybullet_envs deep_mimic, 30':34}{steps / spent:>16.0f}{simulated / spent:>16.2f}")

    with stopwatch() as parts:
        start = time.perf_counter()
        jump(seconds, 10)
        spent = time.perf_counter() - start
    inside = sum(parts.values())
    print("\nhigh_jump, share of time (with the stopwatch's own):")
    for part in ("stepping", "stable PD", "other calls"):
        print(f"  {part:14}{parts[part] / spent:>6.0%}")
    print(f"  {'Python':14}{1 - inside / spent:>6.0%}")
    print(f"\nbuilding a world anew: {1000 * rebuild_seconds():.1f} ms")


if __name__ == "__main__":
    main()
