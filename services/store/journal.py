"""The ground that all transitions stand on: one open transaction, and the events that will be appended to it.

Events, and what their payload holds (`trial` is the trial's number; studies' own events have none):

| kind | of | payload |
| --- | --- | --- |
| `created` | study | `study` (name), `target_trials` |
| `asked` | study | `wanted`, `state` (after it) |
| `extended` | study | `trials`, `cost` (more of it), `state` |
| `driven` | study | `driver`, `host`, `pid`, `token` |
| `released` | study | `state`, `reason` |
| `deleted` | study | `study` (name) |
| `proposed` | study | `proposal` (id), `strategy`, `trials` (numbers) |
| `started` | trial | `attempt`, `worker`, `host` |
| `began` | trial | `attempt`, `host`, `pid` of the worker process |
| `progress` | trial | `attempt`, `iteration`, `metrics`, `samples`, `seconds` |
| `lost`, `failed`, `preempted` | trial | `attempt`, `reason`, `retries`; the trial is queued again |
| `finished` | trial | `state`, `position`, `value`, `features`, `samples`, `seconds`, `message`, `attempt`; final |
"""

from __future__ import annotations

from typing import Any

from sqlalchemy import Connection, bindparam, select

from services.errors import Refused, UnknownStudy
from services.store.port import JSON
from services.store.reads import nearest
from services.store.rows import STUDY, clean, encode, now
from services.store.schema import events, studies

_STUDY_BY_NAME = select(*STUDY).where(studies.c.name == bindparam("name"))
_ADD_EVENT = events.insert()


class Journal:
    """An open write transaction. Events are collected and appended in one go before the commit."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._events: list[dict[str, Any]] = []
        self._open = True

    def _execute(self, statement: Any, values: Any = None) -> Any:
        """Run a statement. Raises RuntimeError after the transaction has ended."""
        if not self._open:
            raise RuntimeError("this transaction has ended; open another one with `store.transaction()`")
        return self._connection.execute(statement, values)

    def _append(self, kind: str, study_id: int | None, trial: int | None, payload: dict[str, JSON]) -> None:
        self._events.append(
            {
                "study_id": study_id,
                "trial": trial,
                "kind": kind,
                "payload": encode(f"payload of event {kind!r}", payload),
                "at": now(),
            }
        )

    def note(self, kind: str, *, study_id: int | None = None, trial: int | None = None, **payload: JSON) -> None:
        """Append an event of another kind."""
        self._append(clean(kind), study_id, trial, payload)

    def _forget(self, study_id: int) -> None:
        """Drop the collected events of a study that is being deleted in the same transaction."""
        self._events = [event for event in self._events if event["study_id"] != study_id]

    def flush(self) -> None:
        """Write the events that were collected; the transaction takes no more."""
        if self._events:
            self._execute(_ADD_EVENT, self._events)
        self._open = False

    def abandon(self) -> None:
        """Take no more; the transaction is being undone."""
        self._open = False

    def _study_named(self, name: str) -> Any:
        row = self._execute(_STUDY_BY_NAME, {"name": name}).one_or_none()
        if row is None:
            names = self._execute(select(studies.c.name)).scalars().all()
            raise UnknownStudy(nearest(name, names))
        return row

    def _refuse_driver(self, study_id: int, drive_token: int, what: str) -> Refused:
        """Why a driver's token doesn't hold (any more), for raising."""
        row = self._execute(select(*STUDY).where(studies.c.id == study_id)).one_or_none()
        if row is None:
            return Refused(f"{what}: expected study {study_id}, found none; it was deleted")
        if row.driver_id is None:
            found = f"nobody drives it (it is {row.state})"
        else:
            found = (
                f"{row.driver_id} on {row.driver_host} drives it with token {row.drive_token} since "
                f"{row.driven_since[:19]} UTC"
            )
        return Refused(
            f"{what}: expected drive token {drive_token} of study {row.name!r} to be in force, found that {found}; "
            "stop driving it"
        )
