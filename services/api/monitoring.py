"""What runs now, for people (who is doing what) and for Prometheus (how much of everything)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime

from fastapi import APIRouter, Response

from services.api.models import Model, Position
from services.api.service import Service, Uses
from services.states import AttemptState, StudyState, TrialState
from services.store.port import StudyRow

router = APIRouter()

TEXT_FORMAT = "text/plain; version=0.0.4; charset=utf-8"
"""Prometheus' text exposition format."""


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


class WorkerList(Position):
    """Who is doing what, and what waits."""

    workers: list[WorkerOut]
    queue: list[QueueOut]


@router.get("/api/v1/workers", tags=["service"])
def workers(service: Uses) -> WorkerList:
    """Attempts that run now, by pool and worker; and the studies that are queued or running, highest priority first."""
    cursor, history = service.store.last_event(), service.store.history_id()
    studies = [row for row in service.store.studies() if row.state in {StudyState.QUEUED, StudyState.RUNNING}]
    running = [worker for row in studies for worker in _running(service, row)]
    running.sort(key=lambda worker: (worker.pool, worker.worker, worker.study, worker.trial))
    studies.sort(key=lambda row: (-row.priority, row.id))
    return WorkerList(cursor=cursor, history=history, workers=running, queue=[_queued(row) for row in studies])


def _running(service: Service, row: StudyRow) -> Iterator[WorkerOut]:
    if not row.counts.get(TrialState.RUNNING):
        return
    for trial in service.store.trials(row.id, states=[TrialState.RUNNING]):
        for attempt in service.store.attempts(trial.id):
            if attempt.state is AttemptState.RUNNING:
                yield WorkerOut(
                    pool=row.pool,
                    worker=attempt.worker,
                    host=attempt.host,
                    pid=attempt.pid,
                    study=row.name,
                    trial=trial.number,
                    attempt=attempt.number,
                    iteration=trial.iteration,
                    samples=trial.samples,
                    seconds=trial.seconds,
                    samples_per_second=trial.samples / trial.seconds if trial.seconds > 0 else None,
                    started_at=attempt.started_at,
                    beat_at=attempt.beat_at,
                )


def _queued(row: StudyRow) -> QueueOut:
    resources = row.spec.get("resources")
    parallel = resources.get("parallel", 1) if isinstance(resources, Mapping) else 1
    return QueueOut(
        study=row.name,
        state=row.state,
        pool=row.pool,
        priority=row.priority,
        parallel=int(parallel),
        running=row.counts.get(TrialState.RUNNING, 0),
        queued=row.counts.get(TrialState.QUEUED, 0),
    )


@router.get("/metrics", tags=["service"], response_class=Response, responses={200: {"content": {"text/plain": {}}}})
def metrics(service: Uses) -> Response:
    """Counts for Prometheus. It needs the token like everything else (`authorization: credentials_file`)."""
    text = "".join(exposition(service.store.studies(), service.store.last_event(), service.hub.listeners))
    return Response(text, media_type=TEXT_FORMAT)


def exposition(studies: Sequence[StudyRow], cursor: int, viewers: int) -> Iterator[str]:
    """The lines of the text format, each family with its help and type."""
    yield from _family(
        "halma_studies",
        "gauge",
        "Studies in each state.",
        [({"state": state.value}, sum(row.state is state for row in studies)) for state in StudyState],
    )
    yield from _family(
        "halma_trials",
        "gauge",
        "Trials of a study in each state.",
        [
            ({"study": row.name, "state": state.value}, row.counts.get(state, 0))
            for row in studies
            for state in TrialState
        ],
    )
    yield from _family(
        "halma_samples_total",
        "counter",
        "Simulation samples (control steps) that a study has cost.",
        [({"study": row.name}, row.samples) for row in studies],
    )
    yield from _family(
        "halma_training_seconds_total",
        "counter",
        "Seconds of training that a study has cost.",
        [({"study": row.name}, row.seconds) for row in studies],
    )
    yield from _family(
        "halma_best_value",
        "gauge",
        "Best value of a study.",
        [({"study": row.name}, row.best_value) for row in studies if row.best_value is not None],
    )
    yield from _family("halma_events_total", "counter", "Cursor of the newest event.", [({}, cursor)])
    yield from _family("halma_viewers", "gauge", "Sockets that listen to events.", [({}, viewers)])


def _family(name: str, kind: str, meaning: str, samples: Sequence[tuple[Mapping[str, str], float]]) -> Iterator[str]:
    yield f"# HELP {name} {meaning}\n# TYPE {name} {kind}\n"
    for labels, value in samples:
        inside = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
        yield f"{name}{{{inside}}} {value!r}\n" if inside else f"{name} {value!r}\n"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace("\n", "\\n").replace('"', '\\"')
