"""Settings of the high jump and of the obstacle jump, checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from workers.contracts import BadSetting, ParameterSpec, Scalar
from workers.learning.settings import Budget, NetworkSettings, PPOSettings, Rule, TrainingSettings, setting
from workers.tasks.high_jump import rules, takeoff
from workers.tasks.high_jump.jump_settings import SECTION, JumpSettings, Levels, pose_model
from workers.tasks.high_jump.takeoff import TakeOff

__all__ = ["TRAINING", "HighJumpSettings", "ObstacleJumpSettings", "pose_model"]

TRAINING = TrainingSettings(
    budget=Budget(samples=100_000),
    network=NetworkSettings(hidden=(256, 128)),
    ppo=PPOSettings(environments=4, samples=400),
)
"""Training settings where a study gives none. With four environments inference is cheap enough, and rebuilding too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HighJumpSettings(JumpSettings):
    """What a study may set of the high jump, beside what `JumpSettings` has.

    Args:
        time_to_bar: the bar stands where the athlete gets in so many seconds, which should be about the highest point.
        first_bar: where the curriculum begins, m.
        lowest_bar: a jump over a lower bar counts for nothing: it can be stepped over, and every style can, m.
        bar_step: one step of the curriculum, m.
        highest_bar: the highest that is tried; mastered, the training ends, m.
    """

    task: ClassVar[str] = "high_jump"
    parameters: ClassVar[Mapping[str, ParameterSpec]] = takeoff.PARAMETERS
    time_to_bar: float = setting(0.35, Rule("float", 0.1, 2.0))
    first_bar: float = setting(0.2, Rule("float", 0.1, 2.5))
    lowest_bar: float = setting(0.4, Rule("float", 0.0, 2.5))
    bar_step: float = setting(0.02, Rule("float", 0.001, 0.5))
    highest_bar: float = setting(2.5, Rule("float", 0.1, 2.9))

    def check(self) -> None:
        """Refuse settings that don't go together (`BadSetting`)."""
        JumpSettings.check(self)
        self.check_levels("first_bar", "lowest_bar", "highest_bar")

    @property
    def levels(self) -> Levels:
        """The bars."""
        last = self.highest_bar if self.z_freeze is None else self.z_freeze
        return Levels(self.first_bar, self.lowest_bar, self.bar_step, last, self.highest_bar)

    def hardness(self, level: float) -> float:
        """How hard a bar is, from 0 to 1."""
        return rules.hardness_of_bar(level)

    def take_off(self, params: Mapping[str, Scalar]) -> TakeOff:
        """The take-off state of a candidate under these settings."""
        return TakeOff(
            **self.values_of(params),
            forward=self.forward_speed,
            rise=self.upward(),
            time_to_bar=self.time_to_bar,
            formulation=self.formulation,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstacleJumpSettings(JumpSettings):
    """What a study may set of the obstacle jump, beside what `JumpSettings` has.

    Args:
        height: of the obstacle, m; 0 makes it a long jump, over a line that must not be trodden on.
        first_height: of the narrowest obstacle, m, from which it rises to `height`: over half a metre at once nothing
            is learnt.
        full_width: from which on the obstacle has its whole height, m.
        gap: from the athlete's root at the start to the obstacle, m.
        first_width: where the curriculum begins, m.
        lowest_width: a jump over a narrower obstacle counts for nothing, m; at least `full_width`.
        width_step: one step of the curriculum, m.
        highest_width: the widest that is tried; mastered, the training ends, m.
    """

    task: ClassVar[str] = "obstacle_jump"
    parameters: ClassVar[Mapping[str, ParameterSpec]] = takeoff.SPINS
    forward_speed: float = setting(3.8, Rule("float", 0.0, 10.0))
    mat_height: float = setting(0.02, Rule("float", 0.01, 1.0))
    height: float = setting(0.5, Rule("float", 0.0, 2.0))
    first_height: float = setting(0.1, Rule("float", 0.0, 2.0))
    full_width: float = setting(0.3, Rule("float", 0.05, 5.0))
    gap: float = setting(0.9, Rule("float", 0.3, 3.0))
    first_width: float = setting(0.05, Rule("float", 0.05, 5.0))
    lowest_width: float = setting(0.3, Rule("float", 0.05, 5.0))
    width_step: float = setting(0.05, Rule("float", 0.001, 0.5))
    highest_width: float = setting(2.5, Rule("float", 0.05, 5.0))

    def check(self) -> None:
        """Refuse settings that don't go together (`BadSetting`)."""
        JumpSettings.check(self)
        if self.lowest_width < self.full_width:
            raise BadSetting(
                SECTION,
                "lowest_width",
                f"expected at least full_width, which is {self.full_width:g}, found {self.lowest_width:g}",
            )
        self.check_levels("first_width", "lowest_width", "highest_width")

    @property
    def levels(self) -> Levels:
        """The widths."""
        last = self.highest_width if self.z_freeze is None else self.z_freeze
        return Levels(self.first_width, self.lowest_width, self.width_step, last, self.highest_width)

    @property
    def obstacle(self) -> Callable[[float], float]:
        """Height of the obstacle by its width, m."""
        return self.height_at

    def height_at(self, width: float) -> float:
        """Height of an obstacle of this width, m: it rises with the width until it is whole."""
        if width >= self.full_width:
            return self.height
        low = min(self.first_height, self.height)
        part = (width - self.first_width) / (self.full_width - self.first_width)
        return float(low + (self.height - low) * np.clip(part, 0, 1))

    def hardness(self, level: float) -> float:
        """How hard a width is, from 0 to 1: in proportion to the widest of the published ones."""
        return float(np.clip(level / _WIDEST, 0, 1))

    def take_off(self, params: Mapping[str, Scalar]) -> TakeOff:
        """The take-off state of a candidate under these settings: a straight run at the obstacle."""
        return TakeOff(
            **self.values_of(params),
            alpha=np.pi / 2,
            v_z=0.0,
            forward=self.forward_speed,
            rise=self.upward(),
            time_to_bar=0.0,
            formulation=self.formulation,
            gap=self.gap,
        )


_WIDEST = 2.5
