"""The ground that all transitions stand on: one open transaction, and the events that will be appended to it.

Events, and what their payload holds (`trial` is the trial's number; studies' own events have none):

| kind | of | payload |
| --- | --- | --- |
| `created` | study | `study` (name), `target_trials` |
| `asked` | study | `wanted`, `state` (after it) |
| `extended` | study | `trials`, `cost` (more of it), `state` |
| `amended` | study | `changes`: by dotted field, `from` and `to` |
| `driven` | study | `driver`, `host`, `pid`, `token` |
| `released` | study | `state`, `reason` |
| `waiting`, `going_on` | study | `reason`: what a driven study waits for (a full disk); empty when it goes on |
| `artifacts_placed` | nothing | `identity`, `url` of the artifact root, and what was known before: `was` |
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

from sqlalchemy import Connection, bindparam, select, update

from services.errors import Refused, UnknownStudy
from services.store.port import JSON, ArtifactRoot
from services.store.reads import ARTIFACT_ROOT, nearest
from services.store.rows import STUDY, artifact_root, clean, encode, now
from services.store.schema import events, meta, studies

_STUDY_BY_NAME = select(*STUDY).where(studies.c.name == bindparam("name"))
_ADD_EVENT = events.insert()


class Journal:
    """An open write transaction, at one moment.

    Rows that no guard of the same transaction looks at (events, metrics, artifacts) are collected and written in one
    go for each table before the commit: that is a third of all statements of a trial.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._at = now()
        self._collected: dict[Any, list[dict[str, Any]]] = {}
        self._open = True

    def _collect(self, statement: Any, row: dict[str, Any]) -> None:
        """Run a statement with this row before the commit."""
        self._collected.setdefault(statement, []).append(row)

    def _execute(self, statement: Any, values: Any = None) -> Any:
        """Run a statement. Raises RuntimeError after the transaction has ended."""
        self._check_open()
        return self._connection.execute(statement, values)

    def _check_open(self) -> None:
        if not self._open:
            raise RuntimeError("this transaction has ended; open another one with `store.transaction()`")

    def _append(self, kind: str, study_id: int | None, trial: int | None, payload: dict[str, JSON]) -> None:
        """Append an event. Raises RuntimeError after the transaction has ended."""
        self._check_open()
        text = encode(f"payload of event {kind!r}", payload)
        row = {"study_id": study_id, "trial": trial, "kind": kind, "payload": text, "at": self._at}
        self._collect(_ADD_EVENT, row)

    def note(self, kind: str, *, study_id: int | None = None, trial: int | None = None, **payload: JSON) -> None:
        """Append an event of another kind."""
        self._append(clean(kind), study_id, trial, payload)

    def place_artifacts(self, root: ArtifactRoot, *, instead_of: str = "") -> ArtifactRoot:
        """Note where the artifacts are; see the port."""
        found = self._execute(ARTIFACT_ROOT).scalar_one_or_none()
        known = None if found is None else artifact_root(found)
        if known == root or (known is not None and known.identity != instead_of):
            return known
        text = encode("the artifact root", {"identity": clean(root.identity), "url": clean(root.url)})
        if known is None:
            self._execute(meta.insert(), {"key": "artifact_root", "value": text})
        else:
            self._execute(update(meta).where(meta.c.key == "artifact_root"), {"value": text})
        self._append("artifacts_placed", None, None, {"identity": root.identity, "url": root.url, "was": found})
        return root

    def flush(self) -> None:
        """Write what was collected."""
        for statement, rows in self._collected.items():
            self._execute(statement, rows)
        self._collected = {}

    def end(self) -> None:
        """Take no more."""
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
