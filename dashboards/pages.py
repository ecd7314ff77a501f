"""The pages. Plain functions: FastAPI runs them in threads, so building a page never delays the API.

A page carries the cursor of the record that it was made from, and its script listens from there on.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request
from fastapi.responses import RedirectResponse, Response
from sqlalchemy.engine import make_url

from dashboards.examples import EXAMPLES
from dashboards.rendering import page, static_root
from services.api.models import StudyOut, StudySummary
from services.api.parameters import LARGEST_ID
from services.api.service import Service, Uses
from services.states import TrialState
from services.store.port import StudyRow, TrialRow
from services.value import TELLING, UNIT_OF_VALUE, value_words

router = APIRouter(include_in_schema=False)

Study = Annotated[str, Path(max_length=255)]
Number = Annotated[int, Path(ge=0, le=LARGEST_ID)]
MOST_RELATIVES = 50


def position(service: Service) -> dict[str, Any]:
    """Where the record stands, for the page's script. Read before anything else."""
    return {
        "cursor": service.store.last_event(),
        "history": service.store.history_id(),
        "boot": service.hub.boot,
    }


@router.get("/favicon.ico")
def favicon() -> Response:
    """What browsers ask for unasked."""
    return RedirectResponse(f"{static_root()}/icon.svg", 302)


@router.get("/")
def studies(request: Request, service: Uses) -> Response:
    """All studies."""
    data = position(service)
    data["studies"] = [StudySummary.of(row) for row in service.store.studies()]
    return page(request, "studies.html", data=data, can_submit=service.submit is not None)


@router.get("/cluster")
@router.get("/workers")
def cluster(request: Request, service: Uses) -> Response:
    """Who is doing what, and what waits."""
    return page(request, "workers.html", data=position(service))


@router.get("/submit")
def submit(request: Request, service: Uses, study: str = "") -> Response:
    """Paste or upload a study file; with `study`, one like it."""
    text = ""
    if study:
        row = service.studies.study(study)
        text = as_yaml(row, f"{row.name}-2")
    return page(request, "submit.html", text=text, can_submit=service.submit is not None, examples=EXAMPLES)


def as_yaml(study: StudyRow, name: str) -> str:
    """A study as the file that asks for it, under a name."""
    import yaml  # noqa: PLC0415  (this page only)

    from services.spec import StudySpec  # noqa: PLC0415

    asked = {name: given(study.spec[name]) for name in StudySpec.model_fields if name in study.spec}
    asked = {name: value for name, value in asked.items() if value not in (None, {})}
    for parameter in asked.get("space", {}).values():
        # A linear scale is what everybody takes for granted.
        if isinstance(parameter, dict) and parameter.get("log") is False:
            del parameter["log"]
    asked["name"] = name
    # The innermost mappings and lists in one line each, as people write them.
    text: str = yaml.safe_dump(asked, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110)
    return text


def given(value: Any) -> Any:
    """A part of a spec without what nobody has to write: nothing, and empty mappings."""
    if not isinstance(value, Mapping):
        return value
    return {name: given(inner) for name, inner in value.items() if inner is not None and inner != {}}


def study_view(request: Request, service: Service, name: str, view: str) -> Response:
    """One of the views of a study."""
    data = position(service)
    row = service.studies.study(name)
    data["study"] = StudyOut.of(row)
    data["view"] = view
    data["value"] = value_data(service, row)
    text = as_yaml(row, row.name) if view == "file" else ""
    return page(request, "study.html", data=data, study=row, view=view, text=text)


def value_of(service: Service, row: StudyRow) -> dict[str, str]:
    """What a study's value is called, its unit, and both as the title of an axis.

    A spec doesn't say; a named result that equals the value in the trials that finished first does.
    """
    told = value_words(service.store.trials(row.id, states=[TrialState.COMPLETE], limit=TELLING))
    return {"name": told.name, "unit": told.unit, "title": told.title}


def value_data(service: Service, row: StudyRow) -> dict[str, Any]:
    """The same for a page's script, which has to find out by itself where no trial is complete yet."""
    return {**value_of(service, row), "units": UNIT_OF_VALUE}


@router.get("/studies/{study}")
def overview(request: Request, service: Uses, study: Study) -> Response:
    """What a study found."""
    return study_view(request, service, study, "overview")


@router.get("/studies/{study}/trials")
def trials(request: Request, service: Uses, study: Study) -> Response:
    """The table of a study's trials."""
    return study_view(request, service, study, "trials")


@router.get("/studies/{study}/search")
def search(request: Request, service: Uses, study: Study) -> Response:
    """What the search believes, and why it asked."""
    return study_view(request, service, study, "search")


@router.get("/studies/{study}/quality")
def quality(request: Request, service: Uses, study: Study) -> Response:
    """How good, at what cost, and what made the difference."""
    return study_view(request, service, study, "quality")


@router.get("/studies/{study}/events")
def events(request: Request, service: Uses, study: Study) -> Response:
    """What happened in a study."""
    return study_view(request, service, study, "events")


@router.get("/studies/{study}/file")
def study_file(request: Request, service: Uses, study: Study) -> Response:
    """What was asked for."""
    return study_view(request, service, study, "file")


