"""Settings of a Gymnasium environment as a task, checked against the arguments of its constructor."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

from workers.contracts import JSON, BadSetting, FeatureSpec
from workers.learning.settings import Budget
from workers.tasks.features import declared_features
from workers.user_code import suggestion

SECTION = "task.settings"


@dataclass(frozen=True, slots=True)
class Difficulty:
    """What z stands for: a constructor argument, from low to high, and how much of the budget a training gets.

    Args:
        argument: of the constructor; None where z changes none (but for an argument that is called `z`).
        low, high: its values at z = 0 and z = 1.
        budget: share of the training's budget at z = 0. Without it (1) a training costs the same at every difficulty.
    """

    argument: str | None
    low: float
    high: float
    budget: float = 1.0

    def at(self, z: float) -> float:
        """The argument's value."""
        return self.low + z * (self.high - self.low)

    def part_of(self, budget: Budget, z: float) -> Budget:
        """The budget of a training at difficulty z, at least one sample and one iteration."""
        return budget.part(self.budget + z * (1 - self.budget))


@dataclass(frozen=True, slots=True)
class EnvironmentSettings:
    """The task's settings.

    Args:
        arguments: of the environment's constructor.
        difficulty: None where z means nothing, or only what a constructor argument `z` makes of it.
        episodes: how many deterministic ones the value is the mean of.
        max_episode_steps: time limit, None for the environment's own.
        rebuild: whether each iteration begins with new environments. Without it a training is faster where they are
            slow to make, but resumes bit by bit only if `reset` forgets everything.
        features: what `info["features"]` at the end of an episode means; None where behaviour plays no part.
    """

    arguments: Mapping[str, JSON]
    difficulty: Difficulty | None
    episodes: int
    max_episode_steps: int | None
    rebuild: bool
    features: FeatureSpec | None


class Arguments:
    """What an environment's constructor takes.

    Args:
        make: the constructor.
    """

    def __init__(self, make: Callable[..., Any]) -> None:
        parameters = [p for p in inspect.signature(make).parameters.values() if p.name not in {"self", "render_mode"}]
        self.names = {p.name for p in parameters if p.kind in {p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY}}
        self.needed = {p.name for p in parameters if p.default is p.empty and p.name in self.names}
        self._any = any(p.kind is p.VAR_KEYWORD for p in parameters)

    def check(self, field: str, name: str, section: str = SECTION) -> None:
        """Refuse a name that the constructor doesn't take (`BadSetting`)."""
        if name not in self.names and not self._any:
            known = ", ".join(sorted(self.names)) or "none"
            raise BadSetting(section, field, f"the environment's constructor has no argument {name!r}; it has {known}")


def read_settings(settings: Mapping[str, JSON], taken: Arguments) -> EnvironmentSettings:
    """The settings over their defaults. Raises `BadSetting` naming the field, what was expected and found."""
    known = [f.name for f in fields(EnvironmentSettings)]
    for key in settings:
        if key not in known:
            raise BadSetting(SECTION, key, f"unknown setting{suggestion(key, known)}")
    arguments = settings.get("arguments") or {}
    if not isinstance(arguments, Mapping):
        raise BadSetting(SECTION, "arguments", f"expected a mapping, found {arguments!r}")
    for name in arguments:
        taken.check("arguments", name)
    rebuild = settings.get("rebuild", True)
    if not isinstance(rebuild, bool):
        raise BadSetting(SECTION, "rebuild", f"expected true or false, found {rebuild!r}")
    limit = settings.get("max_episode_steps")
    return EnvironmentSettings(
        arguments,
        _difficulty(settings.get("difficulty"), taken),
        _count("episodes", settings.get("episodes", 10)),
        None if limit is None else _count("max_episode_steps", limit),
        rebuild,
        declared_features(settings),
    )


def _difficulty(given: JSON, taken: Arguments) -> Difficulty | None:
    if given is None:
        return None
    keys = set(given) if isinstance(given, Mapping) else set()
    if keys not in ({"argument", "low", "high"}, {"argument", "low", "high", "budget"}, {"budget"}):
        raise BadSetting(
            SECTION,
            "difficulty",
            f"expected a mapping with argument, low and high, with budget (a share), or with both, found {given!r}",
        )
    if "argument" in given:
        taken.check("difficulty.argument", given["argument"])
        for key in ("low", "high"):
            if not _is_finite(given[key]):
                raise BadSetting(SECTION, f"difficulty.{key}", f"expected a number, found {given[key]!r}")
    share = given.get("budget", 1.0)
    if not (_is_finite(share) and 0 < share <= 1):
        raise BadSetting(SECTION, "difficulty.budget", f"expected a share above 0 and at most 1, found {share!r}")
    low, high = (float(given.get(key, 0.0)) for key in ("low", "high"))
    return Difficulty(given.get("argument"), low, high, float(share))


def _is_finite(value: JSON) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _count(field: str, value: JSON) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise BadSetting(SECTION, field, f"expected a whole number of at least 1, found {value!r}")
    return value
