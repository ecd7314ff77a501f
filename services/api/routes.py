"""Routes about studies, what people ask of them, and events. Plain functions: FastAPI runs them in threads."""

from __future__ import annotations

from fastapi import APIRouter, Response
from sqlalchemy.engine import make_url

from services.amending import checked
from services.api.cursors import PageCursor, after_key, key_of, page_of
from services.api.models import (
    Amendment,
    EventOut,
    EventPage,
    Extension,
    ProposalOut,
    ProposalPage,
    ServerOut,
    StrategyList,
    StrategyOut,
    StudyList,
    StudyOut,
    StudySummary,
    Submission,
)
from services.api.parameters import ERRORS, LARGEST_ID, AfterEvent, Limit, Study
from services.api.service import Service, Uses
from services.budget import check_rounds
from services.errors import BadInput
from services.store.engine import shown
from services.store.port import TrialRow
from services.version import halma_version

router = APIRouter(prefix="/api/v1", responses=ERRORS)


@router.get("/server", tags=["service"])
def server(service: Uses) -> ServerOut:
    """The service, its database and where the record stands."""
    return ServerOut(
        version=halma_version(),
        boot=service.hub.boot,
        history=service.store.history_id(),
        cursor=service.store.last_event(),
        database=shown(make_url(service.store.url)),
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


@router.patch("/studies/{study}", tags=["actions"])
def amend(service: Uses, study: Study, amendment: Amendment) -> StudyOut:
    """Change how a study is run: its priority, share, pool, width, retries. A running study follows at once."""
    row = service.store.study(study)
    fields = checked(row, amendment.fields)
    with service.store.transaction() as change:
        change.amend(study, fields)
    service.changed()
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
    """Give a study more trials, more cost, or its polish more rounds."""
    if not (more.trials or more.cost or more.rounds):
        raise BadInput("extend: expected `trials`, `cost` or `rounds` above 0, found none of them")
    check_rounds(service.store.study(study), more.rounds)
    with service.store.transaction() as change:
        change.extend(study, trials=more.trials, cost=more.cost, rounds=more.rounds)
    service.changed()
    return StudyOut.of(service.store.study(study))


@router.get("/studies/{study}/strategies", tags=["studies"], response_model=StrategyList)
async def strategies(service: Uses, study: Study, page: PageCursor = None, limit: Limit = 200) -> Response:
    """The distinct strategies that a study has found, best first; none where its task has no behaviour."""
    return await service.answers.json(
        ("strategies", study, page, limit), lambda: _strategies(service, study, page, limit)
    )


def _strategies(service: Service, study: str, page: str | None, limit: int) -> StrategyList:
    # The search's geometry comes with torch, which takes a second to import, once.
    from services.report import Finding, behaviour_of  # noqa: PLC0415

    cursor, history = service.store.last_event(), service.store.history_id()
    row = service.studies.study(study)
    behaviour = behaviour_of(row)
    if behaviour is None:
        return StrategyList(cursor=cursor, history=history, distance=None, strategies=[], next=None)

    def place(finding: Finding) -> tuple[int, float, int]:
        value = finding.trial.value
        return (1, 0.0, finding.trial.number) if value is None else (0, -value, finding.trial.number)

    every = service.distinct.of(row, service.trials.history(row)) or []
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
