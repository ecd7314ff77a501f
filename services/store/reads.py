"""What can be read. Each read is one statement, so it sees one moment."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from sqlalchemy import Connection, Engine, Select, and_, bindparam, case, func, or_, select

from services.errors import UnknownStudy, UnknownTrial
from services.states import TrialState
from services.store.engine import translated
from services.store.port import (
    ArtifactRoot,
    ArtifactRow,
    AttemptRow,
    EventRow,
    MetricRow,
    ProposalRow,
    StudyRow,
    TrialRow,
)
from services.store.rows import (
    ARTIFACT,
    ATTEMPT,
    EVENT,
    METRIC,
    PROPOSAL,
    STUDY,
    TRIAL,
    artifact_root,
    artifact_row,
    attempt_row,
    event_row,
    metric_row,
    proposal_row,
    study_row,
    trial_row,
)
from services.store.schema import artifacts, attempts, events, meta, metrics, proposals, studies, trials

Made = TypeVar("Made")

AT_A_TIME = 500
"""Rows that are taken from the database at once."""

# An easier version of a task has values of its own: only those of the task itself answer what the best is.
_ANSWERS = and_(trials.c.state == "complete", or_(trials.c.z.is_(None), trials.c.z == 1))
_COUNTS = (
    select(
        trials.c.study_id,
        trials.c.state.label("trial_state"),
        func.count().label("trials"),
        func.sum(trials.c.samples).label("samples"),
        func.sum(trials.c.seconds).label("seconds"),
        func.max(case((_ANSWERS, trials.c.value))).label("best"),
    )
    .group_by(trials.c.study_id, trials.c.state)
    .subquery("counts")
)
_STUDIES = (
    select(*STUDY, _COUNTS.c.trial_state, _COUNTS.c.trials, _COUNTS.c.samples, _COUNTS.c.seconds, _COUNTS.c.best)
    .outerjoin_from(studies, _COUNTS, _COUNTS.c.study_id == studies.c.id)
    .order_by(studies.c.id.desc(), _COUNTS.c.trial_state)
)
_ONE_STUDY = (
    select(
        *STUDY,
        trials.c.state.label("trial_state"),
        func.count(trials.c.id).label("trials"),
        func.sum(trials.c.samples).label("samples"),
        func.sum(trials.c.seconds).label("seconds"),
        func.max(case((_ANSWERS, trials.c.value))).label("best"),
    )
    .outerjoin_from(studies, trials, trials.c.study_id == studies.c.id)
    .where(studies.c.name == bindparam("name"))
    .group_by(studies.c.id, trials.c.state)
    .order_by(trials.c.state)
)
_TRIALS = select(*TRIAL).where(trials.c.study_id == bindparam("study"), trials.c.number > bindparam("after"))
_TRIALS = _TRIALS.order_by(trials.c.number)
_TRIAL = select(*TRIAL).where(trials.c.study_id == bindparam("study"), trials.c.number == bindparam("number"))
_HISTORY = (
    select(*TRIAL)
    .where(trials.c.study_id == bindparam("study"), trials.c.position >= bindparam("start"))
    .order_by(trials.c.position)
)
_ATTEMPTS = select(*ATTEMPT).where(attempts.c.trial_id == bindparam("trial")).order_by(attempts.c.number)
_METRICS = (
    select(*METRIC)
    .where(metrics.c.trial_id == bindparam("trial"), metrics.c.iteration > bindparam("after"))
    .order_by(metrics.c.iteration)
)
_ARTIFACTS = select(*ARTIFACT).where(artifacts.c.trial_id == bindparam("trial")).order_by(artifacts.c.name)
_STUDY_ARTIFACTS = (
    select(*ARTIFACT)
    .join_from(artifacts, trials, trials.c.id == artifacts.c.trial_id)
    .where(trials.c.study_id == bindparam("study"))
    .order_by(trials.c.number, artifacts.c.name)
)
_PROPOSALS = (
    select(*PROPOSAL)
    .where(proposals.c.study_id == bindparam("study"), proposals.c.id > bindparam("after"))
    .order_by(proposals.c.id)
)
_EVENTS = (
    select(*EVENT)
    .outerjoin_from(events, studies, studies.c.id == events.c.study_id)
    .where(events.c.id > bindparam("after"))
    .order_by(events.c.id)
    .limit(bindparam("limit"))
)
_STUDY_EVENTS = _EVENTS.where(events.c.study_id == bindparam("study"))
_LAST_EVENT = select(func.coalesce(func.max(events.c.id), 0))
_SIZE = select(studies.c.name, studies.c.trial_count).where(studies.c.id == bindparam("study"))
_HISTORY_ID = select(meta.c.value).where(meta.c.key == "history_id")
ARTIFACT_ROOT = select(meta.c.value).where(meta.c.key == "artifact_root")


def nearest(name: str, names: Iterable[str]) -> str:
    """The message for a study that doesn't exist, naming those that are nearly so called."""
    near = difflib.get_close_matches(name, list(names), n=3, cutoff=0.5)
    found = f"found {', '.join(repr(other) for other in near)}" if near else "found none of a similar name"
    return f"study {name!r}: expected the name of a study, {found}; `halma ls` lists them all"


def _gather(rows: Iterable[Any]) -> list[StudyRow]:
    """Studies from rows that hold one study and one state of its trials each, those of a study side by side."""
    columns = len(STUDY)
    found: dict[int, tuple[Any, list[Any]]] = {}
    for row in rows:
        study = found.setdefault(row[0], (row[:columns], []))
        if row[columns] is not None:
            study[1].append(row[columns:])
    return [
        study_row(
            study,
            {state: count for state, count, *_ in states},
            sum(int(samples) for _, _, samples, *_ in states),
            float(sum(seconds for _, _, _, seconds, _ in states)),
            max((best for *_, best in states if best is not None), default=None),
        )
        for study, states in found.values()
    ]


