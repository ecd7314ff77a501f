"""What runs now, for people (who is doing what) and for Prometheus (how much of everything)."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from fastapi import APIRouter, Response

from services.api.cursors import PageCursor, after_key, page_of
from services.api.models import BusyOut, ClusterOut, PoolOut, QueueOut, ShareOut, WorkerList, WorkerOut
from services.api.parameters import Limit
from services.api.service import Service, Uses
from services.states import AttemptState, StudyState, TrialState
from services.store.port import StudyRow

router = APIRouter()

TEXT_FORMAT = "text/plain; version=0.0.4; charset=utf-8"
"""Prometheus' text exposition format."""


@router.get("/api/v1/workers", tags=["service"])
def workers(service: Uses, page: PageCursor = None, limit: Limit = 200) -> WorkerList:
    """Attempts that run now, by pool and worker, a page at a time; and all studies that are queued or running."""
    cursor, history = service.store.last_event(), service.store.history_id()
    studies = [row for row in service.store.studies() if row.state in {StudyState.QUEUED, StudyState.RUNNING}]
    running = [worker for row in studies for worker in _running(service, row)]
    running.sort(key=_place)
    studies.sort(key=lambda row: (-row.priority, row.id))
    behind = after_key(running, "workers", page, _place, str, str, str, int)
    shown, following = page_of(behind, limit, "workers", _place)
    queue = [_queued(row) for row in studies]
    return WorkerList(cursor=cursor, history=history, workers=list(shown), queue=queue, next=following)


def _place(worker: WorkerOut) -> tuple[str, str, str, int]:
    return worker.pool, worker.worker, worker.study, worker.trial


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


@router.get("/api/v1/cluster", tags=["service"])
def cluster(service: Uses) -> ClusterOut:
    """Pools, workers and what each is doing, the queue and the shares."""
    cursor, history = service.store.last_event(), service.store.history_id()
    studies = [row for row in service.store.studies() if row.state in {StudyState.QUEUED, StudyState.RUNNING}]
    studies.sort(key=lambda row: (-row.priority, row.id))
    here = socket.gethostname()
    cores = {row.name: _cores(row) for row in studies}
    busy = [
        BusyOut(
            **dict(worker),
            cores=cores[row.name],
            memory=resident(worker.pid) if worker.host == here else None,
        )
        for row in studies
        for worker in _running(service, row)
    ]
    busy.sort(key=_place)
    queue = [_share(row, cores[row.name]) for row in studies]
    pools = [
        PoolOut(
            name=name,
            cores=service.pools.get(name),
            held=sum(worker.cores for worker in busy if worker.pool == name),
            running=sum(worker.pool == name for worker in busy),
            queued=sum(share.queued for share in queue if share.pool == name),
        )
        for name in sorted({*service.pools, *(row.pool for row in studies)})
    ]
    return ClusterOut(cursor=cursor, history=history, host=here, pools=pools, workers=busy, queue=queue)


def _cores(row: StudyRow) -> float:
    """Cores of each of a study's trials."""
    resources = row.spec.get("resources")
    return float(resources.get("cpus", 1.0)) if isinstance(resources, Mapping) else 1.0


def _share(row: StudyRow, cores: float) -> ShareOut:
    queued = _queued(row)
    return ShareOut(
        **dict(queued),
        waiting=row.state is StudyState.QUEUED or queued.queued > 0,
        cores_held=queued.running * cores,
        cores_wanted=queued.parallel * cores,
        core_seconds=row.seconds * cores,
        samples=row.samples,
    )


def resident(pid: int | None) -> int | None:
    """Resident bytes of a process of this machine; None where it is gone or the system doesn't say."""
    if pid is None:
        return None
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


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
