"""Errors for people: a page that says what happened and where to go; the API's routes keep their JSON."""

from __future__ import annotations

from collections.abc import Mapping
from http import HTTPStatus

from fastapi import FastAPI, Request
from fastapi.responses import Response
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException

from dashboards.rendering import page
from services.api.errors import answer, body_of, headers_of, status_of
from services.api.models import ErrorBody
from services.errors import HalmaError


def wants_page(request: Request) -> bool:
    """Whether a person looks at the answer."""
    return not request.url.path.startswith("/api/") and "text/html" in request.headers.get("accept", "")


def add_page_errors(app: FastAPI) -> None:
    """Show errors as pages to browsers. Comes after the API's handlers and replaces them for both."""

    async def say(request: Request, status: int, body: ErrorBody, headers: Mapping[str, str] | None = None) -> Response:
        if not wants_page(request):
            return answer(status, body, headers)
        title = HTTPStatus(status).phrase
        return await run_in_threadpool(page, request, "error.html", status, title=title, message=body.message)

    @app.exception_handler(HalmaError)
    async def on_halma_error(request: Request, error: HalmaError) -> Response:
        return await say(request, status_of(error), body_of(error), headers_of(error))

    @app.exception_handler(HTTPException)
    async def on_http_error(request: Request, error: HTTPException) -> Response:
        message = f"{request.url.path}: {error.detail or HTTPStatus(error.status_code).phrase}"
        return await say(request, error.status_code, ErrorBody(kind="HttpError", message=message))
