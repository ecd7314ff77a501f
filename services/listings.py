"""Rows of the trial database as plain JSON, the same for the command line and the API."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import Any

from services.store.port import ArtifactRow, EventRow, StudyRow, TrialRow


def study_json(row: StudyRow, *, spec: bool = False) -> dict[str, Any]:
    """A study; with its `spec` where one study is looked at."""
    listed = {
        "name": row.name,
        "state": row.state.value,
        "reason": row.reason,
        "trials": dict(row.counts),
        "target_trials": row.target_trials,
        "target_cost": row.target_cost,
        "best_value": row.best_value,
        "cost": {"samples": row.samples, "seconds": row.seconds},
        "strategy": row.spec.get("search", {}).get("strategy"),
        "task": row.spec.get("task", {}).get("name"),
        "seed": row.seed,
        "priority": row.priority,
        "pool": row.pool,
        "driver": None if row.driver is None else {"host": row.driver.host, "pid": row.driver.pid},
        "created_at": moment(row.created_at),
        "finished_at": moment(row.finished_at),
    }
    return {**listed, "spec": dict(row.spec)} if spec else listed


def trial_json(row: TrialRow, artifacts: Sequence[ArtifactRow]) -> dict[str, Any]:
    """A trial with what it left. The first keys and their order are a promise to scripts."""
    return {
        "number": row.number,
        "state": row.state.value,
        "stage": row.stage,
        "params": dict(row.params),
        "z": row.z,
        "value": row.value,
        "features": None if row.features is None else list(row.features),
        "cost": {"samples": row.samples, "seconds": row.seconds},
        "attempts": row.attempts,
        "warm_start": row.warm_start,
        "seed": row.seed,
        "message": row.message,
        "details": dict(row.details),
        "artifacts": {
            artifact.name: {"sha256": artifact.sha256, "size": artifact.size}
            for artifact in sorted(artifacts, key=lambda artifact: artifact.name)
        },
        "iteration": row.iteration,
        "position": row.position,
        "info": dict(row.info),
        "created_at": moment(row.created_at),
        "started_at": moment(row.started_at),
        "finished_at": moment(row.finished_at),
    }


def artifacts_by_trial(left: Iterable[ArtifactRow]) -> dict[int, list[ArtifactRow]]:
    """What the trials of a study left, by id of the trial."""
    found: dict[int, list[ArtifactRow]] = {}
    for artifact in left:
        found.setdefault(artifact.trial_id, []).append(artifact)
    return found


def event_json(row: EventRow) -> dict[str, Any]:
    """Something that happened; `id` is the cursor."""
    return {
        "id": row.id,
        "study": row.study,
        "trial": row.trial,
        "kind": row.kind,
        "payload": dict(row.payload),
        "at": moment(row.at),
    }


def moment(at: datetime | None) -> str | None:
    """A time as ISO 8601."""
    return None if at is None else at.isoformat()
