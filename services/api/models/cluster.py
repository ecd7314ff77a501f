"""Pools, workers, and the studies that wait for them."""

from __future__ import annotations

from datetime import datetime

from pydantic import Field

from services.api.models.basis import Model, Page, Position
from services.states import StudyState


class WorkerOut(Model):
    """An attempt that runs now, and who runs it."""

    pool: str
    worker: str
    host: str
    pid: int | None
    study: str
    trial: int
    attempt: int
    iteration: int
    samples: int
    seconds: float
    samples_per_second: float | None
    started_at: datetime
    beat_at: datetime


class QueueOut(Model):
    """A study that has a claim on workers."""

    study: str
    state: StudyState
    pool: str
    priority: int
    parallel: int
    running: int
    queued: int


class WorkerList(Position, Page):
    """Who is doing what, a page at a time, and all that waits."""

    workers: list[WorkerOut]
    queue: list[QueueOut]


class PoolOut(Model):
    """A worker pool."""

    name: str
    cores: float | None = Field(description="none where this server doesn't know the pool")
    held: float = Field(description="cores that running attempts hold")
    running: int
    queued: int


class BusyOut(WorkerOut):
    """An attempt that runs now, with what its process holds."""

    cores: float
    memory: int | None = Field(description="resident bytes; none where the process is on another machine")


class ShareOut(QueueOut):
    """A study's claim and what it has had."""

    waiting: bool = Field(description="whether it has trials, or is itself, without a worker")
    cores_held: float
    cores_wanted: float = Field(description="at its full width")
    core_seconds: float = Field(description="seconds of training times cores of a trial, so far")
    samples: int


class ClusterOut(Position):
    """Pools, who is doing what, and what waits, highest priority first."""

    host: str
    pools: list[PoolOut]
    workers: list[BusyOut]
    queue: list[ShareOut]
