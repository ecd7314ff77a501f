"""What a strategy is: a function from the record of a study to what to try next."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from search import settings as setting_rules
from search.errors import BadCount, BadSetting
from search.features import Features
from search.record import Candidate, Observation, Record, read_record
from search.settings import SettingInfo
from search.space import Array, Space


@dataclass(frozen=True, slots=True)
class NoSettings:
    """A strategy with nothing to set."""


@dataclass(frozen=True, slots=True)
class StrategyInfo:
    """A strategy as listings show it.

    Args:
        name: as study files write it.
        summary: one line.
        settings: in order.
        uses_features: whether it needs behaviours (`Features`, and features with every complete observation).
        uses_z: whether it chooses difficulties.
        uses_values: whether it needs a value with every complete observation.
        extra: optional package it needs, or None.
    """

    name: str
    summary: str
    settings: tuple[SettingInfo, ...]
    uses_features: bool
    uses_z: bool
    uses_values: bool
    extra: str | None = None


class Strategy(ABC):
    """A strategy. It keeps no state that matters: equal arguments give equal proposals, in any process, on any day.

    Example, with a trial still running::

        strategy = make_strategy("bds", space, features=Features.circle())
        first, second = strategy.propose([], [], count=2, rng=rng_0)
        history = [Observation(second, value=1.0, features=[0.3])]  # the second one was faster
        (third,) = strategy.propose(history, [first], count=1, rng=rng_1)  # knows what was found and what runs

    Args:
        space: what to search over.
        features: what a behaviour is, or None where it plays no part.
        settings: plain data, validated against `Settings`.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    uses_features: ClassVar[bool] = False
    uses_z: ClassVar[bool] = False
    uses_values: ClassVar[bool] = False
    extra: ClassVar[str | None] = None
    Settings: ClassVar[type] = NoSettings

    def __init__(
        self, space: Space, features: Features | None = None, settings: Mapping[str, Any] | None = None
    ) -> None:
        self.space = space
        self.features = features
        if self.uses_features:
            _ = self.metric
        self.settings: Any = setting_rules.parse(self.Settings, settings or {}, self.name)

    @property
    def metric(self) -> Features:
        """The feature space of a strategy that uses one.

        Raises:
            BadSetting: none was given.
        """
        if self.features is None:
            raise BadSetting(self.name, "features", "expected a feature space (Features), found None")
        return self.features

    @classmethod
    def info(cls) -> StrategyInfo:
        """What listings show."""
        return StrategyInfo(
            cls.name,
            cls.summary,
            setting_rules.describe(cls.Settings),
            cls.uses_features,
            cls.uses_z,
            cls.uses_values,
            cls.extra,
        )

    def propose(
        self,
        history: Sequence[Observation],
        pending: Sequence[Candidate],
        count: int,
        rng: np.random.Generator,
    ) -> list[Candidate]:
        """What to try next.

        Args:
            history: what came of finished trials, in the order of finishing.
            pending: candidates that were proposed and have not finished.
            count: how many candidates are wanted, at least 1.
            rng: all randomness of the proposal.

        Returns:
            `count` candidates; fewer, or none, only where a cost budget or a finite design is used up.

        Raises:
            BadCount: fewer than one was asked for.
            BadHistory: an observation or a pending candidate that can't be learnt from.
        """
        if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 1:
            raise BadCount(f"expected a count of at least 1, found {count!r}")
        record = read_record(
            self.space,
            self.features,
            history,
            pending,
            needs_value=self.uses_values,
            needs_features=self.uses_features,
        )
        return self.propose_from(record, int(count), rng)

    def recommend(self, history: Sequence[Observation]) -> int | None:
        """The index in the history of the best answer so far: highest value among complete trials of the real task.

        Trials at a difficulty below 1 are no answers. None where there is nothing yet. The history is not checked: it
        is what `propose` has accepted.
        """
        best, best_value = None, -math.inf
        for i, o in enumerate(history):
            if o.status != "complete" or o.value is None or o.candidate.z not in {None, 1}:
                continue
            if best is None or o.value > best_value:
                best, best_value = i, o.value
        return best

    @abstractmethod
    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:
        """`propose` on checked arrays; what a strategy of one's own defines.

        Args:
            record: history and pending trials, ``n`` and ``m`` of them, in unit coordinates ``d``.
            count: how many candidates are wanted, at least 1.
            rng: all randomness of the proposal.

        Returns:
            At most `count` candidates.
        """

    def candidate(self, unit: Array, **info: Any) -> Candidate:
        """A candidate without difficulty from ``d`` unit coordinates."""
        return Candidate(self.space.from_unit(unit), info=info)
