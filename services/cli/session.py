"""What every command shares: its options, the console, and the trial database opened and closed around it."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any

import typer
from rich.console import Console

from services.artifacts import ArtifactStore, open_artifacts
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


def print_json(value: Any) -> None:
    """JSON on standard output; one value for each call."""
    sys.stdout.write(json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def print_json_line(value: Any) -> None:
    """JSON on one line, at once: for programs that follow along."""
    sys.stdout.write(json.dumps(value, ensure_ascii=False, allow_nan=False) + "\n")
    sys.stdout.flush()


@dataclass(frozen=True, slots=True)
class Session:
    """An opened trial database with its artifacts."""

    settings: Settings
    store: Store
    artifacts: ArtifactStore


@contextmanager
def session(db: str | None, artifacts: str | None = None) -> Iterator[Session]:
    """Open the trial database for the length of a command.

    Args:
        db: what `--db` says.
        artifacts: what `--artifacts` says.

    Raises:
        DatabaseUnavailable: it can't be opened.
    """
    settings = find_settings(db, artifact_root=artifacts)
    store = open_store(settings.database)
    try:
        yield Session(settings, store, open_artifacts(settings.artifacts))
    finally:
        store.close()
