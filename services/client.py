"""A client of the service's API, for `halma submit`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any, Self

import httpx

from services.address import read_server
from services.errors import BadInput, HalmaError, NameTaken
from services.settings import Settings

TIMEOUT = httpx.Timeout(180.0, connect=10.0)
"""Seconds. To check its first study a service imports the task and the search: 35 s were seen on a busy machine."""


class ServerUnavailable(BadInput):
    """No service answers."""


class ServerRefused(HalmaError):
    """The service answered, but not with what was asked for."""


class Client:
    """Talks to a service.

    Args:
        server: base URL, or None for the one that `HALMA_HOME/server.json` names.
        settings: where the token is.
        transport: for tests.

    Raises:
        ServerUnavailable: none is named.
    """

    def __init__(
        self, settings: Settings, server: str | None = None, transport: httpx.BaseTransport | None = None
    ) -> None:
        if server is None:
            found = read_server(settings.server_file)
            if found is None:
                raise ServerUnavailable(
                    "expected a running service, found none; start one with `halma serve` (in another terminal), "
                    "name one with --server URL, or run the study here with `halma run FILE`"
                )
            server = found.url
        self.url = server.rstrip("/")
        if not self.url.startswith(("http://", "https://")):
            raise BadInput(f"--server: expected a URL such as http://127.0.0.1:8642, found {server}")
        self._settings = settings
        self._http = httpx.Client(base_url=self.url, timeout=TIMEOUT, transport=transport)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def submit(self, text: str, overrides: Sequence[str], name: str) -> dict[str, Any]:
        """Submit the text of a study file, which errors call `name`; returns the study as JSON.

        Raises:
            BadInput: the service refuses the study (its words), or the token.
            ServerUnavailable: nothing answers.
        """
        return self._post("/api/v1/studies", {"text": text, "overrides": list(overrides), "name": name})

    def _post(self, path: str, body: Mapping[str, Any]) -> dict[str, Any]:
        try:
            answer = self._http.post(path, json=body, headers={"Authorization": f"Bearer {self._token()}"})
        except httpx.InvalidURL as error:
            raise BadInput(
                f"--server: expected a URL such as http://127.0.0.1:8642, found {self.url} ({error})"
            ) from None
        except httpx.ReadTimeout:
            raise ServerUnavailable(
                f"expected an answer of the service at {self.url} within {TIMEOUT.read:.0f} s, found none; "
                "see with `halma ls` whether the study was taken"
            ) from None
        except httpx.HTTPError as error:
            raise ServerUnavailable(
                f"expected a service at {self.url}, found: {error}; start one with `halma serve`, "
                "or run the study here with `halma run FILE`"
            ) from None
        try:
            fields = answer.json()
        except ValueError:
            fields = None
        if answer.is_success and isinstance(fields, dict):
            return fields
        raise self._refusal(answer.status_code, fields)

    def _refusal(self, status: int, fields: Any) -> HalmaError:
        error = fields.get("error") if isinstance(fields, dict) else None
        error = error if isinstance(error, dict) else {}
        message = str(error.get("message") or "")
        if status in {401, 403}:
            return BadInput(
                f"expected the token of the service at {self.url} in {self._settings.token_file}, found that it is "
                f"refused{f' ({message})' if message else ''}; use the HALMA_HOME the service was started with"
            )
        if 400 <= status < 500 and message:
            return NameTaken(message) if error.get("kind") == "NameTaken" else BadInput(message)
        return ServerRefused(f"expected the service at {self.url} to answer, found status {status}. {message}".rstrip())

    def _token(self) -> str:
        given = os.environ.get("HALMA_TOKEN", "").strip()
        if given:
            return given
        try:
            return self._settings.token_file.read_text(encoding="utf-8").strip()
        except OSError as error:
            raise BadInput(
                f"expected the service's token in {self._settings.token_file} (or HALMA_TOKEN), "
                f"found: {error.strerror or error}"
            ) from None
