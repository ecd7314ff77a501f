"""Distinct strategies of studies, worked out once for each length of a history: many people look at the same."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from typing import TYPE_CHECKING

from services.store.port import Store, StudyRow, TrialRow

if TYPE_CHECKING:
    from services.report import Finding

MOST_STEPS = 100
"""Trials that are added one by one; more of them are grouped faster together with all others."""
REMEMBERED = 256
"""Studies whose strategies are kept."""


class Distinct:
    """The strategies of studies. Safe to use from several threads.

    Args:
        store: the trial database.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._known: OrderedDict[tuple[str, int], tuple[int, list[Finding] | None]] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, study: StudyRow, history: Sequence[TrialRow]) -> list[Finding] | None:
        """The strategies, best first; None where behaviour plays no part."""
        key = (self._store.history_id(), study.id)
        # One at a time: those who ask for the same meanwhile find it when the first one is done.
        with self._lock:
            length, found = self._known.pop(key, (-1, None))
            if length != len(history):
                # The search's geometry: a server that nobody asks need not load it.
                from services.report import behaviour_of, distinct_trials, distinct_with  # noqa: PLC0415

                if behaviour_of(study) is None:
                    found = None
                elif found is None or not 0 < len(history) - length <= MOST_STEPS:
                    found = distinct_trials(study, history)
                else:
                    for trial in history[length:]:
                        found = distinct_with(study, found, trial)
                        if found is None:
                            found = distinct_trials(study, history)
                            break
            self._known[key] = (len(history), found)
            while len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
            return found
