"""What a study's value is called, and in which unit: a spec doesn't say, the results do."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import islice

from services.states import TrialState
from services.store.port import TrialRow

UNIT_OF_VALUE: Mapping[str, str] = {"bar": "m", "width": "m", "height": "m", "distance": "m"}
"""Units of what a task's value may be, by the name of the result that equals it."""

TELLING = 20
"""How many trials are looked at."""


@dataclass(frozen=True, slots=True)
class ValueWords:
    """Name and unit of a study's value.

    Args:
        name: such as `bar`; `value` where nothing tells more.
        unit: empty where it has none, or nobody said.
    """

    name: str = "value"
    unit: str = ""

    @property
    def title(self) -> str:
        """Both, as the title of an axis: `bar (m)`."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


def value_words(trials: Iterable[TrialRow]) -> ValueWords:
    """The words for the value, from the complete trials that come first: a named result that always equals it."""
    complete = (trial for trial in trials if trial.state is TrialState.COMPLETE and trial.value is not None)
    first = list(islice(complete, TELLING))
    for name, unit in UNIT_OF_VALUE.items():
        if first and all(trial.details.get(name) == trial.value for trial in first):
            return ValueWords(name, unit)
    return ValueWords()
