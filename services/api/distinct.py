"""Distinct strategies of studies, worked out once for each length of a history: many people look at the same."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from typing import TYPE_CHECKING

from services.store.port import Store, StudyRow, TrialRow

if TYPE_CHECKING:
    from services.report import Finding

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
                # The search's geometry comes with torch, which takes a second to import, once.
                from services.report import behaviour_of, distinct_trials  # noqa: PLC0415

                found = None if behaviour_of(study) is None else distinct_trials(study, history)
            self._known[key] = (len(history), found)
            while len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
            return found
