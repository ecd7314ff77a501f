"""Trials: what they tried and found, attempts, files, learning curves."""

from __future__ import annotations

from datetime import datetime
from typing import Self

from pydantic import Field, JsonValue

from services.api.models.basis import Cost, Model, Page, Position
from services.states import AttemptState, TrialState
from services.store.port import ArtifactRow, AttemptRow, MetricRow, TrialRow


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


class TrialPage(Page):
    """Some trials, by number."""

    trials: list[TrialOut]


class TrialWindow(Position):
    """The trials that a screen shows."""

    count: int = Field(description="trials of the study")
    matched: int = Field(description="trials that pass the filters")
    offset: int
    trials: list[TrialOut]


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


class AttemptPage(Page):
    """Some attempts at a trial, by number."""

    attempts: list[AttemptOut]


class ArtifactOut(Model):
    """A file that a trial left."""

    sha256: str
    size: int = Field(description="bytes")
    created_at: datetime

    @classmethod
    def of(cls, row: ArtifactRow) -> Self:
        """From the store's row."""
        return cls(sha256=row.sha256, size=row.size, created_at=row.created_at)


class ArtifactPage(Page):
    """Some of the files that a trial left."""

    artifacts: dict[str, ArtifactOut] = Field(description="by name")


class LeftOut(ArtifactOut):
    """A file that a trial of a study left."""

    trial: int = Field(description="number of the trial")
    name: str


class LeftPage(Page):
    """Some of the files that the trials of a study left, by trial and name."""

    artifacts: list[LeftOut]


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
