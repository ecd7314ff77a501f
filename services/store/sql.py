"""The trial database on SQLite or PostgreSQL."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy import Engine

from services.store.engine import begin_write, translated
from services.store.port import Change
from services.store.reads import Reads
from services.store.studies import StudyTransitions
from services.store.trials import TrialTransitions


class SqlChange(StudyTransitions, TrialTransitions):
    """All transitions, within one transaction."""


class SqlStore(Reads):
    """A trial database behind SQLAlchemy; open it with `services.store.open.open_store`.

    Threads may share it. A database that can't be reached, written or read raises `DatabaseUnavailable` from
    whatever was tried. One that goes away during a commit leaves open whether that commit was made: whoever
    goes on reads before it writes again.
    """

    def __init__(self, engine: Engine) -> None:
        super().__init__(engine)
        self.url = engine.url.render_as_string(hide_password=False)
        # Threads of one process wait here, in order, and not in SQLite's busy handler, which sleeps and tries again.
        self._writing = threading.Lock()
        self._writer: int | None = None

    @contextmanager
    def transaction(self) -> Iterator[Change]:
        """One durable commit for all transitions made inside; an exception that leaves the block undoes all."""
        if self._writer == threading.get_ident():
            raise RuntimeError("expected no open transaction in this thread, found one; end it before the next")
        with self._writing, translated(self._engine.url), self._engine.connect() as connection:
            self._writer = threading.get_ident()
            try:
                begin_write(connection)
                change = SqlChange(connection)
                try:
                    yield change
                    change.flush()
                finally:
                    change.end()
                connection.commit()
            finally:
                self._writer = None

    def close(self) -> None:
        """Let go of all connections."""
        self._engine.dispose()
