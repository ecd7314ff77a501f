"""The smallest jump: a point mass on a springless leg hops over a bar in the plane. It trains in about a second.

For demonstrations and tests of everything around a training. It has what the athletes have: a take-off state to search
over, a bar that rises while learning, a behaviour (which way the body faces as it passes the bar), take-off states from
which nothing can be learnt, and a difficulty.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from workers.contracts import JSON, BadSetting, Context, FeatureSpec, Job, Outcome, ParameterSpec, TaskInfo
from workers.learning.policy import Policy
from workers.learning.ppo import POLICY_ARTIFACT, train
from workers.learning.problem import SuccessCurriculum
from workers.learning.rollout import play
from workers.learning.settings import Budget, NetworkSettings, PPOSettings, TrainingSettings
from workers.novelty import Novelty

GRAVITY = 9.81  # m/s^2
LEG = 0.4  # m; the leg pushes while the mass is lower than this
PUSH = 15.0  # m/s^2; vertical push is PUSH * (1 + action), from 0 to 2 PUSH
SHOVE = 4.0  # m/s^2; horizontal push is SHOVE * action
STEP = 0.05  # s; one control step
TIME = 2.0  # s; the longest episode
FIRST_BAR, BAR_STEP = 0.3, 0.05  # m

DEFAULTS = TrainingSettings(
    Budget(samples=15_000),
    NetworkSettings((32, 32), "tanh"),
    PPOSettings(
        environments=16,
        samples=500,
        actor_rate=3e-3,
        critic_rate=3e-3,
        sigma_start=0.6,
        sigma_end=0.15,
        sigma_iterations=20,
    ),
)
_SETTINGS: Mapping[str, float] = {"bar": 1.0, "distance": 1.0}
_PARAMETERS = {
    "speed": ParameterSpec("float", 0.0, 4.0, unit="m/s"),
    "spin": ParameterSpec("float", -6.0, 6.0, unit="rad/s"),
    "lean": ParameterSpec("angle", unit="rad"),
}
_FEATURES = FeatureSpec("circle", ("facing",), distinct=0.5, unit="rad")


class Hop(gymnasium.Env[NDArray[np.float64], NDArray[np.float32]]):
    """One hop.

    Observations: horizontal position (m, the bar is at 0), height (m), both velocities (m/s), the bar's height (m).
    Actions: horizontal and vertical push, [-1, 1] each.

    Args:
        speed: of the run-up, m/s.
        spin: of the body, rad/s, constant.
        lean: of the body at the start, rad.
        distance: from the start to the bar, m.
        novelty: what it is to keep away from; only a hop that would count as another strategy then succeeds.
    """

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (5,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)

    def __init__(self, speed: float, spin: float, lean: float, distance: float, novelty: Novelty | None = None) -> None:
        self.novelty = novelty
        self.speed, self.spin, self.lean, self.distance = speed, spin, lean, distance
        self.x = self.y = self.vx = self.vy = self.t = self.bar = 0.0
        self.left = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """At the take-off, with up to 5 % of noise on the speed."""
        super().reset(seed=seed)
        self.x, self.y, self.vy, self.t, self.left = -self.distance, 0.0, 0.0, 0.0, False
        self.vx = self.speed * (1 + 0.05 * self.np_random.uniform(-1, 1))
        self.bar = FIRST_BAR if not options or options.get("level") is None else float(options["level"])
        return self._observation(), {}

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        """Constant acceleration for one control step, exactly integrated. Reward 1 for clearing the bar."""
        stands = self.y < LEG and not self.left
        ax = SHOVE * float(action[0]) if stands else 0.0
        ay = (PUSH * (1 + float(action[1])) if stands else 0.0) - GRAVITY
        x, y = self.x, self.y
        self.x += self.vx * STEP + 0.5 * ax * STEP**2
        self.y += self.vy * STEP + 0.5 * ay * STEP**2
        self.vx += ax * STEP
        self.vy += ay * STEP
        self.t += STEP
        if stands and self.y <= 0:
            self.y, self.vy = 0.0, 0.0
        self.left = self.left or self.y >= LEG
        if x < 0 <= self.x:
            share = -x / (self.x - x)
            height = y + share * (self.y - y)
            facing = _wrapped(self.lean + self.spin * (self.t - (1 - share) * STEP))
            success = height >= self.bar
            reward = float(success)
            metrics = {"height": height}
            if self.novelty is not None:
                metrics["novelty"] = self.novelty.factor((facing,))
                reward *= metrics["novelty"]
                success = success and self.novelty.is_new((facing,))
            info = {"success": success, "height": height, "facing": facing, "metrics": metrics}
            return self._observation(), reward, True, False, info
        over = self.t >= TIME or (self.left and self.y <= 0)
        return self._observation(), 0.0, over, False, {"success": False} if over else {}

    def _observation(self) -> NDArray[np.float64]:
        return np.array([self.x, self.y, self.vx, self.vy, self.bar])


class PointJump:
    """The task: take-off states in, height and facing of the learnt hop out."""

    def info(self, settings: Mapping[str, JSON]) -> TaskInfo:
        """Settings: `bar`, the height in m that difficulty 1 asks for; `distance` from take-off to bar, m."""
        return TaskInfo(
            "point_jump",
            "a point mass learns to hop over a bar, in about a second",
            _PARAMETERS,
            _FEATURES,
            has_difficulty=True,
            seeks_novelty=True,
            settings=_read(settings),
            training=DEFAULTS.to_json(),
        )

    def validate(self, settings: Mapping[str, JSON], training: Mapping[str, JSON], names: Sequence[str]) -> None:
        """Refuse what can't be (`BadSetting`)."""
        _read(settings)
        TrainingSettings.parse(training, DEFAULTS)
        for name in names:
            if name not in _PARAMETERS:
                raise BadSetting("space", name, f"expected one of {', '.join(_PARAMETERS)}")

    def run(self, job: Job, context: Context) -> Outcome:
        """Train, then hop once without exploration: its height over the bar's place is the value."""
        settings = _read(job.task_settings)
        problem = _Problem(job, settings)
        trained = train(job, context, problem, TrainingSettings.parse(job.training, DEFAULTS))
        context.save_artifact(POLICY_ARTIFACT, trained.policy.to_bytes())
        height, facing = _best(problem.make_env(), trained.policy, trained.level or FIRST_BAR, job)
        details = {
            "bar": trained.level,
            "iterations": trained.iterations,
            "mastered": trained.finished,
            **trained.lineage,
        }
        if height is None or facing is None:
            message = "the hop doesn't get as far as the bar"
            return Outcome("infeasible", cost=trained.cost, message=message, details=details)
        return Outcome("complete", height, (facing,), trained.cost, details=details)


