"""Studies with their counts, read once as long as nothing happens: every page and answer begins with one."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass, field

from services.store.port import Store, StudyRow

REMEMBERED = 64
"""Studies that are kept."""


@dataclass(slots=True, eq=False)
class _Known:
    lock: threading.Lock = field(default_factory=threading.Lock)
    revision: tuple[str, int] | None = None
    row: StudyRow | None = None


class KnownStudies:
    """The studies last asked for. Safe to use from several threads.

    A study's row is read together with the counts of its trials, which takes milliseconds where it has 10,000 of
    them. It holds as long as no event has come. Only `drive_beat` rises without one: whoever watches a driver reads the
    store itself.

    Args:
        store: the trial database.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._lock = threading.Lock()
        self._known: OrderedDict[str, _Known] = OrderedDict()

    def study(self, name: str) -> StudyRow:
        """A study by name, as it was at the newest event or later. Raises `UnknownStudy`."""
        revision = (self._store.history_id(), self._store.last_event())
        with self._lock:
            known = self._known.setdefault(name, _Known())
            self._known.move_to_end(name)
            while len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        # Those who ask for the same study meanwhile wait for one reader.
        with known.lock:
            if known.row is None or known.revision != revision:
                known.row, known.revision = self._store.study(name), revision
            return known.row
