"""Logging in: the token for a session."""

from __future__ import annotations

import math
from typing import Annotated

from fastapi import APIRouter, Form, Query, Request
from fastapi.responses import RedirectResponse, Response

from dashboards.rendering import page, static_root
from services.auth import COOKIE, SESSION_SECONDS, Gatekeeper, LoginThrottle

router = APIRouter(include_in_schema=False)


def open_paths() -> frozenset[str]:
    """The login page and what it needs; everything else is behind it."""
    needed = ("style.css", "theme.js", "icon.svg")
    return frozenset({"/login", "/favicon.ico", *(f"{static_root()}/{name}" for name in needed)})


def inside(target: str) -> str:
    """A path of this service; the start page for anything that would lead elsewhere."""
    plain = target.startswith("/") and not target.startswith(("//", "/\\")) and target.isprintable()
    return target if plain else "/"


@router.get("/login")
def form(request: Request, next: Annotated[str, Query(max_length=2000)] = "/") -> Response:  # noqa: A002  (in URLs)
    """The login page."""
    return page(request, "login.html", next=inside(next), problem="")


@router.post("/login")
def log_in(
    request: Request,
    token: Annotated[str, Form(max_length=500)] = "",
    next: Annotated[str, Form(max_length=2000)] = "/",  # noqa: A002  (in URLs)
) -> Response:
    """Trade the token for a session cookie."""
    gate: Gatekeeper = request.app.state.gate
    throttle: LoginThrottle = request.app.state.throttle
    address = request.client.host if request.client else "unknown"
    target = inside(next)
    wait = math.ceil(throttle.wait(address))
    if wait:
        problem = f"Too many wrong tokens from {address}. Try again in {wait} s."
        answer: Response = page(request, "login.html", 429, next=target, problem=problem)
        answer.headers["retry-after"] = str(wait)
        return answer
    if not gate.is_token(token.strip()):
        throttle.failed(address)
        return page(request, "login.html", 401, next=target, problem="That is not the token of this service.")
    answer = RedirectResponse(target, 303)
    answer.set_cookie(
        COOKIE,
        gate.new_session(),
        max_age=SESSION_SECONDS,
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
    )
    return answer


@router.post("/logout")
def log_out() -> Response:
    """End the browser's session."""
    answer = RedirectResponse("/login", 303)
    answer.delete_cookie(COOKIE, httponly=True, samesite="strict")
    return answer
