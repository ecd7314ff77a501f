"""What figures are drawn from: a study and its trials, as the record has them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Self

from services.errors import BadInput
from services.report import Finding, distinct_trials, spec_of
from services.spec import Behaviour, Parameter, ResolvedSpec
from services.states import OBSERVED_TRIAL
from services.store.port import MetricRow, Store, StudyRow, TrialRow
from services.value import ValueWords, value_words

if TYPE_CHECKING:
    from services.insight import Looked


def values_of(trials: Iterable[TrialRow]) -> list[float]:
    """The values of trials that have one."""
    return [trial.value for trial in trials if trial.value is not None]


def levels_of(trials: Iterable[TrialRow]) -> list[float]:
    """The difficulties of trials that have one."""
    return [trial.z for trial in trials if trial.z is not None]


@dataclass(frozen=True)
class Shown:
    """A study to be drawn.

    Args:
        row: the study.
        trials: all its trials, by number.
        metrics: reads the learning curve of a trial.

    Raises:
        BadInput: it has no space, or no trial of it has finished.
    """

    row: StudyRow
    trials: Sequence[TrialRow]
    metrics: Callable[[TrialRow], Sequence[MetricRow]]
    spec: ResolvedSpec = field(init=False)

    def __post_init__(self) -> None:
        spec = spec_of(self.row)
        if not isinstance(spec, ResolvedSpec):
            raise BadInput(f"study {self.row.name!r}: expected one with a space, found one that was never checked")
        object.__setattr__(self, "spec", spec)
        if not self.history:
            raise BadInput(
                f"study {self.row.name!r}: expected finished trials to draw, found none; "
                f"see how it is doing with `halma show {self.row.name}`"
            )

    @classmethod
    def of(cls, store: Store, name: str) -> Self:
        """The study of a name, from a trial database or from a service's (`services.remote_store`).

        Raises:
            UnknownStudy: there is none.
            BadInput: as above.
        """
        row = store.study(name)
        return cls(row, store.trials(row.id), lambda trial: store.metrics(trial.id))

    @cached_property
    def history(self) -> list[TrialRow]:
        """The finished trials, in order of position."""
        finished = [trial for trial in self.trials if trial.state in OBSERVED_TRIAL]
        return sorted(finished, key=lambda trial: trial.position or 0)

    @cached_property
    def valued(self) -> list[TrialRow]:
        """The finished trials that have a value, in order of position."""
        return [trial for trial in self.history if trial.value is not None]

    @cached_property
    def compared(self) -> list[TrialRow]:
        """Those of the real task where there are any: values of easier versions don't compare with its own."""
        return [trial for trial in self.valued if trial.z in {None, 1.0}] or self.valued

    @cached_property
    def value(self) -> ValueWords:
        """Name and unit of the value."""
        return value_words(self.trials)

    @property
    def behaviour(self) -> Behaviour | None:
        """What a behaviour is, None where it plays no part."""
        return self.spec.behaviour

    @property
    def space(self) -> dict[str, Parameter]:
        """What is searched over."""
        return dict(self.spec.space or {})

    def unit(self, name: str) -> str:
        """Unit of a parameter."""
        return self.spec.units.get(name, "rad" if self.space[name].type == "angle" else "")

    @cached_property
    def found(self) -> list[Finding]:
        """The distinct strategies, best first; none where behaviour plays no part."""
        return distinct_trials(self.row, self.history)

    @cached_property
    def looked(self) -> Looked:
        """The study's surrogates."""
        from services.insight import look  # noqa: PLC0415 - the searches, which bring scipy and more

        return look(self.row, self.history)
