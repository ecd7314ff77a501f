"""Commands that take something out of a study: replay a policy, export the trials."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from services.cli.session import Db, say, session
from services.cli.studies import StudyName
from services.cli.words import several
from services.export import SUFFIXES, Format, write


def export(
    name: StudyName,
    form: Annotated[Format, typer.Option("--format", "-f", help="What to write.")] = Format.CSV,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File; default: STUDY and a suffix, here.")
    ] = None,
    db: Db = None,
) -> None:
    """Export the trials of a study."""
    with session(db) as opened:
        row = opened.store.study(name)
        path = (output if output is not None else Path(f"{name}{SUFFIXES[form]}")).absolute()
        number = write(opened.store, row, form, path)
    say(f"Wrote {several(number, 'trial')} to {path}")
