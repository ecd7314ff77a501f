"""What every command shares: its options, the console, and the trial database opened and closed around it."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Annotated, Any

import typer
from rich.console import Console

from services.artifacts.open import open_artifacts
from services.artifacts.port import ArtifactStore
from services.errors import BadInput
from services.settings import Settings, find_settings
from services.store.open import open_store
from services.store.port import Store

Db = Annotated[
    str | None,
    typer.Option(
        "--db", metavar="DB", help="Trial database: a SQLite file or a URL.  [default: HALMA_DB, else ~/.halma]"
    ),
]
Artifacts = Annotated[
    str | None,
    typer.Option(
        "--artifacts",
        metavar="PLACE",
        help="Where trials' files are: a folder or a URL.  [default: HALMA_ARTIFACTS, else beside the database]",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]

RayAddress = Annotated[
    str | None,
    typer.Option(
        "--ray-address",
        "--ray",
        metavar="ADDRESS",
        help="Work on the Ray cluster that this host has joined (HOST:PORT or auto) instead of a local Ray.",
    ),
]

TakeOver = Annotated[
    bool, typer.Option("--take-over", help="Take the study from a driver that lives; that one is fenced off.")
]

PIPED_WIDTH = 200
"""Columns where nobody's window says how many there are: tables in a pipe or a log shouldn't be cut."""


def console(*, stderr: bool = False) -> Console:
    """The terminal. Made anew for each use, because tests and pipes replace the standard streams."""
    stream = sys.stderr if stderr else sys.stdout
    return Console(
        file=stream, width=None if stream.isatty() else PIPED_WIDTH, highlight=False, soft_wrap=not stream.isatty()
    )


def say(text: str = "") -> None:
    """One line for people, as it is: no markup, no wrapping."""
    console().print(text, markup=False)


def warn(text: str) -> None:
    """One line on standard error, for people who wait in front of something that goes on."""
    console(stderr=True).print(text, markup=False)


def print_json(value: Any) -> None:
    """JSON on standard output; one value for each call."""
    sys.stdout.write(json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def print_json_line(value: Any) -> None:
    """JSON on one line, at once: for programs that follow along."""
    sys.stdout.write(json.dumps(value, ensure_ascii=False, allow_nan=False) + "\n")
    sys.stdout.flush()


_asked: ContextVar[str | None] = ContextVar("server", default=None)


def ask_server(url: str | None) -> None:
    """Note what `halma --server` says, for the command that follows."""
    _asked.set(url)


def named_server() -> str | None:
    """The service that the command line or `HALMA_SERVER` names; None where the database here is meant."""
    return _asked.get() or os.environ.get("HALMA_SERVER", "").strip() or None


def only_here(command: str) -> None:
    """Refuse `--server` for a command that no service does. `HALMA_SERVER` is for those that one does."""
    if _asked.get():
        raise BadInput(
            f"--server: expected a command that a service can do ({SERVED}), found {command}, which works here; "
            "leave --server out"
        )


SERVED = "ls, show, trials, watch, plot, export, submit, pause, resume, cancel, extend, set"


@dataclass(frozen=True, slots=True)
class Session:
    """An opened trial database with its artifacts, or a service in its place.

    Args:
        settings: of this home.
        store: the record.
        files: the artifacts; None where they are a service's.
        server: URL of the service; None where the record is here.
    """

    settings: Settings
    store: Store
    files: ArtifactStore | None
    server: str | None = None

    @property
    def artifacts(self) -> ArtifactStore:
        """The artifacts of a record that is here. Raises `BadInput` for a service's."""
        if self.files is None:
            raise BadInput(f"expected a database here, found the service at {self.server}; leave --server out")
        return self.files


@contextmanager
def session(db: str | None, artifacts: str | None = None, *, here: str = "") -> Iterator[Session]:
    """Open the trial database, or a connection to a service, for the length of a command.

    Args:
        db: what `--db` says.
        artifacts: what `--artifacts` says.
        here: the command's name where no service can do it.

    Raises:
        DatabaseUnavailable: it can't be opened.
        BadInput: a service can't do it, or both a database and a service are named.
    """
    if here:
        only_here(here)
    if _asked.get() and (db is not None or artifacts is not None):
        raise BadInput("--server: expected either a service or a database (--db, --artifacts), found both")
    server = None if here or db is not None or artifacts is not None else named_server()
    if server is not None:
        from services.client import Client  # noqa: PLC0415 - HTTP, which commands on a database here don't speak
        from services.remote_store import RemoteStore  # noqa: PLC0415 - as above

        settings = find_settings()
        remote = RemoteStore(Client(settings, server))
        try:
            yield Session(settings, remote, None, remote.url)
        finally:
            remote.close()
        return
    settings = find_settings(db, artifact_root=artifacts)
    store = open_store(settings.database)
    try:
        yield Session(settings, store, open_artifacts(settings.artifacts))
    finally:
        store.close()
