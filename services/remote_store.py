"""A service's record as a store: what commands read and ask of a database, they can read and ask of a server.

Rows carry no ids of the database, which are nobody's business but its own; this store makes up its own. It has the
transitions that people may ask for (`ask`, `extend`, `amend`), each a request of its own, and none of a driver's.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, cast

from services.api.models import (
    ArtifactOut,
    AttemptOut,
    DriverOut,
    EventOut,
    ProposalOut,
    StudyOut,
    StudySummary,
    TrialOut,
)
from services.client import Client
from services.errors import BadInput
from services.states import TrialState
from services.store.port import (
    ArtifactRoot,
    ArtifactRow,
    AttemptRow,
    Change,
    Driver,
    EventRow,
    MetricRow,
    ProposalRow,
    StudyRow,
    TrialRow,
)

TRIALS = 1 << 40
"""A trial's made-up id is its study's times this, plus its number."""


class RemoteStore:
    """The reading half of a store, over a client.

    Args:
        client: of the service; closed with the store.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._names: list[str] = []
        self.url = client.url

    def close(self) -> None:
        """Let go of the connections."""
        self._client.close()

    @contextmanager
    def transaction(self) -> Iterator[Change]:
        """What people may ask for. Each takes effect at once, so there is nothing to undo."""
        yield cast("Change", _Asks(self, self._client))

    def history_id(self) -> str:
        """Identity of the service's database."""
        return self._client.server().history

    def last_event(self) -> int:
        """The newest cursor."""
        return self._client.server().cursor

    def studies(self) -> list[StudyRow]:
        """All studies, newest first; of their specs the task and the strategy only."""
        return [
            _study_row(
                self.id_of(study.name),
                study,
                {"task": {"name": study.task}, "search": {"strategy": study.strategy}},
                # Without its spec a study's later stages aren't known: its trials are those of all of them.
                target_trials=study.target_trials,
            )
            for study in self._client.studies()
        ]

    def study(self, name: str) -> StudyRow:
        """One study. Raises `UnknownStudy`."""
        return self.row_of(self._client.study(name))

    def row_of(self, study: StudyOut) -> StudyRow:
        """A study as the store's row."""
        return _study_row(self.id_of(study.name), study, study.spec, target_trials=study.search_trials)

    def wanted(self, study_ids: Collection[int]) -> dict[int, StudyRow]:
        """The rows of these studies."""
        return {number: self.study(self.name_of(number)) for number in study_ids}

    def trials(
        self,
        study_id: int,
        *,
        states: Collection[TrialState] | None = None,
        after: int = -1,
        limit: int | None = None,
    ) -> list[TrialRow]:
        """Trials with a number above `after`, by number."""
        if states is not None and not states:
            return []
        rows: list[TrialRow] = []
        for trial in self._client.trials(self.name_of(study_id), states=list(states or ()), after=after):
            if limit is not None and len(rows) >= limit:
                break
            rows.append(_trial_row(study_id, trial))
        return rows

    def trial(self, study_id: int, number: int) -> TrialRow:
        """One trial. Raises `UnknownTrial`."""
        return _trial_row(study_id, self._client.trial(self.name_of(study_id), number))

    def history(self, study_id: int, *, start: int = 0) -> list[TrialRow]:
        """Finished trials from history position `start`, in order of position."""
        placed = [row for row in self.trials(study_id) if row.position is not None and row.position >= start]
        return sorted(placed, key=lambda row: row.position or 0)

    def attempts(self, trial_id: int) -> list[AttemptRow]:
        """Attempts by number."""
        return [_attempt_row(trial_id, each) for each in self._client.attempts(*self._place(trial_id))]

    def metrics(self, trial_id: int, *, after: int = 0) -> list[MetricRow]:
        """The learning curve beyond iteration `after`."""
        told = self._client.metrics(*self._place(trial_id), after=after)
        return [
            MetricRow(iteration, attempt, {name: value for name, column in told.series.items()
                                           if (value := column[place]) is not None})
            for place, (iteration, attempt) in enumerate(zip(told.iterations, told.attempts, strict=True))
        ]  # fmt: skip

    def artifacts(self, trial_id: int) -> list[ArtifactRow]:
        """What a trial left, by name."""
        left = self._client.artifacts(*self._place(trial_id))
        return [_artifact_row(trial_id, name, left[name]) for name in sorted(left)]

    def study_artifacts(self, study_id: int) -> list[ArtifactRow]:
        """What all trials of a study left, by trial and name."""
        left = self._client.study_artifacts(self.name_of(study_id))
        return [_artifact_row(study_id * TRIALS + each.trial, each.name, each) for each in left]

    def artifact_root(self) -> ArtifactRoot | None:
        """Nothing: the files are the service's."""
        return None

    def proposals(self, study_id: int, *, after: int = 0, limit: int | None = None) -> list[ProposalRow]:
        """What each proposal with an id above `after` saw, in order."""
        rows = [
            _proposal_row(study_id, each)
            for each in self._client.proposals(self.name_of(study_id))
            if each.id > after
        ]  # fmt: skip
        return rows[:limit]

    def events(self, *, after: int = 0, study_id: int | None = None, limit: int = 1000) -> list[EventRow]:
        """Events beyond a cursor, oldest first."""
        name = None if study_id is None else self.name_of(study_id)
        return [self._event_row(event) for event in self._client.some_events(name, after=after, limit=limit)]

    def id_of(self, name: str) -> int:
        """The id that this store made up for a study."""
        if name not in self._names:
            self._names.append(name)
        return self._names.index(name) + 1

    def name_of(self, study_id: int) -> str:
        """The study of an id."""
        return self._names[study_id - 1]

    def _place(self, trial_id: int) -> tuple[str, int]:
        study, number = divmod(trial_id, TRIALS)
        return self.name_of(study), number

    def _event_row(self, event: EventOut) -> EventRow:
        study = None if event.study is None else self.id_of(event.study)
        return EventRow(event.id, study, event.study, event.trial, event.kind, event.payload, event.at)


