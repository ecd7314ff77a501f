"""Walking as a `gymnasium.Env`: torques of fifteen hinges, sixty times a second."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from workers.physics.rotations import Array
from workers.tasks.walker.body import HINGES, Figure
from workers.tasks.walker.recording import WalkRecorder
from workers.tasks.walker.world import CONTROL, FEET, GAIN, HIGH, LOW, TORQUE, WalkerWorld

SPEED = 1.0
"""m/s that the helping hand moves the torso at: an easy walk."""
ALIVE = 0.5
"""Reward of a control step in which the walker is up."""
ENERGY = 0.1
"""Reward taken away for mechanical power, per body weight times 1 m/s."""
WEIGHT = 9.81
"""m/s^2, to tell power in body weights."""
_FALLEN = 0.65
"""Share of its standing height below which the torso has fallen."""
_TILTED = 0.5
"""Cosine of the torso's tilt below which it has fallen."""
_NOISE = 0.05
"""rad; the hinges' angles at the start are drawn from within."""


class WalkerEnv(gymnasium.Env[NDArray[np.float64], NDArray[np.float32]]):
    """One walker on an endless floor, which shall get forward fast and with little energy.

    Observation ``[46]``: height of the torso over its height in standing, its up and forward axes (world frame), its
    velocity (m/s), its angular velocity (rad/s), its distance to the line (m), angles of the hinges within their ranges
    (-1 to 1), their rates (a tenth, rad/s) and which feet touch the floor.

    Action ``[15]``: torques as shares of their limits.

    Reward of a step: 0.5 + forward speed (m/s) - 0.1 mechanical power / (body weight x 1 m/s). An episode ends where
    the torso falls, and is truncated after `steps` steps.

    Args:
        figure: the walker's measures.
        steps: control steps of an episode.
        hand: gain of the whole helping hand, 1/s^2.
        recorder: keeps the frames of each episode, from the last `reset` on.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - gymnasium declares it so
    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (16 + 2 * len(HINGES),), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(HINGES),), np.float32)

    def __init__(self, figure: Figure, *, steps: int, hand: float = GAIN, recorder: WalkRecorder | None = None) -> None:
        self.world = WalkerWorld(figure, speed=SPEED, gain=hand)
        self.steps = steps
        self.recorder = recorder
        self._unused = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Upright at the origin, hinges up to 0.05 rad off; `options["level"]` of the help is withdrawn (all: 1)."""
        super().reset(seed=seed)
        options = options or {}
        if options.get("fresh") and not self._unused:
            self.world.rebuild()
        self._unused = False
        level = options.get("level")
        self.world.level = 1.0 if level is None else float(level)
        angles = np.clip(self.np_random.uniform(-_NOISE, _NOISE, len(HINGES)), LOW, HIGH)
        self.world.place(angles, [0.0, self.world.figure.height, 0.0])
        self._elapsed = 0
        self._energy = 0.0
        if self.recorder is not None:
            self.recorder.start(self.world)
        return self._observation()[0], {}

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        """One control step."""
        torques = TORQUE * np.clip(action, -1.0, 1.0)
        self.world.advance(torques)
        self._elapsed += 1
        if self.recorder is not None:
            self.recorder.add(self.world, torques)
        observation, rates, fallen = self._observation()
        power = float(np.abs(torques * rates).sum()) / (self.world.figure.mass * WEIGHT)
        self._energy += power
        reward = ALIVE + float(observation[7]) - ENERGY * power
        over = self._elapsed >= self.steps
        info: dict[str, Any] = {}
        if fallen or over:
            distance = self.world.root()[0][0]
            info = {
                "success": not fallen,
                "metrics": {
                    "speed": distance / (self._elapsed * CONTROL),
                    "power": self._energy / self._elapsed,
                },
            }
        return observation, reward, fallen, over and not fallen, info

    def _observation(self) -> tuple[NDArray[np.float64], Array, bool]:
        """The observation, the hinges' rates (rad/s), and whether the torso has fallen."""
        world = self.world
        (_, height, aside), (x, y, z, w), velocity, spin = world.root()
        angles, rates = world.joints()
        touching = world.touching()
        up = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
        ahead = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
        share = height / world.figure.height
        trunk = [share, *up, *ahead, *velocity, *spin, aside]
        feet = [float(foot in touching) for foot in FEET]
        observation = np.concatenate([trunk, (2 * angles - LOW - HIGH) / (HIGH - LOW), 0.1 * rates, feet])
        # a world that has blown up gives NaN, for which no comparison holds: the episode goes on, the learner says so
        return observation, rates, share < _FALLEN or up[1] < _TILTED

    def close(self) -> None:
        """Free the world."""
        self.world.close()
