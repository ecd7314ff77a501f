"""What a search has learnt, and how it went: slices, importances, the ladder of difficulties, lineage, curves."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query

from services.api.cursors import PageCursor, key_of, page_of
from services.api.models import (
    Curve,
    CurveList,
    EdgeOut,
    ImportanceList,
    Ladder,
    LadderPoint,
    LevelOut,
    Lineage,
    NodeOut,
    SliceOut,
)
from services.api.parameters import ERRORS, Study
from services.api.service import Service, Uses
from services.errors import BadInput
from services.store.port import MetricRow, TrialRow

router = APIRouter(prefix="/api/v1", responses=ERRORS, tags=["insight"])

MOST_CURVES = 20
"""Curves of one answer at most."""
MOST_POINTS = 1000
"""Points of one curve at most; a longer one is thinned evenly, its last point kept."""

Most = Annotated[int, Query(ge=1, le=10_000, description="at most so many")]
Name = Annotated[str | None, Query(max_length=200)]


@router.get("/studies/{study}/slice")
async def surrogate_slice(
    service: Uses,
    study: Study,
    x: Annotated[str | None, Query(max_length=200, description="parameter; default: the one that matters most")] = None,
    y: Annotated[str | None, Query(max_length=200, description="parameter; default: the next that matters")] = None,
    at: Annotated[
        str | None, Query(max_length=20_000, description="values of other parameters, a JSON object; default: the best")
    ] = None,
    z: Annotated[float, Query(ge=0, le=1, description="difficulty at which the value is shown")] = 1.0,
    size: Annotated[int, Query(ge=2, le=100, description="grid points along each axis")] = 40,
    output: Annotated[
        str | None,
        Query(max_length=40, description="value, novelty, feasible, or feature:K; default: what the search learns"),
    ] = None,
) -> SliceOut:
    """A slice through the surrogate of the study's own strategy, with samples, pending trials and the next proposal."""
    from search.insight.slices import Ask  # noqa: PLC0415 - scipy, which a server that nobody asks need not load

    ask = Ask(x=x or "", y=y or "", output=output or "", at=_values(at), z=z, size=size)
    return SliceOut.model_validate(await service.looks.slice(study, ask))


def _values(at: str | None) -> dict[str, Any]:
    if at is None:
        return {}
    try:
        values = json.loads(at)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"at: expected a JSON object of parameter values, found no JSON ({error})") from None
    if not isinstance(values, dict):
        raise BadInput(f"at: expected a JSON object of parameter values, found {type(values).__name__}")
    return values


@router.get("/studies/{study}/importance")
async def importance(
    service: Uses,
    study: Study,
    of: Annotated[
        Literal["value", "behaviour"] | None, Query(description="default: what the study's search learns")
    ] = None,
) -> ImportanceList:
    """Which parameters matter, by length scales and by permutation, and the best setting as a study file's section."""
    return ImportanceList.model_validate(await service.looks.importance(study, of))


@router.get("/studies/{study}/ladder")
def ladder(service: Uses, study: Study, page: PageCursor = None, limit: Most = 2000) -> Ladder:
    """Difficulty against trial, and what each level cost. Without levels where the study has no difficulty."""
    from services.fidelity import levels, point  # noqa: PLC0415 - beside its only use

    trials = service.trials.all_trials(service.store.study(study))
    found = levels(trials)
    after = -1 if page is None else key_of("ladder", page, int)[0]
    shown = [trial for trial in trials if trial.number > after] if found else []
    rows, following = page_of(shown, limit, "ladder", lambda trial: (trial.number,))
    return Ladder(
        levels=[LevelOut(**level) for level in found],
        points=[LadderPoint.model_validate(point(trial)) for trial in rows],
        next=following,
    )


@router.get("/studies/{study}/lineage")
def lineage(service: Uses, study: Study, page: PageCursor = None, limit: Most = 2000) -> Lineage:
    """Which trials were warm-started from which. Trials without relatives are left out."""
    trials = service.trials.all_trials(service.store.study(study))
    after = -1 if page is None else key_of("lineage", page, int)[0]
    started = [trial for trial in trials if trial.warm_start is not None and trial.number > after]
    children, following = page_of(started, limit, "lineage", lambda trial: (trial.number,))
    edges = [EdgeOut(parent=trial.warm_start, child=trial.number) for trial in children if trial.warm_start is not None]
    related = {number for edge in edges for number in (edge.parent, edge.child)}
    nodes = [
        NodeOut(
            number=trial.number,
            z=trial.z,
            value=trial.value,
            state=trial.state,
            stage=trial.stage,
            samples=trial.samples,
        )
        for trial in trials
        if trial.number in related
    ]
    return Lineage(nodes=nodes, edges=edges, next=following)


@router.get("/studies/{study}/curves")
def curves(
    service: Uses,
    study: Study,
    numbers: Annotated[
        str, Query(max_length=500, pattern=r"^\d{1,18}(,\d{1,18})*$", description="numbers of trials, with commas")
    ],
    metric: Annotated[str | None, Query(max_length=100, description="default: the return, else the first")] = None,
) -> CurveList:
    """Learning curves of several trials, to be laid over each other."""
    wanted = list(dict.fromkeys(int(number) for number in numbers.split(",")))
    if len(wanted) > MOST_CURVES:
        raise BadInput(f"numbers: expected at most {MOST_CURVES} trials, found {len(wanted)}")
    row = service.store.study(study)
    trials = [service.store.trial(row.id, number) for number in wanted]
    return curves_of(service, trials, metric)


def curves_of(service: Service, trials: list[TrialRow], metric: str | None) -> CurveList:
    """The curves of trials."""
    reported = {trial.number: service.store.metrics(trial.id) for trial in trials}
    names = sorted({name for rows in reported.values() for row in rows for name in row.values})
    if metric is not None and names and metric not in names:
        raise BadInput(f"metric: expected one that these trials reported ({', '.join(names)}), found {metric!r}")
    shown = metric if metric is not None else "return" if "return" in names else next(iter(names), "return")
    return CurveList(
        metric=shown, metrics=names, curves=[_curve(trial, reported[trial.number], shown) for trial in trials]
    )


def _curve(trial: TrialRow, rows: list[MetricRow], metric: str) -> Curve:
    told = [row for row in rows if metric in row.values]
    step = -(-len(told) // MOST_POINTS) or 1
    # counted from the end, so that the newest point is always there
    told = told[::-1][::step][::-1]
    return Curve(
        number=trial.number,
        state=trial.state,
        z=trial.z,
        value=trial.value,
        iterations=[row.iteration for row in told],
        samples=[row.values.get("samples") for row in told],
        values=[row.values[metric] for row in told],
    )