def one_study(connection: Connection, name: str) -> StudyRow | None:
    """A study with its counts, None where there is none of that name."""
    found = _gather(connection.execute(_ONE_STUDY, {"name": name}))
    return found[0] if found else None


class Reads:
    """The reading half of a store."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        # One statement a read needs no transaction around it. (SQLite's connections are in that mode anyway.)
        self._reader = engine
        if engine.dialect.name == "postgresql":
            self._reader = engine.execution_options(isolation_level="AUTOCOMMIT")

    @contextmanager
    def _reading(self) -> Iterator[Connection]:
        with translated(self._engine.url), self._reader.connect() as connection:
            yield connection

    def _rows(self, statement: Select[Any], **values: Any) -> Any:
        with self._reading() as connection:
            return connection.execute(statement, values).all()

    def _made(self, make: Callable[[Any], Made], statement: Select[Any], **values: Any) -> list[Made]:
        """What is made of each row, some at a time: 50,000 rows beside what is made of them take twice the memory."""
        with self._reading() as connection:
            some = connection.execute(statement, values).partitions(AT_A_TIME)
            return [make(row) for rows in some for row in rows]

    def history_id(self) -> str:
        """Identity of this database's history, made with its tables; see the port."""
        return str(self._rows(_HISTORY_ID)[0][0])

    def studies(self) -> list[StudyRow]:
        """All studies, newest first, with their counts and costs."""
        return _gather(self._rows(_STUDIES))

    def study(self, name: str) -> StudyRow:
        """One study. Raises `UnknownStudy`, naming the nearest names."""
        with self._reading() as connection:
            found = one_study(connection, name)
            if found is None:
                raise UnknownStudy(nearest(name, connection.execute(select(studies.c.name)).scalars()))
            return found

    def wanted(self, study_ids: Collection[int]) -> dict[int, StudyRow]:
        """The rows without counts; a study that was deleted is missing."""
        rows = self._rows(select(*STUDY).where(studies.c.id.in_(study_ids)))
        return {row.id: study_row(row) for row in rows}

    def trials(
        self,
        study_id: int,
        *,
        states: Collection[TrialState] | None = None,
        after: int = -1,
        limit: int | None = None,
    ) -> list[TrialRow]:
        """Trials with a number above `after`, by number."""
        statement = _TRIALS
        if states is not None:
            statement = statement.where(trials.c.state.in_([state.value for state in states]))
        if limit is not None:
            statement = statement.limit(limit)
        return self._made(trial_row, statement, study=study_id, after=after)

    def trial(self, study_id: int, number: int) -> TrialRow:
        """One trial. Raises `UnknownTrial`."""
        rows = self._rows(_TRIAL, study=study_id, number=number)
        if not rows:
            study = self._rows(_SIZE, study=study_id)
            name, count = study[0] if study else (f"id {study_id}", 0)
            known = f"a number from 0 to {count - 1}" if count else "a study that has trials"
            raise UnknownTrial(f"trial {number} of study {name!r}: expected {known}; `halma trials` lists them")
        return trial_row(rows[0])

    def history(self, study_id: int, *, start: int = 0) -> list[TrialRow]:
        """Finished trials from history position `start`, in order of position."""
        return self._made(trial_row, _HISTORY, study=study_id, start=start)

    def attempts(self, trial_id: int) -> list[AttemptRow]:
        """Attempts by number."""
        return [attempt_row(row) for row in self._rows(_ATTEMPTS, trial=trial_id)]

    def metrics(self, trial_id: int, *, after: int = 0) -> list[MetricRow]:
        """The learning curve beyond iteration `after`."""
        return [metric_row(row) for row in self._rows(_METRICS, trial=trial_id, after=after)]

    def artifacts(self, trial_id: int) -> list[ArtifactRow]:
        """What a trial left, by name."""
        return [artifact_row(row) for row in self._rows(_ARTIFACTS, trial=trial_id)]

    def study_artifacts(self, study_id: int) -> list[ArtifactRow]:
        """What all trials of a study left, by trial and name."""
        return [artifact_row(row) for row in self._rows(_STUDY_ARTIFACTS, study=study_id)]

    def artifact_root(self) -> ArtifactRoot | None:
        """Where the artifacts are; None where no driver has noted it yet."""
        rows = self._rows(ARTIFACT_ROOT)
        return artifact_root(rows[0][0]) if rows else None

    def proposals(self, study_id: int, *, after: int = 0, limit: int | None = None) -> list[ProposalRow]:
        """What each proposal with an id above `after` saw, in order."""
        statement = _PROPOSALS if limit is None else _PROPOSALS.limit(limit)
        return [proposal_row(row) for row in self._rows(statement, study=study_id, after=after)]

    def events(self, *, after: int = 0, study_id: int | None = None, limit: int = 1000) -> list[EventRow]:
        """Events beyond a cursor, oldest first."""
        if study_id is None:
            return [event_row(row) for row in self._rows(_EVENTS, after=after, limit=limit)]
        return [event_row(row) for row in self._rows(_STUDY_EVENTS, after=after, limit=limit, study=study_id)]

    def last_event(self) -> int:
        """The newest cursor, 0 where nothing has happened."""
        return int(self._rows(_LAST_EVENT)[0][0])
