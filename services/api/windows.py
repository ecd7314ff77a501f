"""A window on the trials of a study: filtered, sorted, and only as many rows as a screen shows.

A study may have 50,000 trials; sorting them takes a tenth of a second and their JSON 30 MB, so both stay here.
"""

from __future__ import annotations

import math
import re
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import eq, ge, gt, le, lt, ne
from typing import Any

from services.api.tables import FinishedTrials
from services.errors import BadInput
from services.states import TrialState
from services.store.port import Store, StudyRow, TrialRow

Reader = Callable[[TrialRow], Any]

FIELDS: dict[str, Reader] = {
    "number": lambda trial: trial.number,
    "state": lambda trial: trial.state.value,
    "stage": lambda trial: trial.stage,
    "position": lambda trial: trial.position,
    "z": lambda trial: trial.z,
    "value": lambda trial: trial.value,
    "samples": lambda trial: trial.samples,
    "seconds": lambda trial: trial.seconds,
    "iteration": lambda trial: trial.iteration,
    "attempts": lambda trial: trial.attempts,
    "retries": lambda trial: trial.retries,
    "warm_start": lambda trial: trial.warm_start,
    "message": lambda trial: trial.message,
    "mode": lambda trial: trial.info.get("mode"),
    "text": lambda trial: f"{trial.state.value} {trial.stage} {trial.info.get('mode', '')} {trial.message}",
    "created_at": lambda trial: trial.created_at.timestamp(),
    "started_at": lambda trial: trial.started_at and trial.started_at.timestamp(),
    "finished_at": lambda trial: trial.finished_at and trial.finished_at.timestamp(),
}
"""What can be sorted and filtered by, beside `params.NAME`, `details.NAME` and `features.K`; `text` is all words."""

REMEMBERED = 16
"""Sorted and filtered lists that are kept: many people look at few of them, and each asks again as it scrolls."""

OPERATORS: dict[str, Callable[[Any, Any], bool]] = {"<=": le, ">=": ge, "!=": ne, "=": eq, "<": lt, ">": gt}
CONDITION = re.compile(r"\s*([^<>=!~]+?)\s*(<=|>=|!=|=|<|>|~)\s*(.*?)\s*", re.DOTALL)


def reader(field: str, what: str) -> Reader:
    """What reads a field of a trial.

    Args:
        field: its name.
        what: `sort` or `where`, for the message.

    Raises:
        BadInput: there is no such field.
    """
    if field in FIELDS:
        return FIELDS[field]
    group, _, name = field.partition(".")
    if group == "params" and name:
        return lambda trial: trial.params.get(name)
    if group == "details" and name:
        return lambda trial: trial.details.get(name)
    if group == "features" and name.isascii() and name.isdigit() and len(name) < 4:
        place = int(name)
        return lambda trial: trial.features[place] if trial.features and place < len(trial.features) else None
    raise BadInput(
        f"{what}: expected one of {', '.join(FIELDS)}, params.NAME, details.NAME or features.K, found {field!r}"
    )


@dataclass(frozen=True, slots=True)
class Condition:
    """One filter: a field, an operator, and what it is compared with.

    Args:
        read: reads the field.
        operator: `= != < <= > >=`, or `~` for text that contains.
        text: what was written.
        number: the same as a number, where it is one.
    """

    read: Reader
    operator: str
    text: str
    number: float | None

    @classmethod
    def parse(cls, text: str) -> Condition:
        """From `field operator value`. Raises `BadInput`."""
        found = CONDITION.fullmatch(text)
        if found is None:
            raise BadInput(
                f"where: expected FIELD OPERATOR VALUE such as value>=0.5 or message~diverged, found {text!r}"
            )
        field, operator, value = found.groups()
        try:
            number: float | None = float(value)
        except ValueError:
            number = None
        if number is None and operator in {"<", "<=", ">", ">="}:
            raise BadInput(f"where: expected a number after {operator}, found {value!r}")
        return cls(reader(field, "where"), operator, value, number)

    def holds(self, trial: TrialRow) -> bool:
        """Whether a trial passes. What a trial lacks passes `!=` only."""
        value = self.read(trial)
        if value is None:
            return self.operator == "!="
        if self.operator == "~":
            return self.text.casefold() in str(value).casefold()
        plain = isinstance(value, int | float) and not isinstance(value, bool)
        if plain and self.number is not None:
            return OPERATORS[self.operator](value, self.number)
        if self.operator in {"=", "!="}:
            written = str(value).lower() if isinstance(value, bool) else str(value)
            return (written == self.text) is (self.operator == "=")
        return False


def matching(
    trials: Sequence[TrialRow], states: Sequence[TrialState] | None, conditions: Sequence[str]
) -> list[TrialRow]:
    """The trials in these states for which all conditions hold. Raises `BadInput`."""
    parsed = [Condition.parse(text) for text in conditions]
    wanted = None if not states else frozenset(states)
    return [
        trial
        for trial in trials
        if (wanted is None or trial.state in wanted) and all(condition.holds(trial) for condition in parsed)
    ]


def ordered(trials: Sequence[TrialRow], sort: str) -> list[TrialRow]:
    """Trials by a field, descending with a `-` before it; equal ones by number, those without it at the end.

    Raises:
        BadInput: there is no such field.
    """
    descending = sort.startswith("-")
    read = reader(sort.removeprefix("-"), "sort")
    if sort == "number":
        return list(trials)
    keyed = [(_key(read(trial)), trial) for trial in trials]
    have = [pair for pair in keyed if pair[0] is not None]
    # stable both ways: `reverse` keeps the order of equals
    have.sort(key=lambda pair: pair[0], reverse=descending)  # type: ignore[arg-type,return-value]  # none is left
    return [trial for _, trial in have] + [trial for key, trial in keyed if key is None]


def _key(value: Any) -> tuple[int, float, str] | None:
    """What values of any kind can be sorted by: numbers first, then text."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return None
    if isinstance(value, int | float):
        return (0, float(value), "")
    return (1, 0.0, str(value))


@dataclass(frozen=True, slots=True)
class Found:
    """A table's rows, all of them.

    Args:
        cursor: the newest event that they reflect.
        history: identity of the database's history.
        count: trials of the study.
        trials: those that pass, in order.
    """

    cursor: int
    history: str
    count: int
    trials: Sequence[TrialRow]


class Finder:
    """Sorts and filters the trials of studies, once for everybody who looks at the same. Safe to use from threads.

    Args:
        store: the trial database.
        trials: the studies' finished trials.
    """

    def __init__(self, store: Store, trials: FinishedTrials) -> None:
        self._store = store
        self._trials = trials
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[object, ...], Found] = OrderedDict()

    def find(self, study: StudyRow, sort: str, states: Sequence[TrialState] | None, conditions: Sequence[str]) -> Found:
        """The trials of a study in these states for which all conditions hold, in order. Raises `BadInput`."""
        history = self._store.history_id()
        key = (history, study.id, sort, frozenset(states or ()), tuple(conditions))
        # One at a time: a hundred viewers of a study that grows would otherwise all sort what one of them sorts.
        with self._lock:
            # The cursor first: what happens while the rows are read is then read again, never missed.
            cursor = self._store.last_event()
            known = self._kept.pop(key, None)
            if known is None or known.cursor != cursor:
                everything = self._trials.all_trials(study)
                rows = ordered(matching(everything, states, conditions), sort)
                known = Found(cursor, history, len(everything), rows)
            self._kept[key] = known
            while len(self._kept) > REMEMBERED:
                self._kept.popitem(last=False)
            return known
