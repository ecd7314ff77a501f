"""Settings of the task, checked."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from workers.contracts import JSON, ParameterSpec
from workers.learning.settings import (
    Budget,
    NetworkSettings,
    PPOSettings,
    Rule,
    TrainingSettings,
    refuse_unknown,
    setting,
)
from workers.tasks.imitation import reference

SECTION = "task.settings"

TRAINING = TrainingSettings(
    budget=Budget(samples=2_000_000),
    network=NetworkSettings(hidden=(256, 128)),
    ppo=PPOSettings(
        environments=8,
        samples=2048,
        minibatch=256,
        epochs=5,
        clip=0.2,
        actor_rate=1e-4,
        critic_rate=1e-3,
        weight_decay=5e-4,
        gamma=0.95,
        sigma_start=0.4,
        sigma_end=0.1,
        sigma_iterations=300,
    ),
)
"""Training settings where a study gives none."""

SPACE: Mapping[str, ParameterSpec] = {
    "ppo.minibatch": ParameterSpec("int", 32, 1024, log=True),
    "ppo.epochs": ParameterSpec("int", 1, 10),
    "ppo.actor_rate": ParameterSpec("float", 2.5e-6, 2.5e-4, log=True),
    "ppo.critic_rate": ParameterSpec("float", 1e-4, 1e-2, log=True),
    "ppo.weight_decay": ParameterSpec("float", 5e-4, 5e-2, log=True),
    "ppo.clip": ParameterSpec("float", 0.02, 0.2),
    "ppo.grad_norm": ParameterSpec("float", 1.0, 100.0, log=True),
}
"""Table 6.2 of the thesis (Yang 2021)."""

SHORTEST, LONGEST = 30, 600
"""Control steps (1/30 s) of an episode at difficulties 0 and 1."""


def steps_at(z: float, longest: int = LONGEST) -> int:
    """T(z) = 30 + 570 z, or less where the longest episodes are shorter."""
    return round(SHORTEST + (longest - SHORTEST) * z)


@dataclass(frozen=True, slots=True)
class ImitationSettings:
    """What a study may set of the imitation.

    Args:
        clip: a packaged clip (`walk`, `run`, `backflip`, ...), or the path of a file in the DeepMimic form.
        threshold: return per step at which a motion counts as learnt, and the training ends.
        patience: iterations without a higher return after which the training ends.
        cost_scale: C, samples after which the same motion is worth 1/e.
        lead: seconds that the targets an action corrects are ahead of the reference: PD controllers lag by 0.1 s, their
            damping over their stiffness.
        bound: m that the centre of mass may be from the reference's; an episode ends beyond it (early termination by
            loose bounds in space and time, Ma et al. 2021). Tight ones keep samples for what can still be followed.
        bound_turn: rad that the root may be turned away from the reference's.
        growth: control steps that episodes get longer by after an iteration in which fewer than 20 % failed.
        longest: control steps of an episode at difficulty 1, 20 s where not given.
        episodes: how many evaluations the value is the mean of.
        budget: share of the training's budget that a training at difficulty 0 has.
    """

    clip: str = dataclasses.field(default="walk", metadata={"rule": Rule("path")})
    threshold: float = setting(0.8, Rule("float", 0.0, 1.0, open_low=True))
    patience: int = setting(500, Rule("int", 1))
    cost_scale: float = setting(1e7, Rule("float", 0.0, open_low=True))
    lead: float = setting(0.0, Rule("float", 0.0, 1.0))
    bound: float = setting(1.0, Rule("float", 0.0, 100.0, open_low=True))
    bound_turn: float = setting(math.pi, Rule("float", 0.0, math.pi, open_low=True))
    growth: int = setting(15, Rule("int", 1, LONGEST))
    longest: int = setting(LONGEST, Rule("int", SHORTEST, LONGEST))
    episodes: int = setting(4, Rule("int", 1, 100))
    budget: float = setting(0.25, Rule("float", 0.0, 1.0, open_low=True))

    @classmethod
    def parse(cls, settings: Mapping[str, JSON]) -> ImitationSettings:
        """The settings over their defaults. Raises `BadSetting` naming the field, what was expected and found."""
        rules: dict[str, Rule] = {f.name: f.metadata["rule"] for f in dataclasses.fields(cls)}
        refuse_unknown(SECTION, "", settings, rules)
        values: dict[str, Any] = {key: rules[key].read(SECTION, key, value) for key, value in settings.items()}
        parsed = cls(**values)
        reference.find(parsed.clip)
        return parsed

    def to_json(self) -> dict[str, JSON]:
        """All settings, defaults written out."""
        return dataclasses.asdict(self)
