"""The port to the trial database: what can be read, and the transitions that can be made.

Every write happens inside `with store.transaction() as change:`; one commit covers all of it, so a driver groups
what belongs together and what arrived together. Each transition is guarded by the state it expects and, where a
lease is involved, by a fencing token; a guard that doesn't hold raises `Refused` before anything of that transition
is written, and the rest of the transaction stands.

Leases do not trust clocks. A holder raises a counter (`beat`); whoever doubts a holder watches the counter and
counts on its own monotonic clock. Times in the rows are for people.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Protocol

from services.states import AttemptState, StudyState, TrialState

JSON = Any


@dataclass(frozen=True, slots=True)
class Driver:
    """Who drives a study: the process that decides and writes for it."""

    id: str
    host: str
    pid: int
    started: str = ""
    """Start time of the process as the system tells it, so that a reused pid is noticed."""


@dataclass(frozen=True, slots=True)
class StudyRow:
    """A study as it stands. `drive_token` fences: it rises with each driver."""

    id: int
    name: str
    state: StudyState
    reason: str
    wanted: str
    """What people asked for: `run`, `pause` or `cancel`. The driver follows it."""
    spec: Mapping[str, JSON]
    seed: int
    priority: int
    pool: str
    target_trials: int | None
    target_cost: float | None
    driver: Driver | None
    driven_since: datetime | None
    drive_token: int
    drive_beat: int
    created_at: datetime
    finished_at: datetime | None
    counts: Mapping[str, int] = field(default_factory=dict)
    """Number of trials in each state."""
    samples: int = 0
    seconds: float = 0.0
    best_value: float | None = None


@dataclass(frozen=True, slots=True)
class NewTrial:
    """A candidate about to become a trial."""

    params: Mapping[str, JSON]
    seed: int
    z: float | None = None
    warm_start: int | None = None
    """Number of the trial whose policy it starts from."""
    stage: str = "search"
    info: Mapping[str, JSON] = field(default_factory=dict)
    """Why it was proposed: acquisition, mode, predicted features."""


@dataclass(frozen=True, slots=True)
class TrialRow:
    """A trial. `position` is its place in the study's history: 0 for the first that ended, None while open."""

    id: int
    study_id: int
    number: int
    stage: str
    state: TrialState
    params: Mapping[str, JSON]
    z: float | None
    warm_start: int | None
    seed: int
    proposal_id: int | None
    info: Mapping[str, JSON]
    position: int | None
    value: float | None
    features: tuple[float, ...] | None
    details: Mapping[str, JSON]
    message: str
    samples: int
    seconds: float
    iteration: int
    attempts: int
    retries: int
    """Attempts that ended `failed` or `lost`; preemption doesn't count."""
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None


@dataclass(frozen=True, slots=True)
class AttemptRow:
    """One try at a trial. `token` fences: a writer that doesn't hold the newest token is refused."""

    id: int
    trial_id: int
    number: int
    state: AttemptState
    token: int
    worker: str
    host: str
    pid: int | None
    beat: int
    first_iteration: int
    started_at: datetime
    beat_at: datetime
    ended_at: datetime | None
    reason: str


@dataclass(frozen=True, slots=True)
class ArtifactRow:
    """A file that a trial left. `path` is relative to the artifact root and never leaves it."""

    id: int
    trial_id: int
    name: str
    path: str
    sha256: str
    size: int
    created_at: datetime


@dataclass(frozen=True, slots=True)
class NewArtifact:
    """A file that is safe on storage and about to be recorded."""

    name: str
    path: str
    sha256: str
    size: int


@dataclass(frozen=True, slots=True)
class ArtifactRoot:
    """Where the artifacts of a database are: what its root is known by, and where it was last seen."""

    identity: str
    url: str


@dataclass(frozen=True, slots=True)
class Result:
    """The outcome of an attempt, in the store's words."""

    state: TrialState
    value: float | None = None
    features: tuple[float, ...] | None = None
    samples: int = 0
    seconds: float = 0.0
    message: str = ""
    details: Mapping[str, JSON] = field(default_factory=dict)
    artifacts: Sequence[NewArtifact] = ()


