"""The REST routes, version 1. All are plain functions: FastAPI runs them in threads, never on the event loop."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import Annotated

import pydantic_core
from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import Field
from sqlalchemy.engine import make_url

from services.api.cursors import PageCursor, after_key, key_of, page_of
from services.api.errors import NotHere
from services.api.models import (
    ArtifactOut,
    ArtifactPage,
    AttemptOut,
    AttemptPage,
    ErrorOut,
    EventOut,
    EventPage,
    Extension,
    LeftOut,
    LeftPage,
    Metrics,
    ProposalOut,
    ProposalPage,
    ServerOut,
    StrategyList,
    StrategyOut,
    StudyList,
    StudyOut,
    StudySummary,
    Submission,
    TrialDetail,
    TrialOut,
    TrialPage,
    TrialTable,
    TrialWindow,
)
from services.api.service import Uses
from services.api.tables import csv_columns, csv_lines, table
from services.api.windows import reader
from services.errors import BadInput
from services.states import TrialState
from services.store.port import ArtifactRow, TrialRow
from services.version import halma_version

ERRORS: dict[int | str, dict[str, object]] = {
    status: {"model": ErrorOut, "description": text}
    for status, text in {
        400: "the body is no text of the kind it says it is",
        401: "no token or session, or a wrong one",
        404: "no such study, trial or artifact",
        409: "the state of the study doesn't allow this",
        413: "the request is too large",
        422: "the request or the study file is wrong",
        503: "the trial database can't be reached",
    }.items()
}
LARGEST_ID = 2**63 - 1

router = APIRouter(prefix="/api/v1", responses=ERRORS)

Study = Annotated[str, Path(max_length=255, description="name of the study")]
Number = Annotated[int, Path(ge=0, le=LARGEST_ID, description="number of the trial within its study")]
Limit = Annotated[int, Query(ge=1, le=1000, description="at most so many")]
Sort = Annotated[
    str, Query(max_length=200, description="a field, with - before it descending; e.g. -value, params.rate")
]
States = Annotated[list[TrialState] | None, Query(description="only trials in these states")]
Where = Annotated[
    list[Annotated[str, Field(max_length=300)]] | None,
    Query(max_length=16, description="FIELD OPERATOR VALUE, all of which must hold; e.g. value>=0.5, message~NaN"),
]
Columns = Annotated[
    list[Annotated[str, Field(max_length=200)]] | None,
    Query(max_length=400, description="only these fields, in this order; e.g. number, value, params.rate"),
]
AfterEvent = Annotated[
    int, Query(ge=0, le=LARGEST_ID, description="only events beyond this one: the `cursor` of another answer")
]

MEDIA_TYPES = {".png": "image/png", ".json": "application/json", ".gif": "image/gif", ".mp4": "video/mp4"}
"""What a browser may show by itself; everything else is a download."""


@router.get("/server", tags=["service"])
def server(service: Uses) -> ServerOut:
    """The service, its database and where the record stands."""
    return ServerOut(
        version=halma_version(),
        boot=service.hub.boot,
        history=service.store.history_id(),
        cursor=service.store.last_event(),
        database=make_url(service.store.url).render_as_string(hide_password=True),
    )


@router.get("/studies", tags=["studies"])
def studies(service: Uses, page: PageCursor = None, limit: Limit = 200) -> StudyList:
    """Studies, newest first, a page at a time."""
    # The cursor first: what happens between the two reads is then told again, never missed.
    cursor, history = service.store.last_event(), service.store.history_id()
    newest = LARGEST_ID if page is None else key_of("studies", page, int)[0]
    rows, following = page_of(
        [row for row in service.store.studies() if row.id < newest], limit, "studies", lambda row: (row.id,)
    )
    return StudyList(cursor=cursor, history=history, studies=[StudySummary.of(row) for row in rows], next=following)


@router.post("/studies", status_code=201, tags=["studies"])
def submit(service: Uses, submission: Submission) -> StudyOut:
    """Submit a study file. Nothing is recorded where it is wrong; the error names line and field."""
    if service.submit is None:
        raise BadInput("this server only shows studies; submit to one that was started with `halma serve`")
    row = service.submit(submission.text, submission.overrides, submission.name)
    service.changed()
    return StudyOut.of(row)


@router.get("/studies/{study}", tags=["studies"])
def one_study(service: Uses, study: Study) -> StudyOut:
    """A study with its spec."""
    return StudyOut.of(service.store.study(study))


@router.post("/studies/{study}/pause", tags=["actions"])
def pause(service: Uses, study: Study) -> StudyOut:
    """Let running trials come to their next checkpoint, then wait."""
    return _ask(service, study, "pause")


@router.post("/studies/{study}/resume", tags=["actions"])
def resume(service: Uses, study: Study) -> StudyOut:
    """Go on with a paused or cancelled study."""
    return _ask(service, study, "run")


@router.post("/studies/{study}/cancel", tags=["actions"])
def cancel(service: Uses, study: Study) -> StudyOut:
    """Stop a study; what it found stays."""
    return _ask(service, study, "cancel")


def _ask(service: Uses, study: str, wanted: str) -> StudyOut:
    with service.store.transaction() as change:
        change.ask(study, wanted)
    service.changed()
    return StudyOut.of(service.store.study(study))


@router.post("/studies/{study}/extend", tags=["actions"])
def extend(service: Uses, study: Study, more: Extension) -> StudyOut:
    """Give a study more trials, or more cost."""
    if not more.trials and not more.cost:
        raise BadInput("extend: expected `trials` or `cost` above 0, found neither")
    with service.store.transaction() as change:
        change.extend(study, trials=more.trials, cost=more.cost)
    service.changed()
    return StudyOut.of(service.store.study(study))


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
    row = service.store.study(study)
    if page is not None:
        after = max(after, *key_of("trials", page, int))
    found = service.store.trials(row.id, states=state, after=after, limit=limit + 1)
    rows, following = page_of(found, limit, "trials", lambda trial: (trial.number,))
    return TrialPage(trials=[TrialOut.of(trial) for trial in rows], next=following)


@router.get("/studies/{study}/window", tags=["trials"])
def trial_window(
    service: Uses,
    study: Study,
    sort: Sort = "number",
    state: States = None,
    where: Where = None,
    offset: Annotated[int, Query(ge=0, le=LARGEST_ID, description="rows before the first one wanted")] = 0,
    limit: Limit = 100,
) -> TrialWindow:
    """The rows of a table that a screen shows: filtered and sorted here, so that 50,000 trials stay where they are."""
    found = service.finder.find(service.store.study(study), sort, state, where or [])
    return TrialWindow(
        cursor=found.cursor,
        history=found.history,
        count=found.count,
        matched=len(found.trials),
        offset=offset,
        trials=[TrialOut.of(trial) for trial in found.trials[offset : offset + limit]],
    )


@router.get("/studies/{study}/table", tags=["trials"], response_model=TrialTable)
def trial_table(service: Uses, study: Study) -> Response:
    """All trials as columns, for tables and charts."""
    cursor, history = service.store.last_event(), service.store.history_id()
    rows = service.trials.all_trials(service.store.study(study))
    # Encoded by hand: validating 50,000 rows of our own making would take longer than reading them.
    body = pydantic_core.to_json(table(rows, cursor=cursor, history=history))
    return Response(body, media_type="application/json")


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
    row = service.store.study(study)
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
    return service.store.trial(service.store.study(study).id, number)


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
    row = service.store.study(study)
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


@router.get("/studies/{study}/strategies", tags=["studies"])
def strategies(service: Uses, study: Study, page: PageCursor = None, limit: Limit = 200) -> StrategyList:
    """The distinct strategies that a study has found, best first; none where its task has no behaviour."""
    # The search's geometry comes with torch, which takes a second to import, once.
    from services.report import Finding, behaviour_of, distinct_trials  # noqa: PLC0415

    cursor, history = service.store.last_event(), service.store.history_id()
    row = service.store.study(study)
    behaviour = behaviour_of(row)
    if behaviour is None:
        return StrategyList(cursor=cursor, history=history, distance=None, strategies=[], next=None)

    def place(finding: Finding) -> tuple[int, float, int]:
        value = finding.trial.value
        return (1, 0.0, finding.trial.number) if value is None else (0, -value, finding.trial.number)

    every = sorted(distinct_trials(row, service.trials.history(row)), key=place)
    behind = after_key(every, "strategies", page, place, int, (int, float), int)
    found, following = page_of(behind, limit, "strategies", place)
    return StrategyList(
        cursor=cursor,
        history=history,
        distance=behaviour.distinct,
        strategies=[_strategy(service, finding.trial, len(finding.members)) for finding in found],
        next=following,
    )


def _strategy(service: Uses, trial: TrialRow, members: int) -> StrategyOut:
    left = {row.name for row in service.store.artifacts(trial.id)}
    return StrategyOut(
        number=trial.number,
        value=trial.value,
        features=list(trial.features or ()),
        members=members,
        details=dict(trial.details),
        pose="pose.png" in left,
        replay="replay.bin" in left,
    )


@router.get("/studies/{study}/proposals", tags=["studies"])
def proposals(service: Uses, study: Study, page: PageCursor = None, limit: Limit = 200) -> ProposalPage:
    """What each proposal saw and gave, oldest first, a page at a time."""
    after = 0 if page is None else key_of("proposals", page, int)[0]
    found = service.store.proposals(service.store.study(study).id, after=after, limit=limit + 1)
    rows, following = page_of(found, limit, "proposals", lambda row: (row.id,))
    return ProposalPage(proposals=[ProposalOut.of(row) for row in rows], next=following)


@router.get("/studies/{study}/events", tags=["events"])
def study_events(
    service: Uses, study: Study, page: PageCursor = None, after: AfterEvent = 0, limit: Limit = 200
) -> EventPage:
    """What happened in a study, oldest first, a page at a time."""
    return _events(service, service.store.study(study).id, page, after, limit)


@router.get("/events", tags=["events"])
def events(service: Uses, page: PageCursor = None, after: AfterEvent = 0, limit: Limit = 200) -> EventPage:
    """What happened, oldest first, a page at a time. The WebSocket at the same path tells the same, live."""
    return _events(service, None, page, after, limit)


def _events(service: Uses, study_id: int | None, page: str | None, after: int, limit: int) -> EventPage:
    if page is not None:
        after = max(after, *key_of("events", page, int))
    found = service.store.events(after=after, study_id=study_id, limit=limit + 1)
    rows, following = page_of(found, limit, "events", lambda row: (row.id,))
    return EventPage(events=[EventOut.of(row) for row in rows], next=following)
