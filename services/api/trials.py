"""Routes about trials and the files that they left. Plain functions, which run in threads."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import Annotated

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.responses import StreamingResponse

from services.api.cursors import PageCursor, after_key, key_of, page_of
from services.api.errors import NotHere
from services.api.models import (
    ArtifactOut,
    ArtifactPage,
    AttemptOut,
    AttemptPage,
    ErrorOut,
    LeftOut,
    LeftPage,
    Metrics,
    TrialDetail,
    TrialOut,
    TrialPage,
    TrialTable,
    TrialWindow,
)
from services.api.parameters import ERRORS, LARGEST_ID, Columns, Limit, Number, Sort, States, Study, Where
from services.api.service import Uses
from services.api.tables import csv_columns, csv_lines, table
from services.api.windows import reader
from services.states import TrialState
from services.store.port import ArtifactRow, TrialRow

router = APIRouter(prefix="/api/v1", responses=ERRORS)

MEDIA_TYPES = {".png": "image/png", ".json": "application/json", ".gif": "image/gif", ".mp4": "video/mp4"}
"""What a browser may show by itself; everything else is a download."""


@router.get("/studies/{study}/trials", tags=["trials"])
def trials(
    service: Uses,
    study: Study,
    page: PageCursor = None,
    after: Annotated[int, Query(ge=-1, le=LARGEST_ID, description="only trials with a number above it")] = -1,
    limit: Limit = 200,
    state: Annotated[list[TrialState] | None, Query(description="only trials in these states")] = None,
) -> TrialPage:
    """Trials by number, a page at a time."""
    row = service.studies.study(study)
    if page is not None:
        after = max(after, *key_of("trials", page, int))
    found = service.store.trials(row.id, states=state, after=after, limit=limit + 1)
    rows, following = page_of(found, limit, "trials", lambda trial: (trial.number,))
    return TrialPage(trials=[TrialOut.of(trial) for trial in rows], next=following)


@router.get("/studies/{study}/window", tags=["trials"], response_model=TrialWindow)
async def trial_window(
    service: Uses,
    study: Study,
    sort: Sort = "number",
    state: States = None,
    where: Where = None,
    offset: Annotated[int, Query(ge=0, le=LARGEST_ID, description="rows before the first one wanted")] = 0,
    limit: Limit = 100,
) -> Response:
    """The rows of a table that a screen shows: filtered and sorted here, so that 50,000 trials stay where they are."""

    def rows() -> TrialWindow:
        found = service.finder.find(service.studies.study(study), sort, state, where or [])
        return TrialWindow(
            cursor=found.cursor,
            history=found.history,
            count=found.count,
            matched=len(found.trials),
            offset=offset,
            trials=[TrialOut.of(trial) for trial in found.trials[offset : offset + limit]],
        )

    question = ("window", study, sort, frozenset(state or ()), tuple(where or ()), offset, limit)
    return await service.answers.json(question, rows)


@router.get("/studies/{study}/table", tags=["trials"], response_model=TrialTable)
async def trial_table(service: Uses, study: Study) -> Response:
    """All trials as columns, for tables and charts."""

    def columns() -> TrialTable:
        cursor, history = service.store.last_event(), service.store.history_id()
        return table(service.trials.all_trials(service.studies.study(study)), cursor=cursor, history=history)

    return await service.answers.json(("table", study), columns)


@router.get("/studies/{study}/trials.csv", tags=["trials"], response_class=StreamingResponse)
def trials_csv(
    service: Uses,
    study: Study,
    sort: Sort = "number",
    state: States = None,
    where: Where = None,
    column: Columns = None,
) -> StreamingResponse:
    """Trials as CSV: all of them, or those that pass, with all columns or the chosen ones."""
    row = service.studies.study(study)
    rows = service.finder.find(row, sort, state, where or []).trials
    features = {f"features.{i}": name for i, name in enumerate((row.spec.get("behaviour") or {}).get("names", ()))}
    chosen = [(features.get(name, name), reader(name, "column")) for name in column or []]
    return StreamingResponse(
        csv_columns(rows, chosen) if chosen else csv_lines(rows),
        media_type="text/csv; charset=utf-8",
        headers={"content-disposition": f'attachment; filename="{_file_name(row.name)}.csv"'},
    )


@router.get("/studies/{study}/trials/{number}", tags=["trials"])
def one_trial(service: Uses, study: Study, number: Number) -> TrialDetail:
    """A trial with its attempts and artifacts."""
    row = _trial(service, study, number)
    return TrialDetail(
        **dict(TrialOut.of(row)),
        attempt_list=[AttemptOut.of(attempt) for attempt in service.store.attempts(row.id)],
        artifacts={artifact.name: ArtifactOut.of(artifact) for artifact in service.store.artifacts(row.id)},
    )


def _trial(service: Uses, study: str, number: int) -> TrialRow:
    return service.store.trial(service.studies.study(study).id, number)


@router.get("/studies/{study}/trials/{number}/metrics", tags=["trials"])
def metrics(
    service: Uses,
    study: Study,
    number: Number,
    after: Annotated[int, Query(ge=0, le=LARGEST_ID, description="cursor: the last iteration already known")] = 0,
) -> Metrics:
    """The learning curve of a trial."""
    return Metrics.of(service.store.metrics(_trial(service, study, number).id, after=after))


@router.get("/studies/{study}/trials/{number}/attempts", tags=["trials"])
def attempts(service: Uses, study: Study, number: Number, page: PageCursor = None, limit: Limit = 200) -> AttemptPage:
    """The attempts at a trial, by number, a page at a time."""
    found = service.store.attempts(_trial(service, study, number).id)
    behind = after_key(found, "attempts", page, lambda row: (row.number,), int)
    rows, following = page_of(behind, limit, "attempts", lambda row: (row.number,))
    return AttemptPage(attempts=[AttemptOut.of(row) for row in rows], next=following)


@router.get("/studies/{study}/trials/{number}/artifacts", tags=["artifacts"])
def artifacts(service: Uses, study: Study, number: Number, page: PageCursor = None, limit: Limit = 200) -> ArtifactPage:
    """What a trial left, by name, a page at a time."""
    # By code point: databases have orders of their own for text.
    found = sorted(service.store.artifacts(_trial(service, study, number).id), key=lambda row: row.name)
    behind = after_key(found, "artifacts", page, lambda row: (row.name,), str)
    rows, following = page_of(behind, limit, "artifacts", lambda row: (row.name,))
    return ArtifactPage(artifacts={row.name: ArtifactOut.of(row) for row in rows}, next=following)


@router.get("/studies/{study}/artifacts", tags=["artifacts"])
def study_artifacts(service: Uses, study: Study, page: PageCursor = None, limit: Limit = 200) -> LeftPage:
    """What all trials of a study left, by trial and name, a page at a time."""
    row = service.studies.study(study)
    numbers = {trial.id: trial.number for trial in service.trials.all_trials(row)}
    left = [
        (numbers[each.trial_id], each) for each in service.store.study_artifacts(row.id) if each.trial_id in numbers
    ]
    left.sort(key=_place)
    behind = after_key(left, "study artifacts", page, _place, int, str)
    rows, following = page_of(behind, limit, "study artifacts", _place)
    found = [LeftOut(trial=number, name=each.name, **dict(ArtifactOut.of(each))) for number, each in rows]
    return LeftPage(artifacts=found, next=following)


def _place(left: tuple[int, ArtifactRow]) -> tuple[int, str]:
    return left[0], left[1].name


@router.get(
    "/studies/{study}/trials/{number}/artifacts/{name}",
    tags=["artifacts"],
    response_class=Response,
    responses={
        200: {"content": {kind: {} for kind in ("application/octet-stream", *MEDIA_TYPES.values())}},
        304: {"description": "you have it"},
        410: {"model": ErrorOut, "description": "the file is damaged or gone"},
    },
)
def artifact(
    service: Uses, request: Request, study: Study, number: Number, name: Annotated[str, Path(max_length=255)]
) -> Response:
    """One file that a trial left, checked against its hash."""
    rows = service.store.artifacts(_trial(service, study, number).id)
    row = next((row for row in rows if row.name == name), None)
    if row is None:
        there_are = ", ".join(row.name for row in rows) or "none"
        raise NotHere(
            f"artifact {name!r} of trial {number}: expected one of those it left, found none; it left: {there_are}"
        )
    tag = f'"{row.sha256}"'
    headers = {"etag": tag, "cache-control": "private, no-cache"}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    suffix = PurePosixPath(row.name).suffix.lower()
    if suffix not in MEDIA_TYPES:
        headers["content-disposition"] = f'attachment; filename="{_file_name(f"{study}-{number}-{row.name}")}"'
    # A picture that is no picture must not become a page of ours.
    headers["content-security-policy"] = "default-src 'none'; sandbox"
    return Response(
        service.artifacts.read(row), media_type=MEDIA_TYPES.get(suffix, "application/octet-stream"), headers=headers
    )


def _file_name(text: str) -> str:
    """A name that needs no quoting in a header."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", text)
