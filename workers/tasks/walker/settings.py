"""Settings of the task, checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from workers.contracts import JSON
from workers.learning.settings import (
    Budget,
    NetworkSettings,
    PPOSettings,
    Rule,
    TrainingSettings,
    refuse_unknown,
    setting,
)
from workers.tasks.walker.body import PARAMETERS

SECTION = "task.settings"

TRAINING = TrainingSettings(
    budget=Budget(samples=200_000),
    network=NetworkSettings(hidden=(128, 64), activation="tanh"),
    ppo=PPOSettings(
        environments=8,
        samples=1000,
        minibatch=125,
        epochs=8,
        actor_rate=5e-4,
        critic_rate=1e-3,
        gamma=0.99,
        gae_lambda=0.98,
        sigma_start=0.5,
        sigma_end=0.2,
        sigma_iterations=100,
    ),
)
"""Training settings where a study gives none."""


@dataclass(frozen=True, slots=True)
class WalkerSettings:
    """What a study may set of the walker.

    Args:
        steps: control steps (1/60 s) of an evaluation, whose mean reward is the value.
        training_steps: control steps of a training's episodes at the most.
        episodes: how many evaluations the value is the mean of.
        hand: gain of the whole helping hand, kp in 1/s^2 (and kd in 1/s): 200 as published. Most bodies are carried
            above 40 or so, whatever they do, so that easy levels mislead about bodies; with 4 they don't.
        withdrawal: how much of the help is withdrawn after an iteration in which half the episodes did not fall; twice
            that above 0.8, five times above 0.9.
        deadline: share of the budget after which all is withdrawn that the difficulty withdraws, step by step, whether
            the walker falls or not: what is left is for learning what is asked for.
        budget: share of the training's budget that a training at difficulty 0 has.
    """

    steps: int = setting(500, Rule("int", 1, 10_000))
    training_steps: int = setting(200, Rule("int", 1, 10_000))
    episodes: int = setting(4, Rule("int", 1, 100))
    hand: float = setting(200.0, Rule("float", 0.0, 1000.0, open_low=True))
    withdrawal: float = setting(0.02, Rule("float", 0.0, 1.0, open_low=True))
    deadline: float = setting(0.5, Rule("float", 0.0, 1.0, open_low=True))
    budget: float = setting(0.25, Rule("float", 0.0, 1.0, open_low=True))

    @classmethod
    def parse(cls, settings: Mapping[str, JSON]) -> WalkerSettings:
        """The settings over their defaults. Raises `BadSetting` naming the field, what was expected and found."""
        rules: dict[str, Rule] = {f.name: f.metadata["rule"] for f in dataclasses.fields(cls)}
        refuse_unknown(SECTION, "", settings, rules)
        values: dict[str, Any] = {key: rules[key].read(SECTION, key, value) for key, value in settings.items()}
        return cls(**values)

    def to_json(self) -> dict[str, JSON]:
        """All settings, defaults written out."""
        return dataclasses.asdict(self)


def check_parameters(names: Iterable[str]) -> None:
    """Refuse parameter names that are none of the body's (`BadSetting`)."""
    refuse_unknown("space", "", names, PARAMETERS)