class _Asks:
    """What people may ask of a service. Everything else is its own business."""

    def __init__(self, store: RemoteStore, client: Client) -> None:
        self._store = store
        self._client = client

    def ask(self, name: str, wanted: str) -> StudyRow:
        """Ask for `run`, `pause` or `cancel`. Raises `WrongState`, `UnknownStudy`."""
        asks = {"run": self._client.resume, "pause": self._client.pause, "cancel": self._client.cancel}
        return self._store.row_of(asks[wanted](name))

    def extend(self, name: str, *, trials: int = 0, cost: float = 0.0, rounds: int = 0) -> StudyRow:
        """Raise the targets. Raises `UnknownStudy`, `BadInput`."""
        return self._store.row_of(self._client.extend(name, trials=trials, cost=cost, rounds=rounds))

    def amend(self, name: str, fields: Mapping[str, Any]) -> StudyRow:
        """Change how a study is run. Raises `UnknownStudy`, `BadInput`."""
        return self._store.row_of(self._client.amend(name, fields))

    def __getattr__(self, transition: str) -> Any:
        raise BadInput(
            f"expected pause, resume, cancel, extend or set of a service, found {transition}; give --db instead"
        )


def _driver(told: DriverOut | None) -> Driver | None:
    return None if told is None else Driver(id="", host=told.host, pid=told.pid)


def _study_row(number: int, study: StudySummary, spec: Any, *, target_trials: int | None) -> StudyRow:
    return StudyRow(
        id=number,
        name=study.name,
        state=study.state,
        reason=study.reason,
        wanted=study.wanted,
        spec=spec,
        seed=study.seed,
        priority=study.priority,
        pool=study.pool,
        target_trials=target_trials,
        target_cost=study.target_cost,
        driver=_driver(study.driver),
        driven_since=None if study.driver is None else study.driver.since,
        drive_token=0,
        drive_beat=0,
        created_at=study.created_at,
        finished_at=study.finished_at,
        counts=study.trials,
        samples=study.cost.samples,
        seconds=study.cost.seconds,
        best_value=study.best_value,
    )


def _trial_row(study_id: int, trial: TrialOut) -> TrialRow:
    return TrialRow(
        id=study_id * TRIALS + trial.number,
        study_id=study_id,
        number=trial.number,
        stage=trial.stage,
        state=trial.state,
        params=trial.params,
        z=trial.z,
        warm_start=trial.warm_start,
        seed=trial.seed,
        proposal_id=trial.proposal,
        info=trial.info,
        position=trial.position,
        value=trial.value,
        features=None if trial.features is None else tuple(trial.features),
        details=trial.details,
        message=trial.message,
        samples=trial.cost.samples,
        seconds=trial.cost.seconds,
        iteration=trial.iteration,
        attempts=trial.attempts,
        retries=trial.retries,
        created_at=trial.created_at,
        started_at=trial.started_at,
        finished_at=trial.finished_at,
    )


def _attempt_row(trial_id: int, attempt: AttemptOut) -> AttemptRow:
    return AttemptRow(
        id=0,
        trial_id=trial_id,
        token=0,
        beat=0,
        number=attempt.number,
        state=attempt.state,
        worker=attempt.worker,
        host=attempt.host,
        pid=attempt.pid,
        first_iteration=attempt.first_iteration,
        started_at=attempt.started_at,
        beat_at=attempt.beat_at,
        ended_at=attempt.ended_at,
        reason=attempt.reason,
    )


def _artifact_row(trial_id: int, name: str, told: ArtifactOut) -> ArtifactRow:
    # The place of the file is the service's; who wants its content asks the client.
    return ArtifactRow(0, trial_id, name, "", told.sha256, told.size, told.created_at)


def _proposal_row(study_id: int, told: ProposalOut) -> ProposalRow:
    return ProposalRow(
        id=told.id,
        study_id=study_id,
        strategy=told.strategy,
        history=told.history,
        pending=tuple(told.pending),
        rng_key=tuple(int(word) for word in told.rng_key),
        count=told.count,
        seconds=told.seconds,
        info=told.info,
        created_at=told.created_at,
    )
