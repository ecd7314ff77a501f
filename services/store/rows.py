"""Rows of the tables to the port's frozen values, and values to columns.

Done by hand rather than by SQLAlchemy's column types: a window of 10,000 trials has 40,000 JSON columns and 30,000
times, and most of them are null or empty.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from services.states import AttemptState, StudyState, TrialState
from services.store.port import (
    JSON,
    ArtifactRoot,
    ArtifactRow,
    AttemptRow,
    Driver,
    EventRow,
    MetricRow,
    ProposalRow,
    StudyRow,
    TrialRow,
)
from services.store.schema import artifacts, attempts, events, metrics, proposals, studies, trials

_ENCODER = json.JSONEncoder(allow_nan=False)
TRIAL_STATES = {state.value: state for state in TrialState}
"""Looking a state up in a dict takes a tenth of calling the enum."""

STUDY = tuple(studies.c[name] for name in (
    "id", "name", "state", "reason", "wanted", "spec", "seed", "priority", "pool", "target_trials", "target_cost",
    "driver_id", "driver_host", "driver_pid", "driver_started", "driven_since", "drive_token", "drive_beat",
    "created_at", "finished_at",
))  # fmt: skip
TRIAL = tuple(trials.c[name] for name in (
    "id", "study_id", "number", "stage", "state", "params", "z", "warm_start", "seed", "proposal_id", "info",
    "position", "value", "features", "details", "message", "samples", "seconds", "iteration", "attempts", "retries",
    "created_at", "started_at", "finished_at",
))  # fmt: skip
ATTEMPT = tuple(attempts.c[name] for name in (
    "id", "trial_id", "number", "state", "token", "worker", "host", "pid", "beat", "first_iteration", "started_at",
    "beat_at", "ended_at", "reason",
))  # fmt: skip
ARTIFACT = tuple(artifacts.c[name] for name in ("id", "trial_id", "name", "path", "sha256", "size", "created_at"))
PROPOSAL = tuple(proposals.c[name] for name in (
    "id", "study_id", "strategy", "history", "pending", "rng_key", "count", "seconds", "info", "created_at",
))  # fmt: skip
METRIC = tuple(metrics.c[name] for name in ("iteration", "attempt", "metrics"))
EVENT = (events.c.id, events.c.study_id, studies.c.name, events.c.trial, events.c.kind, events.c.payload, events.c.at)


def now() -> str:
    """The time, for people: UTC, ISO 8601, microseconds."""
    return datetime.now(UTC).isoformat(timespec="microseconds")


def encode(what: str, value: JSON) -> str:
    """JSON text. Raises ValueError for NaN and infinities, which JSON has no word for, naming `what` holds them."""
    try:
        return _ENCODER.encode(value)
    except ValueError as error:
        raise ValueError(
            f"{what}: expected numbers that are finite, found {value!r}; a diverged training has no value"
        ) from error


def finite(what: str, value: float | None) -> float | None:
    """The value as a float. Raises ValueError for NaN (which SQLite would silently store as null) and infinities."""
    if value is None:
        return None
    if not math.isfinite(value):
        raise ValueError(f"{what}: expected a finite number, found {value}; a diverged training has no value")
    return float(value)


def amount(what: str, value: float) -> float:
    """A cost. Raises ValueError where it is negative or not finite."""
    if not 0 <= value < math.inf:
        raise ValueError(f"{what}: expected a finite number from 0, found {value}")
    return value


def seed_text(seed: int) -> str:
    """A seed as the tables hold it. Raises ValueError beyond unsigned 64 bits."""
    if not 0 <= seed < 1 << 64:
        raise ValueError(f"seed: expected an unsigned 64-bit integer, found {seed}")
    return str(int(seed))


def clean(text: str) -> str:
    """Text that both engines take: messages from failing code may hold NUL bytes and lone surrogates."""
    return text.encode("utf-8", "backslashreplace").decode().replace("\0", "\\0")


def _time(text: str | None) -> datetime | None:
    return None if text is None else datetime.fromisoformat(text)


def _real(value: float | None) -> float | None:
    # SQLite keeps 3.0 as the integer 3, and its RETURNING forgets to turn it back.
    return None if value is None else float(value)


def study_row(
    row: Sequence[Any],
    counts: Mapping[str, int] | None = None,
    samples: int = 0,
    seconds: float = 0.0,
    best_value: float | None = None,
) -> StudyRow:
    """A study from its columns (in the order of `STUDY`) and what was counted of its trials."""
    (
        id_, name, state, reason, wanted, spec, seed, priority, pool, target_trials, target_cost,
        driver_id, driver_host, driver_pid, driver_started, driven_since, drive_token, drive_beat,
        created_at, finished_at,
    ) = row  # fmt: skip
    return StudyRow(
        id=id_,
        name=name,
        state=StudyState(state),
        reason=reason,
        wanted=wanted,
        spec=json.loads(spec),
        seed=int(seed),
        priority=priority,
        pool=pool,
        target_trials=target_trials,
        target_cost=target_cost,
        driver=None if driver_id is None else Driver(driver_id, driver_host, driver_pid, driver_started),
        driven_since=_time(driven_since),
        drive_token=drive_token,
        drive_beat=drive_beat,
        created_at=datetime.fromisoformat(created_at),
        finished_at=_time(finished_at),
        counts=counts or {},
        samples=samples,
        seconds=seconds,
        best_value=best_value,
    )


def trial_row(row: Sequence[Any]) -> TrialRow:
    """A trial from its columns, in the order of `TRIAL`."""
    (
        id_, study_id, number, stage, state, params, z, warm_start, seed, proposal_id, info,
        position, value, features, details, message, samples, seconds, iteration, attempt_count, retries,
        created_at, started_at, finished_at,
    ) = row  # fmt: skip
    return TrialRow(
        id_,
        study_id,
        number,
        stage,
        TRIAL_STATES[state],
        json.loads(params),
        _real(z),
        warm_start,
        int(seed),
        proposal_id,
        {} if info == "{}" else json.loads(info),
        position,
        _real(value),
        None if features is None else tuple(json.loads(features)),
        {} if details == "{}" else json.loads(details),
        message,
        samples,
        float(seconds),
        iteration,
        attempt_count,
        retries,
        datetime.fromisoformat(created_at),
        _time(started_at),
        _time(finished_at),
    )


def attempt_row(row: Sequence[Any]) -> AttemptRow:
    """An attempt from its columns, in the order of `ATTEMPT`."""
    (
        id_, trial_id, number, state, token, worker, host, pid, beat, first_iteration, started_at,
        beat_at, ended_at, reason,
    ) = row  # fmt: skip
    return AttemptRow(
        id=id_,
        trial_id=trial_id,
        number=number,
        state=AttemptState(state),
        token=token,
        worker=worker,
        host=host,
        pid=pid,
        beat=beat,
        first_iteration=first_iteration,
        started_at=datetime.fromisoformat(started_at),
        beat_at=datetime.fromisoformat(beat_at),
        ended_at=_time(ended_at),
        reason=reason,
    )


def artifact_row(row: Sequence[Any]) -> ArtifactRow:
    """An artifact from its columns, in the order of `ARTIFACT`."""
    id_, trial_id, name, path, sha256, size, created_at = row
    return ArtifactRow(id_, trial_id, name, path, sha256, size, datetime.fromisoformat(created_at))


def artifact_root(text: str) -> ArtifactRoot:
    """Where the artifacts are, from the text in `meta`."""
    return ArtifactRoot(**json.loads(text))


def proposal_row(row: Sequence[Any]) -> ProposalRow:
    """A proposal from its columns, in the order of `PROPOSAL`."""
    id_, study_id, strategy, history, pending, rng_key, count, seconds, info, created_at = row
    return ProposalRow(
        id=id_,
        study_id=study_id,
        strategy=strategy,
        history=history,
        pending=tuple(json.loads(pending)),
        rng_key=tuple(json.loads(rng_key)),
        count=count,
        seconds=seconds,
        info=json.loads(info),
        created_at=datetime.fromisoformat(created_at),
    )


def metric_row(row: Sequence[Any]) -> MetricRow:
    """The metrics of an iteration from their columns, in the order of `METRIC`."""
    iteration, attempt, values = row
    return MetricRow(iteration, attempt, json.loads(values))


def event_row(row: Sequence[Any]) -> EventRow:
    """An event from its columns, in the order of `EVENT`. A deleted study's name is in the payload."""
    id_, study_id, study, trial, kind, text, at = row
    payload = json.loads(text)
    if study is None and study_id is not None:
        study = payload.get("study")
    return EventRow(id_, study_id, study, trial, kind, payload, datetime.fromisoformat(at))