@router.get("/studies/{study}/trials/{number}")
def trial(request: Request, service: Uses, study: Study, number: Number) -> Response:
    """One trial."""
    data = position(service)
    row = service.studies.study(study)
    one = service.store.trial(row.id, number)
    artifacts = service.store.artifacts(one.id)
    names = {artifact.name for artifact in artifacts}
    data["study"] = row.name
    data["trial"] = number
    data["state"] = one.state.value
    data["task"] = str((row.spec.get("task") or {}).get("name", ""))
    last = max(sum(row.counts.values()) - 1, 0)
    return page(
        request,
        "trial.html",
        data=data,
        study=row,
        trial=one,
        attempts=service.store.attempts(one.id),
        artifacts=artifacts,
        pose="pose.png" in names,
        replay="replay.bin" in names,
        units=row.spec.get("units") or {},
        behaviour=behaviour(row, one),
        details=shown_details(one),
        tables=shown_tables(one),
        log="log.txt" in names,
        family=family(service, row, one),
        command=repeat_command(service.store.url, row.name, number) if row.spec.get("trains") else "",
        value=value_of(service, row),
        called=str(one.details.get("name") or ""),
        last=last,
        is_open=one.state in {TrialState.QUEUED, TrialState.RUNNING},
    )


def family(service: Service, study: StudyRow, one: TrialRow) -> dict[str, list[int]]:
    """Whose policy a trial started from, back to the first, and who started from its own."""
    ancestors: list[int] = []
    at = one.warm_start
    while at is not None and at not in ancestors and len(ancestors) < MOST_RELATIVES:
        ancestors.append(at)
        at = service.store.trial(study.id, at).warm_start
    # Only a search over difficulties hands policies on; nobody else's 50,000 trials need to be read for it.
    everybody = service.trials.all_trials(study) if study.spec.get("has_difficulty") else []
    children = [trial.number for trial in everybody if trial.warm_start == one.number]
    return {"ancestors": ancestors, "children": children[:MOST_RELATIVES]}


def repeat_command(url: str, study: str, number: int) -> str:
    """What to type to simulate a trial's policy again and compare it with what was kept."""
    place = make_url(url)
    database = f" --db {shlex.quote(place.database)}" if place.get_backend_name() == "sqlite" and place.database else ""
    return f"halma replay {shlex.quote(study)} {number} --check{database}"


def behaviour(study: StudyRow, one: TrialRow) -> list[dict[str, Any]]:
    """Name, coordinate and unit of each feature of a trial."""
    declared: Mapping[str, Any] = study.spec.get("behaviour") or {}
    features = one.features or ()
    facing = one.details.get("facing")
    if declared.get("kind") == "rotation" and isinstance(facing, float):
        # Four coordinates of a rotation are for programs; they stand among the results.
        return [{"name": "facing", "value": facing, "unit": "rad"}]
    names = list(declared.get("names", ()))
    names += [f"feature {index}" for index in range(len(names), len(features))]
    return [
        # The coordinates of a rotation are those of a quaternion; its unit is that of the angle between two.
        {"name": name, "value": value, "unit": "" if declared.get("kind") == "rotation" else declared.get("unit", "")}
        for name, value in zip(names, features, strict=False)
    ]


def shown_details(one: TrialRow) -> list[tuple[str, Any]]:
    """The trial's named results one by one, nested ones by dotted name; those that make a table are left out."""

    def flat(prefix: str, value: Any) -> list[tuple[str, Any]]:
        if isinstance(value, Mapping):
            if _is_table(value):
                return []
            return [pair for key, inner in value.items() for pair in flat(f"{prefix}.{key}" if prefix else key, inner)]
        if isinstance(value, list | tuple):
            plain = ", ".join(f"{item:.4g}" if isinstance(item, float) else str(item) for item in value[:8])
            return [(prefix, plain + (f", … ({len(value)} in all)" if len(value) > 8 else ""))]
        return [(prefix, value)]

    return flat("", one.details)


def shown_tables(one: TrialRow) -> list[tuple[str, list[str], list[tuple[str, list[Any]]]]]:
    """Named results that make tables, such as an audit's checks: dotted name, columns, and rows by name."""

    def tables(prefix: str, value: Any) -> list[tuple[str, list[str], list[tuple[str, list[Any]]]]]:
        if not isinstance(value, Mapping):
            return []
        if _is_table(value):
            columns = list(next(iter(value.values())))
            rows = [(name.replace("_", " "), [row[column] for column in columns]) for name, row in value.items()]
            return [(prefix, columns, rows)]
        return [table for key, inner in value.items() for table in tables(f"{prefix}.{key}" if prefix else key, inner)]

    return tables("", one.details)


def _is_table(value: Mapping[str, Any]) -> bool:
    """Whether a mapping holds at least two mappings of the same names to plain values."""
    rows = list(value.values())
    if len(rows) < 2 or not all(isinstance(row, Mapping) and row for row in rows):
        return False
    alike = all(set(row) == set(rows[0]) for row in rows)
    return alike and not any(isinstance(cell, Mapping | list | tuple) for row in rows for cell in row.values())