@dataclass(frozen=True, slots=True)
class ProposalRow:
    """What one proposal saw and gave, so that it can be replayed."""

    id: int
    study_id: int
    strategy: str
    history: int
    """Length of the history (the finished trials with `position` below it)."""
    pending: tuple[int, ...]
    """Numbers of the open trials it knew of."""
    rng_key: tuple[int, ...]
    """Entropy of the `SeedSequence`."""
    count: int
    seconds: float
    info: Mapping[str, JSON]
    created_at: datetime


@dataclass(frozen=True, slots=True)
class EventRow:
    """Something that happened; `id` is the cursor, and rises without ever being reused."""

    id: int
    study_id: int | None
    study: str | None
    trial: int | None
    kind: str
    payload: Mapping[str, JSON]
    at: datetime


@dataclass(frozen=True, slots=True)
class MetricRow:
    """The named metrics of one iteration."""

    iteration: int
    attempt: int
    values: Mapping[str, float]


class Change(Protocol):
    """The transitions. Each appends its event; each raises `Refused` where its guard doesn't hold."""

    def create_study(
        self,
        name: str,
        spec: Mapping[str, JSON],
        *,
        seed: int,
        pool: str = "default",
        priority: int = 0,
        target_trials: int | None = None,
        target_cost: float | None = None,
    ) -> StudyRow:
        """A new study, `queued`. Raises `NameTaken`."""

    def delete_study(self, name: str) -> None:
        """Forget a study that is not live, with all its rows."""

    def ask(self, name: str, wanted: str) -> StudyRow:
        """Ask for `run`, `pause` or `cancel`. An undriven study changes state at once, a driven one by its driver.

        `run` on a cancelled or paused study makes it `queued` again. Raises `WrongState` for what makes no sense.
        """

    def extend(self, name: str, *, trials: int = 0, cost: float = 0.0, rounds: int = 0) -> StudyRow:
        """Raise the targets, and the rounds of stages that have some; a complete study becomes `queued` again.

        Raises `WrongState` where there is no such target or no such stage, or a driver is at work (rounds alone).
        """

    def amend(self, name: str, fields: Mapping[str, JSON]) -> StudyRow:
        """Change fields of a study's spec, by dotted name; `priority` and `resources.pool` of its row with them.

        Which fields may be changed is the caller's business. The event `amended` says what was and what is.
        """

    def drive(self, name: str, driver: Driver, *, take_over_from: int | None = None) -> int:
        """Become the driver; the study becomes `running`. Returns the new drive token.

        Raises `StudyDriven` where another driver holds it, unless `take_over_from` is that driver's token
        (the caller has seen that it is dead). Taking over ends all running attempts as `lost` and
        re-queues their trials, in the same transaction, without counting it as a retry.
        """

    def beat_drive(self, study_id: int, drive_token: int) -> None:
        """Say that the driver lives."""

    def remark(self, study_id: int, drive_token: int, reason: str) -> None:
        """Say why a driven study waits (its `reason`), or with an empty one that it goes on."""

    def release_drive(self, study_id: int, drive_token: int, state: StudyState, reason: str = "") -> None:
        """Stop driving and leave the study in `state`. No attempt may be running."""

    def propose(
        self,
        study_id: int,
        drive_token: int,
        *,
        strategy: str,
        history: int,
        pending: Sequence[int],
        rng_key: Sequence[int],
        seconds: float,
        trials: Sequence[NewTrial],
        info: Mapping[str, JSON] | None = None,
    ) -> list[TrialRow]:
        """Record a proposal and its trials (`queued`), numbered in order."""

    def start(
        self, trial_id: int, drive_token: int, *, worker: str, host: str = "", pid: int | None = None
    ) -> AttemptRow:
        """`queued` -> `running` with a new attempt, whose token is higher than any before it in this trial."""

    def began(self, attempt_id: int, token: int, *, host: str, pid: int) -> None:
        """A worker process has taken the attempt up: which, where. Raises the beat. The event is `began`."""

    def beat(self, attempt_id: int, token: int) -> None:
        """Say that the attempt lives. Writes no event."""

    def report(
        self,
        attempt_id: int,
        token: int,
        *,
        iteration: int,
        metrics: Mapping[str, float],
        samples: int,
        seconds: float,
    ) -> None:
        """Metrics of an iteration; the same iteration again replaces them. Raises the beat. The event is `progress`."""

    def finish(self, attempt_id: int, token: int, result: Result) -> TrialRow:
        """The attempt ended with an outcome: the trial is final and gets its `position` in the history."""

    def lose(self, attempt_id: int, token: int, reason: str) -> TrialRow:
        """The worker vanished: attempt `lost`, trial `queued` again, one more retry counted."""

    def fail(self, attempt_id: int, token: int, reason: str) -> TrialRow:
        """The task's own error, worth another try: attempt `failed`, trial `queued` again, one more retry counted."""

    def preempt(self, attempt_id: int, token: int, reason: str) -> TrialRow:
        """Stopped at a checkpoint: attempt `preempted`, trial `queued` again."""

    def give_up(self, trial_id: int, drive_token: int, message: str) -> TrialRow:
        """A `queued` trial out of retries becomes `failed`, an observation with its `position`."""

    def cancel_trial(self, trial_id: int, drive_token: int, reason: str) -> TrialRow:
        """An open trial becomes `cancelled`, a running attempt with it. It gets no position."""

    def place_artifacts(self, root: ArtifactRoot, *, instead_of: str = "") -> ArtifactRoot:
        """Note where the artifacts are, where nothing is known yet or what is known has the identity `instead_of`.

        Returns what is known then: of two that note it at once, the second learns what the first one noted.
        """

    def note(self, kind: str, *, study_id: int | None = None, trial: int | None = None, **payload: JSON) -> None:
        """Append an event of another kind, e.g. `refused`, `warning`."""


