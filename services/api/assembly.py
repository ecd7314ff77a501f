"""The API as a FastAPI app, closed by the guard. The dashboards add their pages to it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

from fastapi import FastAPI

from services.api import health, insights, monitoring, pulse, reference, routes, sockets, trials
from services.api.answers import Answers
from services.api.distinct import Distinct
from services.api.errors import add_error_handlers
from services.api.guard import Guard, Hosts
from services.api.known import KnownStudies
from services.api.live import Hub
from services.api.looks import Looks
from services.api.parameters import ERRORS
from services.api.service import Artifacts, Service, Submit
from services.api.tables import FinishedTrials
from services.api.windows import Finder
from services.auth import Gatekeeper
from services.store.port import Store
from services.version import halma_version

HEALTH = frozenset({"/healthz", "/readyz"})


def create_api(
    store: Store,
    artifacts: Artifacts,
    *,
    gate: Gatekeeper,
    submit: Submit | None = None,
    on_change: Callable[[], None] | None = None,
    hosts: Collection[str] = (),
    open_paths: Collection[str] = (),
    pools: Mapping[str, int] | None = None,
) -> FastAPI:
    """The API over a store.

    Args:
        store: the trial database.
        artifacts: the trials' files.
        gate: knows token and sessions.
        submit: takes study files; None for a server that only shows.
        on_change: called after something was asked for.
        hosts: further names of this service, beside localhost and the machine's own.
        open_paths: paths that need no identity, beside the health checks.
        pools: cores by worker pool, where they are known.
    """
    # FastAPI's own pages of documentation load their scripts from another host; the description itself is ours.
    app = FastAPI(
        title="halma",
        version=halma_version(),
        summary="Search for motor skills: studies, trials, events",
        openapi_url="/api/v1/openapi.json",
        docs_url=None,
        redoc_url=None,
    )
    finished = FinishedTrials(store)
    app.state.service = Service(
        store,
        artifacts,
        submit,
        on_change or (lambda: None),
        Hub(store),
        finished,
        KnownStudies(store),
        Finder(store, finished),
        Distinct(store),
        Looks(store, finished),
        Answers(store),
        dict(pools or {}),
    )
    add_error_handlers(app)
    app.include_router(routes.router)
    app.include_router(trials.router)
    app.include_router(insights.router)
    app.include_router(monitoring.router, responses=ERRORS)
    app.include_router(pulse.router, responses=ERRORS)
    app.include_router(reference.router, responses=ERRORS)
    app.include_router(sockets.router)
    app.include_router(health.router)
    app.add_middleware(Guard, gate=gate, hosts=Hosts.of_this_machine(hosts), open_paths=HEALTH | frozenset(open_paths))
    return app
