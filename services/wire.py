"""HTTP to a service: token, time limits, and what each answer means to the person who asked."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import httpx
from pydantic import BaseModel, ValidationError

from services.api.models import Page
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

TIMEOUT = httpx.Timeout(180.0, connect=10.0)
"""Seconds. To check its first study a service imports the task and the search: 35 s were seen on a busy machine."""

KINDS: Mapping[str, type[HalmaError]] = {
    kind.__name__: kind
    for kind in (
        ArtifactDamaged,
        DatabaseUnavailable,
        NameTaken,
        Refused,
        StudyDriven,
        UnknownStudy,
        UnknownTrial,
        WrongState,
    )
}
"""Errors that are here what they were there."""

Answer = TypeVar("Answer", bound=BaseModel)
Paged = TypeVar("Paged", bound=Page)
Query = Mapping[str, str | int | float | Sequence[str] | None]


class ServerUnavailable(BadInput):
    """No service answers."""


class ServerRefused(HalmaError):
    """The service answered, but not with what was asked for."""


def read_token(file: Path) -> str:
    """The token to send: `HALMA_TOKEN`, or what the file holds. Raises `BadInput`."""
    given = os.environ.get("HALMA_TOKEN", "").strip()
    if given:
        return given
    try:
        return file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no text"
        raise BadInput(f"expected the service's token in {file} (or HALMA_TOKEN), found: {reason or error}") from None


class Wire:
    """Asks a service.

    Args:
        url: its base URL.
        token: what is sent; asked for with each request, so that a client may be made before the service has one.
        whence: where the token comes from, for messages.
        transport: for tests.

    Raises:
        BadInput: the URL is none.
    """

    def __init__(
        self, url: str, token: Callable[[], str], whence: str, transport: httpx.BaseTransport | None = None
    ) -> None:
        self.url = url.rstrip("/")
        if not self.url.startswith(("http://", "https://")):
            raise BadInput(f"--server: expected a URL such as http://127.0.0.1:8642, found {url}")
        self._token = token
        self._whence = whence
        self._http = httpx.Client(base_url=self.url, timeout=TIMEOUT, transport=transport)

    def close(self) -> None:
        """Let go of the connections."""
        self._http.close()

    def get(self, path: str, answer: type[Answer], **query: str | float | Sequence[str] | None) -> Answer:
        """Ask for one thing."""
        return self._read(self._send("GET", path, query), path, answer)

    def post(
        self, path: str, answer: type[Answer], body: Mapping[str, Any] | None = None, method: str = "POST"
    ) -> Answer:
        """Ask for something to be done."""
        return self._read(self._send(method, path, {}, body), path, answer)

    def read(self, path: str) -> bytes:
        """A file."""
        return self._send("GET", path, {}).content

    def pages(
        self, path: str, answer: type[Paged], limit: int, **query: str | float | Sequence[str] | None
    ) -> Iterator[Paged]:
        """The pages of a list, each asked for when the one before it has been used up.

        Args:
            path: of the list.
            answer: what a page is.
            limit: rows of a page.
            query: what else is asked.
        """
        page: str | None = None
        while True:
            found = self.get(path, answer, limit=limit, page=page, **query)
            yield found
            if found.next is None:
                return
            page = found.next

    def _send(self, method: str, path: str, query: Query, body: Mapping[str, Any] | None = None) -> httpx.Response:
        given = {name: value for name, value in query.items() if value is not None}
        headers = {"Authorization": f"Bearer {self._token()}"}
        try:
            answer = self._http.request(method, path, params=given, json=body, headers=headers)
        except httpx.InvalidURL as error:
            raise BadInput(
                f"--server: expected a URL such as http://127.0.0.1:8642, found {self.url} ({error})"
            ) from None
        except httpx.ReadTimeout:
            done = "; see with `halma ls` whether the study was taken" if path == "/api/v1/studies" else "; try again"
            raise ServerUnavailable(
                f"expected an answer of the service at {self.url} within {TIMEOUT.read:.0f} s, found none{done}"
            ) from None
        except (httpx.HTTPError, UnicodeEncodeError) as error:
            raise ServerUnavailable(
                f"expected a service at {self.url}, found: {error}; start one with `halma serve`, "
                "or run the study here with `halma run FILE`"
            ) from None
        if answer.is_success:
            return answer
        raise self._refusal(answer, path)

    def _read(self, answer: httpx.Response, path: str, kind: type[Answer]) -> Answer:
        try:
            # What a newer service says beside what we know is no error.
            return kind.model_validate_json(answer.content, extra="ignore")
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise ServerRefused(
                f"expected the service at {self.url} to answer {path} as this halma knows it, found status "
                f"{answer.status_code}. {where}{': ' if where else ''}{first['msg']}; {self._versions()}"
            ) from None

    def _refusal(self, answer: httpx.Response, path: str) -> HalmaError:
        try:
            fields = answer.json()
        except ValueError:
            fields = None
        error = fields.get("error") if isinstance(fields, dict) else None
        error = error if isinstance(error, dict) else {}
        message, kind = str(error.get("message") or ""), str(error.get("kind") or "")
        status = answer.status_code
        if status in {401, 403}:
            return BadInput(
                f"expected the token of the service at {self.url} in {self._whence}, found that it is "
                f"refused{f' ({message})' if message else ''}; use the HALMA_HOME the service was started with"
            )
        if kind in KINDS:
            return KINDS[kind](message)
        if status in {404, 405} and kind in {"", "HttpError"}:
            return ServerRefused(
                f"expected a halma service at {self.url} that knows {path}, found status {status}. {self._versions()}"
            )
        if 400 <= status < 500 and message:
            return BadInput(message)
        return ServerRefused(f"expected the service at {self.url} to answer, found status {status}. {message}".rstrip())

    def _versions(self) -> str:
        """Which versions talk to each other, as far as it can be known."""
        from services.version import halma_version  # noqa: PLC0415 - only here

        try:
            answer = self._http.get("/api/v1/server", headers={"Authorization": f"Bearer {self._token()}"})
            other = str(answer.json()["version"])
        except (httpx.HTTPError, ValueError, KeyError, TypeError, HalmaError):
            return "Is it a halma service?"
        here = halma_version()
        hint = "use the same version on both sides" if other != here else "report it: both have the same version"
        return f"The service is halma {other}, this is halma {here}; {hint}"
