"""The pages. Plain functions: FastAPI runs them in threads, so building a page never delays the API.

A page carries the cursor of the record that it was made from, and its script listens from there on.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request
from fastapi.responses import RedirectResponse, Response

from dashboards.rendering import page, static_root
from services.api.models import StudyOut, StudySummary
from services.api.routes import LARGEST_ID
from services.api.service import Service, Uses
from services.states import TrialState
from services.store.port import StudyRow, TrialRow

router = APIRouter(include_in_schema=False)

Study = Annotated[str, Path(max_length=255)]
Number = Annotated[int, Path(ge=0, le=LARGEST_ID)]


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


@router.get("/workers")
def workers(request: Request, service: Uses) -> Response:
    """Who is doing what, and what waits."""
    return page(request, "workers.html", data=position(service))


@router.get("/submit")
def submit(request: Request, service: Uses, study: str = "") -> Response:
    """Paste or upload a study file; with `study`, one like it."""
    text = as_yaml(service.store.study(study)) if study else ""
    return page(request, "submit.html", text=text, can_submit=service.submit is not None)


def as_yaml(study: StudyRow) -> str:
    """A study as the file that asks for it, under a new name."""
    import yaml  # noqa: PLC0415  (this page only)

    from services.spec import StudySpec  # noqa: PLC0415

    asked = {name: given(study.spec[name]) for name in StudySpec.model_fields if name in study.spec}
    asked = {name: value for name, value in asked.items() if value not in (None, {})}
    asked["name"] = f"{study.name}-2"
    text: str = yaml.safe_dump(asked, sort_keys=False, allow_unicode=True)
    return text


def given(value: Any) -> Any:
    """A part of a spec without what nobody has to write: nothing, and empty mappings."""
    if not isinstance(value, Mapping):
        return value
    return {name: given(inner) for name, inner in value.items() if inner is not None and inner != {}}


def study_view(request: Request, service: Service, name: str, view: str) -> Response:
    """One of the views of a study."""
    data = position(service)
    row = service.store.study(name)
    data["study"] = StudyOut.of(row)
    data["view"] = view
    return page(request, "study.html", data=data, study=row, view=view, can_submit=service.submit is not None)


@router.get("/studies/{study}")
def overview(request: Request, service: Uses, study: Study) -> Response:
    """What a study found."""
    return study_view(request, service, study, "overview")


@router.get("/studies/{study}/trials")
def trials(request: Request, service: Uses, study: Study) -> Response:
    """The table of a study's trials."""
    return study_view(request, service, study, "trials")


@router.get("/studies/{study}/parameters")
def parameters(request: Request, service: Uses, study: Study) -> Response:
    """Parameters against outcomes."""
    return study_view(request, service, study, "parameters")


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
    row = service.store.study(study)
    one = service.store.trial(row.id, number)
    artifacts = service.store.artifacts(one.id)
    names = {artifact.name for artifact in artifacts}
    data["study"] = row.name
    data["trial"] = number
    data["state"] = one.state.value
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
        last=last,
        is_open=one.state in {TrialState.QUEUED, TrialState.RUNNING},
    )


def behaviour(study: StudyRow, one: TrialRow) -> list[dict[str, Any]]:
    """Name, coordinate and unit of each feature of a trial."""
    declared: Mapping[str, Any] = study.spec.get("behaviour") or {}
    features = one.features or ()
    names = list(declared.get("names", ()))
    names += [f"feature {index}" for index in range(len(names), len(features))]
    return [
        {"name": name, "value": value, "unit": declared.get("unit", "")}
        for name, value in zip(names, features, strict=False)
    ]


def shown_details(one: TrialRow) -> list[tuple[str, Any]]:
    """The named results of a trial as dotted names and plain values, so that a nested one needs no knowledge."""

    def flat(prefix: str, value: Any) -> list[tuple[str, Any]]:
        if isinstance(value, Mapping):
            return [pair for key, inner in value.items() for pair in flat(f"{prefix}.{key}" if prefix else key, inner)]
        if isinstance(value, list | tuple):
            plain = ", ".join(f"{item:.4g}" if isinstance(item, float) else str(item) for item in value[:8])
            return [(prefix, plain + (f", … ({len(value)} in all)" if len(value) > 8 else ""))]
        return [(prefix, value)]

    return flat("", one.details)
