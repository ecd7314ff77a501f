"""The command that draws a study for a paper."""

from __future__ import annotations

from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from services.cli.session import AsJson, Db, print_json, say, session
from services.cli.studies import StudyName
from services.cli.words import several
from services.errors import BadInput, NotInstalled


class Picture(StrEnum):
    """What a figure is written as."""

    SVG = "svg"
    PDF = "pdf"
    PNG = "png"


class Name(StrEnum):
    """What can be drawn; `services.figures.study.FIGURES`, which needs matplotlib, has the same names."""

    COST = "cost"
    BEHAVIOUR = "behaviour"
    LADDER = "ladder"
    PARALLEL = "parallel"
    IMPORTANCE = "importance"
    CURVES = "curves"
    PARAMETERS = "parameters"
    SLICE = "slice"


def plot(
    name: StudyName,
    out: Annotated[
        Path | None, typer.Option("--out", "--output", "-o", help="Folder for the files; default: STUDY-figures, here.")
    ] = None,
    form: Annotated[Picture, typer.Option("--format", "-f", help="What to write.")] = Picture.PDF,
    only: Annotated[list[Name] | None, typer.Option("--only", help="Only this figure; may be repeated.")] = None,
    db: Db = None,
    as_json: AsJson = False,
) -> None:
    """Draw a study for a paper: cost, behaviours, ladder, parameters, curves, surrogate. What doesn't apply is said."""
    if find_spec("matplotlib") is None:
        raise NotInstalled(
            "plot: expected matplotlib, found that it isn't installed; install it with `pip install 'halma[plot]'`"
        )
    folder = (out if out is not None else Path(f"{name}-figures")).absolute()
    if folder.exists() and not folder.is_dir():
        raise BadInput(f"--out: expected a folder, found the file {folder}")
    from services.figures.shown import Shown  # noqa: PLC0415 - the search's geometry comes with torch
    from services.figures.study import draw, write  # noqa: PLC0415 - matplotlib, an extra

    with session(db) as opened:
        shown = Shown.of(opened.store, name)
        drawn = draw(shown, [each.value for each in only or Name])
    if not drawn.figures:
        reasons = "; ".join(f"{figure}: {reason}" for figure, reason in drawn.left_out.items())
        raise BadInput(f"plot: expected something to draw of {name}, found nothing ({reasons})")
    files = write(drawn, folder, form.value)
    if as_json:
        print_json({"files": {path.stem: str(path) for path in files}, "left_out": dict(drawn.left_out)})
        return
    say(f"Wrote {several(len(files), 'figure')} to {folder}:")
    for path in files:
        say(f"  {path.name}")
    for figure, reason in drawn.left_out.items():
        say(f"Left out: {figure} ({reason.rstrip('.')})")
