"""Environments small enough to reason about, and jobs on them."""

import gymnasium
import numpy as np

from workers.contracts import Job, Outcome, TaskInfo
from workers.learning.problem import SuccessCurriculum
from workers.learning.settings import TrainingSettings


class Target(gymnasium.Env):
    """Three steps; the reward of each is minus the squared distance of the action from the observation's sign."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
    length = 3

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t, self.options = 0, options
        return self.observe(), {}

    def observe(self):
        self.side = float(self.np_random.choice([-1.0, 1.0]))
        return np.array([5.0 * self.side, 1.0])

    def step(self, action):
        reward = -((float(action[0]) - 0.5 * self.side) ** 2)
        self.t += 1
        over = self.t >= self.length
        return self.observe(), reward, over, False, {"success": reward > -0.1} if over else {}


class Choice(Target):
    """The same with two choices, the smaller of which is 3: the right one gives 1."""

    action_space = gymnasium.spaces.Discrete(2, start=3)

    def step(self, action):
        assert action in {3, 4}
        reward = 1.0 if (action == 4) == (self.side > 0) else 0.0
        self.t += 1
        return self.observe(), reward, self.t >= self.length, False, {}


class ToyProblem:
    def __init__(self, make=Target, curriculum=None):
        self.make_env, self._curriculum = make, curriculum

    def curriculum(self):
        return None if self._curriculum is None else SuccessCurriculum(**self._curriculum)


class OwnTask:
    """A task in full."""

    def info(self, settings):
        return TaskInfo("own", "its own")

    def validate(self, settings, training, names):
        pass

    def run(self, job, context):
        return Outcome("complete", 1.0)


def job(**fields):
    return Job(**({"study": "s", "trial": 0, "task": "point_jump", "params": {}, "seed": 7} | fields))


def settings(iterations=3, network=None, **ppo):
    small = {"environments": 4, "samples": 48, "minibatch": 16}
    return TrainingSettings.parse(
        {"budget": {"iterations": iterations}, "network": network or {"hidden": [8]}, "ppo": small | ppo}
    )
