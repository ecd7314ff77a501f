"""How studies are doing, for a list of them: the course of the best value, the strategies, the rate, the time left."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Query, Response
from pydantic import Field

from services.api.models import Model
from services.api.service import Service, Uses
from services.budget import most_trials
from services.course import answers, course
from services.errors import UnknownStudy
from services.states import StudyState
from services.store.port import StudyRow, TrialRow
from services.value import value_words

router = APIRouter(prefix="/api/v1")

MOST_STUDIES = 100
POINTS = 40
"""Of a spark line: it is about as many pixels wide as twice this."""
RECENT = 30
"""Trials that tell the pace: a mean over the whole study would hide that it has become slower."""


class Pulse(Model):
    """How a study is doing."""

    study: str
    best: list[float] = Field(description=f"best value so far, at most {POINTS} points from first trial to last")
    unit: str = Field(description="of its values; empty where they have none")
    distinct: int | None = Field(description="distinct strategies; none where behaviour plays no part")
    samples_per_second: float | None = Field(description="of all its workers together; none where nothing runs")
    seconds_left: float | None = Field(description="at the pace of the newest trials; none where nothing runs")


class Pulses(Model):
    """How several studies are doing."""

    pulses: list[Pulse]


@router.get("/pulse", tags=["studies"], response_model=Pulses)
async def pulse(
    service: Uses,
    study: Annotated[list[str], Query(max_length=MOST_STUDIES, description="names; unknown ones are left out")],
) -> Response:
    """How studies are doing: the course of the best value, the number of strategies, rate and time left."""
    names, now = tuple(dict.fromkeys(study)), time.time()
    # The pace falls while nothing happens: an answer holds for the second it was made in, as far as anybody sees.
    return await service.answers.json(("pulse", names, int(now)), lambda: _pulses(service, names, now))


def _pulses(service: Service, names: Sequence[str], now: float) -> Pulses:
    pulses = []
    for name in names:
        try:
            row = service.studies.study(name)
        except UnknownStudy:
            continue
        history = service.trials.history(row)
        rate, left = pace(row, history, now)
        pulses.append(
            Pulse(
                study=row.name,
                best=spark(history),
                unit=value_words(history).unit,
                distinct=None if (found := service.distinct.of(row, history)) is None else len(found),
                samples_per_second=rate,
                seconds_left=left,
            )
        )
    return Pulses(pulses=pulses)


def spark(history: Sequence[TrialRow]) -> list[float]:
    """Best value so far after each answer, thinned evenly; the last one always among them."""
    best = [step.best for step in course(history) if answers(step.trial) and step.best is not None]
    if len(best) <= POINTS:
        return best
    return [best[round(i * (len(best) - 1) / (POINTS - 1))] for i in range(POINTS)]


def pace(row: StudyRow, history: Sequence[TrialRow], now: float) -> tuple[float | None, float | None]:
    """Samples a second and seconds left, from the trials that finished last; None where there is no telling.

    Args:
        row: the study.
        history: its finished trials, in order of position.
        now: seconds since the epoch.
    """
    recent = [trial for trial in history if trial.finished_at is not None][-RECENT:]
    if row.state is not StudyState.RUNNING or len(recent) < 2:
        return None, None
    began = min((trial.started_at or trial.finished_at).timestamp() for trial in recent if trial.finished_at)
    span = max(now - began, 1e-3)
    samples = sum(trial.samples for trial in recent)
    left = []
    if most := most_trials(row):
        left.append(max(most - len(history), 0) * span / len(recent))
    if row.target_cost and samples:
        left.append(max(row.target_cost - row.samples, 0.0) * span / samples)
    return samples / span, min(left, default=None)
