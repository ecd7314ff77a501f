"""The surrogates of a study, fitted as its own strategy fits them, or for looking only where it has none."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Literal

import numpy as np

from search.bds.default import DiversityModel, fit_models
from search.quality.cmfbo import CMFBO
from search.quality.model import ValueModel, fit_values
from search.record import Record
from search.space import Array, Space
from search.strategy import Strategy
from search.surrogate.gp import GaussianProcess, IllConditioned
from search.surrogate.threads import one_thread

Subject = Literal["value", "behaviour"]

MODELS_BEHAVIOUR = frozenset({"bds", "novelty"})
"""Strategies whose surrogate is of the behaviour."""
MODELS_VALUE = frozenset({"cmfbo", "gp_ucb", "boca"})
"""Strategies whose surrogate is of the value."""
EVEN = 0.5
"""Probability from which a surrogate is the likelier of two."""


class Surrogates:
    """What is believed of a study's value and behaviour. Each is fitted when it is first asked for.

    Args:
        strategy: of the study; its space and features are the study's.
        record: what is known.
    """

    def __init__(self, strategy: Strategy, record: Record) -> None:
        self.strategy = strategy
        self.space: Space = strategy.space
        self.record = record

    @property
    def subject(self) -> Subject:
        """What the study's own search learns."""
        if self.strategy.name in MODELS_BEHAVIOUR:
            return "behaviour"
        if self.strategy.name in MODELS_VALUE or self.strategy.features is None or not self.strategy.uses_features:
            return "value"
        return "behaviour"

    def models(self, subject: Subject) -> bool:
        """Whether the study's strategy proposes from a surrogate of that output."""
        return self.strategy.name in (MODELS_VALUE if subject == "value" else MODELS_BEHAVIOUR)

    def is_own(self, subject: Subject) -> bool:
        """Whether it proposes from the one that is shown (and not from a published form of its own)."""
        return self.models(subject) and getattr(self.strategy.settings, "variant", "default") == "default"

    @property
    def has_values(self) -> bool:
        """Whether a trial is complete and has a value."""
        return bool((self.record.complete & ~np.isnan(self.record.value)).any())

    @property
    def has_behaviours(self) -> bool:
        """Whether a behaviour is known."""
        return bool(self.record.known.any())

    @cached_property
    def values(self) -> tuple[ValueModel, ValueModel | None, float]:
        """Of the value: over parameters and difficulty; at z = 1 alone, or None; how likely the first is the better.

        Failures count as the worst value seen. Only `cmfbo` holds a model of z = 1 alone against the other.
        """
        d = self.space.d
        length = 0.5 * math.sqrt(d / 2 if self.strategy.name in {"gp_ucb", "boca"} else max(1.0, d / 2))
        with quietly():
            if isinstance(self.strategy, CMFBO) and self.is_own("value"):
                return self.strategy.surrogates(self.record)
            return ValueModel(self.space, self.record, fit_values(self.space, self.record, length, 1.0)), None, 1.0

    def value_at(self, z: float) -> ValueModel:
        """The likelier surrogate of the value at a difficulty; below 1 the one that knows of difficulties."""
        joint, alone, probability = self.values
        return joint if alone is None or z < 1 or probability >= EVEN else alone

    @cached_property
    def behaviour(self) -> DiversityModel:
        """Of behaviour and feasibility over the parameters."""
        with quietly():
            fitted = fit_models(self.space, self.strategy.metric, self.record)
            return DiversityModel(self.space, self.strategy.metric, self.record, fitted, feasibility=True)

    def process(self, subject: Subject, z: float = 1.0) -> GaussianProcess:
        """The Gaussian process behind a surrogate; of the value, at difficulty z."""
        return self.value_at(z).gp if subject == "value" else self.behaviour.behaviour

    def lengths(self, subject: Subject) -> Array:
        """Length scale of each parameter, ``d``, in ranges of the parameter (unit coordinates)."""
        w = self.process(subject).w
        return np.array([1 / w[self.space.owner.index(p)] for p in range(self.space.d)])


@contextmanager
def quietly() -> Iterator[None]:
    """One thread, and no warning of ill-conditioned data: the proposals' own record tells of that."""
    with one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore", IllConditioned)
        yield