class _Problem:
    """One take-off state, for the learner."""

    def __init__(self, job: Job, settings: Mapping[str, float]) -> None:
        given = {"speed": 2.0, "spin": 0.0, "lean": 0.0, **job.params}
        self._state = {name: float(given[name]) for name in _PARAMETERS}
        self._distance = settings["distance"]
        self._novelty = Novelty.of(job, _FEATURES)
        self._bar = FIRST_BAR + (settings["bar"] - FIRST_BAR) * (1.0 if job.z is None else job.z)

    def make_env(self) -> Hop:
        return Hop(**self._state, distance=self._distance, novelty=self._novelty)

    def curriculum(self) -> SuccessCurriculum:
        return SuccessCurriculum(FIRST_BAR, BAR_STEP, freeze=self._bar)


def _best(env: Hop, policy: Policy, level: float, job: Job) -> tuple[float | None, float | None]:
    """Height (m) and facing (rad) of the deterministic hop as it passes the bar, or Nones."""
    info = play(env, policy, seed=int(job.rng("evaluation").integers(2**31)), level=level).info
    return info.get("height"), info.get("facing")


def _read(settings: Mapping[str, JSON]) -> dict[str, float]:
    for name, value in settings.items():
        if name not in _SETTINGS:
            raise BadSetting("task.settings", name, f"expected one of {', '.join(_SETTINGS)}")
        if not isinstance(value, int | float) or isinstance(value, bool) or not FIRST_BAR <= value <= 3.0:
            raise BadSetting("task.settings", name, f"expected a number from {FIRST_BAR} to 3, found {value!r}")
    return {**_SETTINGS, **settings}


def _wrapped(angle: float) -> float:
    """Within (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2 * math.pi)