class Store(Protocol):
    """The trial database."""

    url: str

    def transaction(self) -> AbstractContextManager[Change]:
        """One commit for all transitions made inside; an exception that leaves the block undoes all of them."""

    def close(self) -> None:
        """Let go of all connections."""

    def history_id(self) -> str:
        """Identity of this database's history: a restored or swapped database has another one."""

    def studies(self) -> list[StudyRow]:
        """All studies, newest first, with their counts and costs."""

    def study(self, name: str) -> StudyRow:
        """One study. Raises `UnknownStudy`, naming the nearest names."""

    def wanted(self, study_ids: Collection[int]) -> dict[int, StudyRow]:
        """The driver's cheap poll: the rows without counts."""

    def trials(
        self,
        study_id: int,
        *,
        states: Collection[TrialState] | None = None,
        after: int = -1,
        limit: int | None = None,
    ) -> list[TrialRow]:
        """Trials with a number above `after`, by number."""

    def trial(self, study_id: int, number: int) -> TrialRow:
        """One trial. Raises `UnknownTrial`."""

    def history(self, study_id: int, *, start: int = 0) -> list[TrialRow]:
        """Finished trials from history position `start`, in order of position."""

    def attempts(self, trial_id: int) -> list[AttemptRow]:
        """Attempts by number."""

    def metrics(self, trial_id: int, *, after: int = 0) -> list[MetricRow]:
        """The learning curve beyond iteration `after`."""

    def artifacts(self, trial_id: int) -> list[ArtifactRow]:
        """What a trial left, by name."""

    def study_artifacts(self, study_id: int) -> list[ArtifactRow]:
        """What all trials of a study left, by trial and name."""

    def artifact_root(self) -> ArtifactRoot | None:
        """Where the artifacts are; None where no driver has noted it yet."""

    def proposals(self, study_id: int, *, after: int = 0, limit: int | None = None) -> list[ProposalRow]:
        """What each proposal with an id above `after` saw, in order."""

    def events(self, *, after: int = 0, study_id: int | None = None, limit: int = 1000) -> list[EventRow]:
        """Events beyond a cursor, oldest first."""

    def last_event(self) -> int:
        """The newest cursor, 0 where nothing has happened."""
