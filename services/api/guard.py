"""The gate in front of every request: host, size, identity, origin; and the headers behind every answer.

It is written for ASGI and not as a framework dependency, because it has to hold for pages, static files, the API and
the WebSocket alike, and for routes that somebody adds later: what isn't named as open is closed.

- **Host**: DNS rebinding makes a browser talk to us under a foreign *name*. An address literal can't be rebound, so
  literals, localhost and this machine's names pass, and others only when they are named.
- **Identity**: the token (programs) or a session cookie (browsers).
- **Origin**: a cookie is sent by whatever page caused the request, so with a cookie an unsafe method or a WebSocket
  has to come from our own origin. `SameSite=Strict` says the same; either alone would do.
"""

from __future__ import annotations

import ipaddress
import json
import socket
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from urllib.parse import quote, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from services.auth import COOKIE, Gatekeeper

SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
LARGEST_BODY = 1024 * 1024
"""Bytes; a study file has at most 256 KiB."""

CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
HEADERS = (
    ("content-security-policy", CONTENT_SECURITY_POLICY),
    ("x-content-type-options", "nosniff"),
    ("x-frame-options", "DENY"),
    ("referrer-policy", "same-origin"),
    ("cross-origin-opener-policy", "same-origin"),
    ("cross-origin-resource-policy", "same-origin"),
    ("permissions-policy", "camera=(), geolocation=(), microphone=()"),
)


@dataclass(frozen=True, slots=True)
class Hosts:
    """The names under which this service may be addressed, beside address literals.

    Args:
        names: lower case, without port.
    """

    names: frozenset[str]

    @classmethod
    def of_this_machine(cls, also: Iterable[str] = ()) -> Hosts:
        """localhost, the machine's own name, and what the person named."""
        return cls(frozenset({"localhost", socket.gethostname().lower(), *(name.lower() for name in also)}))

    def allows(self, header: str) -> bool:
        """Whether a Host header names us."""
        try:
            name = urlsplit(f"//{header}").hostname
        except ValueError:
            return False
        if not name:
            return False
        if name in self.names:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True


def bearer(headers: Headers) -> str | None:
    """The token of an Authorization header, or None."""
    scheme, _, token = headers.get("authorization", "").partition(" ")
    return token.strip() if scheme.lower() == "bearer" else None


def session_cookie(headers: Headers) -> str | None:
    """The session of a Cookie header, or None."""
    try:
        morsel = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return None
    return morsel.value if morsel else None


def same_origin(scope: Scope, headers: Headers) -> bool:
    """Whether a browser says that one of our own pages caused this request."""
    origin = headers.get("origin")
    if origin is None:
        return headers.get("sec-fetch-site") == "same-origin"
    expected = {"http": "http", "https": "https", "ws": "http", "wss": "https"}[scope["scheme"]]
    return origin == f"{expected}://{headers.get('host', '')}"


class Guard:
    """The gate, as ASGI middleware.

    Args:
        app: what is behind it.
        gate: knows token and sessions.
        hosts: names of this service.
        open_paths: paths that need no identity (the login page and its style, the health checks).
        login_path: where a browser without a session is sent.
    """

    def __init__(
        self, app: ASGIApp, *, gate: Gatekeeper, hosts: Hosts, open_paths: Collection[str], login_path: str = "/login"
    ) -> None:
        self._app = app
        self._gate = gate
        self._hosts = hosts
        self._open = frozenset(open_paths)
        self._login = login_path

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One connection."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._refusal(scope, headers)
        if scope["type"] == "websocket":
            if refusal is None:
                await self._app(scope, receive, send)
            else:
                await send({"type": "websocket.close", "code": 4401, "reason": refusal[1]})
            return
        send = _with_headers(send)
        if refusal is not None:
            await _refuse(scope, headers, refusal, send, self._login)
            return
        if scope["method"] in SAFE:
            await self._app(scope, receive, send)
            return
        body = await _body(headers, receive)
        if body is None:
            message = f"expected at most {LARGEST_BODY} bytes in a request, found more"
            await _answer(send, 413, "TooLarge", message)
            return
        await self._app(scope, _replay(body, receive), send)

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        """Status and reason of a refusal, or None."""
        if not self._hosts.allows(headers.get("host", "")):
            return 421, (
                f"expected a Host header that names this service, found {headers.get('host', '')!r}; "
                "start it with `halma serve --allow-host NAME` to serve under another name"
            )
        unsafe = scope["type"] == "websocket" or scope["method"] not in SAFE
        if scope["path"] in self._open:
            # Nobody may be logged in as somebody else by a foreign page either.
            cross = unsafe and "origin" in headers and not same_origin(scope, headers)
            return (403, _FOREIGN) if cross else None
        token = bearer(headers)
        if token is not None:
            return None if self._gate.is_token(token) else (401, "the token in the Authorization header is wrong")
        session = session_cookie(headers)
        if session is None:
            return 401, "expected `Authorization: Bearer TOKEN` or a session; the token is in HALMA_HOME/token"
        if not self._gate.is_session(session):
            return 401, "the session has ended; log in again"
        return (403, _FOREIGN) if unsafe and not same_origin(scope, headers) else None


_FOREIGN = "expected a request from this service's own pages, found one from another origin"


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS:
                headers.setdefault(name, value)
            # What is behind a login belongs in no shared or lasting cache unless its route says otherwise.
            headers.setdefault("cache-control", "no-store")
        await send(message)

    return sending


async def _refuse(scope: Scope, headers: Headers, refusal: tuple[int, str], send: Send, login: str) -> None:
    status, reason = refusal
    wants_page = scope["method"] in {"GET", "HEAD"} and "text/html" in headers.get("accept", "")
    if status == 401 and wants_page and not scope["path"].startswith("/api/"):
        query = scope["query_string"].decode("latin-1")
        target = quote(scope["path"] + (f"?{query}" if query else ""), safe="/")
        location = login if target == "/" else f"{login}?next={target}"
        await send(
            {
                "type": "http.response.start",
                "status": 303,
                "headers": [(b"location", location.encode("latin-1")), (b"content-length", b"0")],
            }
        )
        await send({"type": "http.response.body", "body": b""})
        return
    kind = {401: "Unauthenticated", 403: "ForeignOrigin", 421: "UnknownHost"}[status]
    await _answer(send, status, kind, reason)


async def _answer(send: Send, status: int, kind: str, message: str) -> None:
    error: dict[str, object] = {"kind": kind, "message": message, "line": None, "field": "", "problems": []}
    body = json.dumps({"error": error}).encode()
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
    if status == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


async def _body(headers: Headers, receive: Receive) -> bytes | None:
    """The whole body, or None where it is too large."""
    declared = headers.get("content-length", "")
    if declared.isdigit() and int(declared) > LARGEST_BODY:
        return None
    body = bytearray()
    while True:
        message = await receive()
        if message["type"] == "http.disconnect":
            return bytes(body)
        body += message.get("body", b"")
        if len(body) > LARGEST_BODY:
            return None
        if not message.get("more_body", False):
            return bytes(body)


def _replay(body: bytes, receive: Receive) -> Receive:
    given = False

    async def again() -> Message:
        nonlocal given
        if given:
            return await receive()
        given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return again
