"""What the API says, typed: one model for each thing, made from the store's rows.

Names are those of `services.listings`, which the command line prints.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, JsonValue

from services.amending import AMENDABLE
from services.stages import most_trials
from services.states import AttemptState, StudyState, TrialState
from services.store.port import ArtifactRow, AttemptRow, EventRow, MetricRow, ProposalRow, StudyRow, TrialRow


class Model(BaseModel):
    """Frozen; unknown keys of a request are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Cost(Model):
    """What something has cost."""

    samples: int = Field(description="simulation samples (control steps)")
    seconds: float = Field(description="wall-clock seconds of training, over all attempts")


class DriverOut(Model):
    """The process that drives a study."""

    host: str
    pid: int
    since: datetime | None


class StudySummary(Model):
    """A study as a listing shows it."""

    name: str
    state: StudyState
    reason: str = Field(description="why it is paused or failed, for people")
    wanted: str = Field(description="what people asked for: run, pause or cancel")
    task: str
    strategy: str
    pool: str
    priority: int
    target_trials: int | None = Field(description="at most so many trials, those of later stages among them")
    target_cost: float | None
    trials: dict[str, int] = Field(description="number of trials in each state")
    cost: Cost
    best_value: float | None
    driver: DriverOut | None
    created_at: datetime
    finished_at: datetime | None

    @classmethod
    def of(cls, row: StudyRow) -> Self:
        """From the store's row."""
        driver = row.driver
        return cls(
            name=row.name,
            state=row.state,
            reason=row.reason,
            wanted=row.wanted,
            task=task_name(row.spec),
            strategy=strategy_name(row.spec),
            pool=row.pool,
            priority=row.priority,
            target_trials=most_trials(row),
            target_cost=row.target_cost,
            trials=dict(row.counts),
            cost=Cost(samples=row.samples, seconds=row.seconds),
            best_value=row.best_value,
            driver=None if driver is None else DriverOut(host=driver.host, pid=driver.pid, since=row.driven_since),
            created_at=row.created_at,
            finished_at=row.finished_at,
        )


def task_name(spec: Mapping[str, Any]) -> str:
    """The task that a spec names, in its long or its short form."""
    task = spec.get("task", "")
    return str(task.get("name", "")) if isinstance(task, Mapping) else str(task)


def strategy_name(spec: Mapping[str, Any]) -> str:
    """The strategy that a spec names."""
    search = spec.get("search", {})
    return str(search.get("strategy", "")) if isinstance(search, Mapping) else ""


class StudyOut(StudySummary):
    """A study with what was asked for."""

    seed: int
    spec: dict[str, JsonValue]

    @classmethod
    def of(cls, row: StudyRow) -> Self:
        """From the store's row."""
        summary = StudySummary.of(row)
        return cls(**dict(summary), seed=row.seed, spec=dict(row.spec))


class Position(Model):
    """Where in the record something was read: everything up to `cursor` is in it."""

    cursor: int = Field(description="newest event that the answer reflects")
    history: str = Field(description="identity of the database's history; another one means: forget what you know")


class StudyList(Position):
    """All studies, newest first."""

    studies: list[StudySummary]


class TrialOut(Model):
    """A trial."""

    number: int
    stage: str
    state: TrialState
    params: dict[str, JsonValue]
    z: float | None = Field(description="difficulty in [0, 1]")
    warm_start: int | None = Field(description="number of the trial whose policy it started from")
    seed: int = Field(description="unsigned 64-bit: more than JavaScript's numbers hold")
    position: int | None = Field(description="place in the study's history, none while open")
    value: float | None
    features: list[float] | None
    details: dict[str, JsonValue]
    message: str
    cost: Cost
    iteration: int
    attempts: int
    retries: int
    info: dict[str, JsonValue] = Field(description="why it was proposed")
    proposal: int | None
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None

    @classmethod
    def of(cls, row: TrialRow) -> Self:
        """From the store's row."""
        return cls(
            number=row.number,
            stage=row.stage,
            state=row.state,
            params=dict(row.params),
            z=row.z,
            warm_start=row.warm_start,
            seed=row.seed,
            position=row.position,
            value=row.value,
            features=None if row.features is None else list(row.features),
            details=dict(row.details),
            message=row.message,
            cost=Cost(samples=row.samples, seconds=row.seconds),
            iteration=row.iteration,
            attempts=row.attempts,
            retries=row.retries,
            info=dict(row.info),
            proposal=row.proposal_id,
            created_at=row.created_at,
            started_at=row.started_at,
            finished_at=row.finished_at,
        )


class TrialPage(Model):
    """Some trials, by number."""

    trials: list[TrialOut]
    next: int | None = Field(description="pass as `after` for the next page; none at the end")


class TrialWindow(Position):
    """The trials that a screen shows."""

    count: int = Field(description="trials of the study")
    matched: int = Field(description="trials that pass the filters")
    offset: int
    trials: list[TrialOut]


class AttemptOut(Model):
    """One try at a trial."""

    number: int
    state: AttemptState
    worker: str
    host: str
    pid: int | None
    first_iteration: int
    started_at: datetime
    beat_at: datetime
    ended_at: datetime | None
    reason: str

    @classmethod
    def of(cls, row: AttemptRow) -> Self:
        """From the store's row."""
        return cls(
            number=row.number,
            state=row.state,
            worker=row.worker,
            host=row.host,
            pid=row.pid,
            first_iteration=row.first_iteration,
            started_at=row.started_at,
            beat_at=row.beat_at,
            ended_at=row.ended_at,
            reason=row.reason,
        )


