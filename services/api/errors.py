"""Errors as answers: the services' tree to status codes and one JSON shape."""

from __future__ import annotations

from collections.abc import Mapping
from http import HTTPStatus

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException as StarletteHTTPException

from services.api.models import ErrorBody, ErrorOut, Problem
from services.errors import (
    ArtifactDamaged,
    BadInput,
    DatabaseUnavailable,
    HalmaError,
    NameTaken,
    Refused,
    StudyDriven,
    UnknownStudy,
    UnknownTrial,
    WrongState,
)

STATUS: Mapping[type[HalmaError], int] = {
    UnknownStudy: 404,
    UnknownTrial: 404,
    NameTaken: 409,
    StudyDriven: 409,
    WrongState: 409,
    Refused: 409,
    DatabaseUnavailable: 503,
    ArtifactDamaged: 410,
    BadInput: 422,
}


class NotHere(HalmaError):
    """There is no such thing (artifact, route); the message says what there is."""


class TooOften(HalmaError):
    """Something costly is asked for again and again.

    Args:
        message: what, and when it goes on.
        seconds: until it is answered again.
    """

    def __init__(self, message: str, seconds: int) -> None:
        super().__init__(message)
        self.seconds = seconds


def status_of(error: HalmaError) -> int:
    """Status code of an error, by the nearest class of its tree."""
    if isinstance(error, NotHere):
        return 404
    if isinstance(error, TooOften):
        return 429
    for kind in type(error).__mro__:
        if kind in STATUS:
            return STATUS[kind]
    return 500


def headers_of(error: HalmaError) -> Mapping[str, str]:
    """What the headers tell of an error."""
    return {"retry-after": str(error.seconds)} if isinstance(error, TooOften) else {}


def body_of(error: HalmaError) -> ErrorBody:
    """An error as the API words it. A study file's error carries its problems with line and field."""
    problems = [
        Problem(line=_line(problem.origin), field=problem.field, message=problem.message)
        for problem in getattr(error, "problems", ())
    ]
    first = problems[0] if problems else None
    return ErrorBody(
        kind=type(error).__name__,
        message=str(error),
        line=first.line if first else None,
        field=first.field if first else "",
        problems=problems,
    )


def _line(origin: str) -> int | None:
    """The line of `file:line`; none of an override such as `--set a=b:3`."""
    line = origin.rpartition(":")[2]
    return int(line) if line.isdigit() and not origin.startswith("--") else None


def answer(status: int, body: ErrorBody, headers: Mapping[str, str] | None = None) -> JSONResponse:
    """The JSON answer."""
    return JSONResponse(ErrorOut(error=body).model_dump(mode="json"), status, headers=headers)


def add_error_handlers(app: FastAPI) -> None:
    """Make an app answer with the API's errors."""

    @app.exception_handler(HalmaError)
    async def on_halma_error(_: Request, error: HalmaError) -> JSONResponse:
        return answer(status_of(error), body_of(error), headers_of(error))

    @app.exception_handler(RequestValidationError)
    async def on_invalid_request(_: Request, error: RequestValidationError) -> JSONResponse:
        problems = [
            Problem(line=None, field=".".join(str(part) for part in entry["loc"][1:]), message=entry["msg"])
            for entry in error.errors()
        ]
        said = [f"{problem.field}: {problem.message}".removeprefix(": ") for problem in problems]
        field = problems[0].field if problems else ""
        return answer(422, ErrorBody(kind="BadRequest", message="; ".join(said), field=field, problems=problems))

    @app.exception_handler(StarletteHTTPException)
    async def on_http_error(_: Request, error: StarletteHTTPException) -> JSONResponse:
        message = str(error.detail) or HTTPStatus(error.status_code).phrase
        return answer(error.status_code, ErrorBody(kind="HttpError", message=message), error.headers)
