"""The web application: the API, and the pages over it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Response
from fastapi.staticfiles import StaticFiles

from dashboards import login, pages
from dashboards.errors import add_page_errors
from dashboards.rendering import static_root
from dashboards.vendor import missing
from services.api.assembly import create_api
from services.api.service import Artifacts, Submit
from services.auth import Gatekeeper, LoginThrottle
from services.store.port import Store

STATIC = Path(__file__).parent / "static"


class KeptFiles(StaticFiles):
    """Files whose content is named by their path: a browser asks once."""

    def file_response(self, *args: Any, **options: Any) -> Response:
        """The file, to be kept."""
        answer = super().file_response(*args, **options)
        answer.headers["cache-control"] = "private, max-age=31536000, immutable"
        return answer


def create_app(
    store: Store,
    artifacts: Artifacts,
    *,
    token: str,
    submit: Submit | None = None,
    on_change: Callable[[], None] | None = None,
    hosts: Collection[str] = (),
    pools: Mapping[str, int] | None = None,
) -> FastAPI:
    """API and pages on one port.

    Args:
        store: the trial database.
        artifacts: the trials' files.
        token: what programs send and people log in with.
        submit: takes study files; None for a server that only shows.
        on_change: called after something was asked for (a study submitted, paused, ...).
        hosts: further host names of this service.
        pools: cores by worker pool, where they are known.
    """
    gate = Gatekeeper(token)
    app = create_api(
        store,
        artifacts,
        gate=gate,
        submit=submit,
        on_change=on_change,
        hosts=hosts,
        open_paths=login.open_paths(),
        pools=pools,
    )
    app.state.gate = gate
    app.state.throttle = LoginThrottle()
    app.state.missing_libraries = missing()
    add_page_errors(app)
    app.include_router(login.router)
    app.include_router(pages.router)
    app.mount(static_root(), KeptFiles(directory=STATIC), name="static")
    return app
