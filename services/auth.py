"""Who may talk to the service: one token, sessions derived from it, and a limit on guessing.

The token is made once, shown once, and kept in `HALMA_HOME/token` for its owner only. Programs send it as
`Authorization: Bearer`; a browser trades it on the login page for a session cookie, which is a signed date and not
the token, so a leaked cookie expires and can't be turned back. Sessions are signed with a key derived from the token:
they need no table, survive a restart, and a new token ends all of them.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import os
import secrets
import stat
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from services.errors import BadInput
from services.throttle import Throttle

COOKIE = "halma_session"
SESSION_SECONDS = 30 * 24 * 3600
SHORTEST_TOKEN = 16
"""Characters below which a token chosen by hand is refused."""


@dataclass(frozen=True, slots=True)
class TokenFile:
    """The token as it was found or made.

    Args:
        token: the secret.
        path: where it is kept.
        created: whether it was made just now, and has to be shown.
    """

    token: str
    path: Path
    created: bool


def load_or_create_token(home: Path) -> TokenFile:
    """The token of a `HALMA_HOME`, made with 256 bits of chance where there is none.

    Raises:
        BadInput: the file can't be read or written, others may read it, or what it holds is too short.
    """
    path = home / "token"
    token = secrets.token_urlsafe(32)
    fresh = home / f".token-{secrets.token_hex(8)}"
    if path.exists():
        return TokenFile(_read_token(path), path, created=False)
    try:
        home.mkdir(parents=True, exist_ok=True, mode=0o700)
        handle = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            with os.fdopen(handle, "w", encoding="ascii") as file:
                file.write(token + "\n")
            # A link appears whole or not at all: two services that start together agree on the one that was first.
            with contextlib.suppress(FileExistsError):
                os.link(fresh, path)
        finally:
            fresh.unlink()
    except OSError as error:
        raise BadInput(f"{path}: expected to keep the access token there, found: {error.strerror or error}") from None
    kept = _read_token(path)
    return TokenFile(kept, path, created=kept == token)


def _read_token(path: Path) -> str:
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
        token = path.read_text(encoding="utf-8").strip()
    except OSError as error:
        raise BadInput(f"{path}: expected a readable access token, found: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise BadInput(f"{path}: expected text, found other bytes; delete the file and a new token is made") from None
    if mode & 0o077:
        raise BadInput(
            f"{path}: expected that only its owner can read it, found mode {mode:04o}; "
            f"run `chmod 600 {path}`, or delete it and a new token is made"
        )
    if len(token) < SHORTEST_TOKEN or not token.isascii() or not token.isprintable() or " " in token:
        raise BadInput(
            f"{path}: expected at least {SHORTEST_TOKEN} printable ASCII characters without spaces, "
            f"found {len(token)} characters; delete the file and a new token is made"
        )
    return token


class Gatekeeper:
    """Tells tokens and sessions from forgeries.

    Args:
        token: the secret.
        clock: seconds since the epoch; tests pass their own.
    """

    def __init__(self, token: str, *, clock: Callable[[], float] = time.time) -> None:
        self._token = token.encode()
        self._key = hmac.digest(self._token, b"halma browser session", "sha256")
        self._clock = clock

    def is_token(self, candidate: str) -> bool:
        """Whether this is the token. Takes the same time for every wrong one."""
        return hmac.compare_digest(
            hashlib.sha256(candidate.encode("utf-8", "surrogatepass")).digest(), hashlib.sha256(self._token).digest()
        )

    def new_session(self) -> str:
        """A session that holds for `SESSION_SECONDS`: issue time, chance, signature."""
        body = f"{int(self._clock())}.{secrets.token_urlsafe(12)}"
        return f"{body}.{self._signature(body)}"

    def is_session(self, value: str) -> bool:
        """Whether `new_session` made this, and not too long ago."""
        body, _, signature = value.rpartition(".")
        if not hmac.compare_digest(self._signature(body).encode(), signature.encode("utf-8", "surrogatepass")):
            return False
        # Only what we signed gets here, so the date is a number.
        age = self._clock() - int(body.partition(".")[0])
        return -60 <= age <= SESSION_SECONDS

    def _signature(self, body: str) -> str:
        return hmac.new(self._key, body.encode("utf-8", "surrogatepass"), hashlib.sha256).hexdigest()


class LoginThrottle(Throttle):
    """How often an address may guess. A success doesn't count."""

    def __init__(self, *, burst: int = 5, refill_seconds: float = 12.0, **more: Any) -> None:
        super().__init__(burst=burst, refill_seconds=refill_seconds, **more)

    def failed(self, address: str) -> None:
        """Count a wrong token."""
        self.spend(address)