class ArtifactOut(Model):
    """A file that a trial left."""

    sha256: str
    size: int = Field(description="bytes")
    created_at: datetime

    @classmethod
    def of(cls, row: ArtifactRow) -> Self:
        """From the store's row."""
        return cls(sha256=row.sha256, size=row.size, created_at=row.created_at)


class TrialDetail(TrialOut):
    """A trial with its attempts and what it left."""

    attempt_list: list[AttemptOut]
    artifacts: dict[str, ArtifactOut] = Field(description="what it left, by name")


class Metrics(Model):
    """A learning curve: one column a metric, one entry an iteration (none where it wasn't reported)."""

    iterations: list[int]
    attempts: list[int]
    series: dict[str, list[float | None]]

    @classmethod
    def of(cls, rows: list[MetricRow]) -> Self:
        """From the store's rows."""
        names = sorted({name for row in rows for name in row.values})
        return cls(
            iterations=[row.iteration for row in rows],
            attempts=[row.attempt for row in rows],
            series={name: [row.values.get(name) for row in rows] for name in names},
        )


class ProposalOut(Model):
    """What one proposal saw and gave."""

    id: int
    strategy: str
    history: int
    pending: list[int]
    rng_key: list[str] = Field(description="entropy of its generator, in decimal")
    count: int
    seconds: float
    info: dict[str, JsonValue]
    created_at: datetime

    @classmethod
    def of(cls, row: ProposalRow) -> Self:
        """From the store's row."""
        return cls(
            id=row.id,
            strategy=row.strategy,
            history=row.history,
            pending=list(row.pending),
            rng_key=[str(word) for word in row.rng_key],
            count=row.count,
            seconds=row.seconds,
            info=dict(row.info),
            created_at=row.created_at,
        )


class EventOut(Model):
    """Something that happened."""

    id: int
    study: str | None
    trial: int | None
    kind: str
    payload: dict[str, JsonValue]
    at: datetime

    @classmethod
    def of(cls, row: EventRow) -> Self:
        """From the store's row."""
        return cls(id=row.id, study=row.study, trial=row.trial, kind=row.kind, payload=dict(row.payload), at=row.at)


class EventPage(Model):
    """Some events, oldest first."""

    events: list[EventOut]
    next: int | None = Field(description="pass as `after` for the next page; none at the end")


class StrategyOut(Model):
    """One distinct way of doing it: the best of the trials whose behaviour counts as the same."""

    number: int = Field(description="the trial that stands for it")
    value: float | None
    features: list[float]
    members: int = Field(description="how many trials count as the same, this one among them")
    details: dict[str, JsonValue]
    pose: bool = Field(description="whether the trial left a picture of its pose (`pose.png`)")
    replay: bool = Field(description="whether the trial left its motion (`replay.bin`)")


class StrategyList(Position):
    """The distinct strategies of a study, best first."""

    distance: float | None = Field(description="two behaviours further apart than this are different strategies")
    strategies: list[StrategyOut]


class Submission(Model):
    """A study file to be run."""

    text: Annotated[str, Field(max_length=256 * 1024, description="the study file, YAML")]
    overrides: Annotated[list[str], Field(max_length=64)] = Field(
        default=[], description="`field.field=value`, as with --set"
    )
    name: Annotated[str, Field(max_length=200)] = Field(default="study.yaml", description="what errors call the file")


class Extension(Model):
    """More budget for a study."""

    trials: Annotated[int, Field(ge=0, le=10**9)] = 0
    cost: Annotated[float, Field(ge=0, allow_inf_nan=False, le=1e18)] = Field(
        default=0.0, description="simulation samples"
    )


class Amendment(Model):
    """How a study is to be run from now on."""

    fields: Annotated[dict[str, JsonValue], Field(min_length=1, max_length=len(AMENDABLE))] = Field(
        description=f"values by dotted name: {', '.join(AMENDABLE)}",
        examples=[{"priority": 5, "resources.pool": "gpu"}],
    )


class Problem(Model):
    """One thing that is wrong with a study file."""

    line: int | None
    field: str
    message: str


class ErrorBody(Model):
    """What went wrong: what was expected, what was found, what to do."""

    kind: str = Field(description="name of the error, for programs")
    message: str
    line: int | None = None
    field: str = ""
    problems: list[Problem] = []


class ErrorOut(Model):
    """The body of every answer that isn't a success."""

    error: ErrorBody


class ServerOut(Model):
    """The service itself."""

    version: str
    boot: str = Field(description="changes when the service restarts")
    history: str
    cursor: int
    database: str = Field(description="URL without its password")


class TrialTable(Position):
    """All trials of a study as columns, for tables and charts."""

    count: int
    numbers: list[int]
    states: list[str]
    stages: list[str]
    positions: list[int | None]
    z: list[float | None]
    values: list[float | None]
    samples: list[int]
    seconds: list[float]
    iterations: list[int]
    attempts: list[int]
    warm_starts: list[int | None]
    features: list[list[float] | None]
    started: list[float | None] = Field(description="seconds since the epoch")
    finished: list[float | None] = Field(description="seconds since the epoch")
    params: dict[str, list[JsonValue]]
    modes: list[str | None] = Field(description="why each was proposed (`info.mode`)")
