"""The command that looks whether a task keeps its promises."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

from services.cli.session import AsJson, console, print_json, say
from services.errors import BadInput
from services.problems import BadStudy
from services.spec_file import read_draft
from services.translate import parameter_spec_of
from workers.contracts import ParameterSpec, WorkerError
from workers.registry import load_task

task = typer.Typer(help="One task.", no_args_is_help=True)

_MARKS = {"good": ("ok      ", "green"), "doubtful": ("doubtful", "yellow"), "bad": ("bad     ", "red")}


@task.callback()
def one_task() -> None:
    """One task."""


@task.command("check")
def check(
    name: Annotated[
        str, typer.Argument(metavar="TASK", help="A task's name, or a study file (YAML) with its settings and space.")
    ],
    profile: Annotated[str | None, typer.Option("--profile", metavar="NAME", help="A profile of the file.")] = None,
    as_json: AsJson = False,
) -> None:
    """Look whether a task keeps its promises: spaces, seeding, determinism, NaN, endless episodes, difficulty."""
    from workers.checking import check_task  # noqa: PLC0415 - what only this command needs

    chosen, settings, training, space = _subject(name, profile)
    try:
        found = check_task(load_task(chosen), name=chosen, settings=settings, training=training, space=space)
    except WorkerError as error:
        raise BadInput(f"task check: {error}") from None
    if as_json:
        print_json([asdict(finding) for finding in found])
    else:
        for finding in found:
            mark, colour = _MARKS[finding.verdict]
            first, *rest = finding.found.splitlines() or [""]
            console().print(Text(mark, style=colour) + Text(f"  {finding.check.ljust(12)} {first}"))
            for line in rest:
                say(f"          {line}")
            if finding.remedy:
                say(f"          do: {finding.remedy}")
    bad = [finding.check for finding in found if finding.verdict == "bad"]
    if bad:
        raise BadInput(f"task check: {chosen} can't be searched yet; to be mended: {', '.join(bad)}")


def _subject(
    name: str, profile: str | None
) -> tuple[str, Mapping[str, Any], Mapping[str, Any] | None, dict[str, ParameterSpec] | None]:
    """Name, settings, training and space of the task that a name or a study file means."""
    if Path(name).suffix not in {".yaml", ".yml"}:
        if profile is not None:
            raise BadInput("--profile: expected a study file, found the name of a task; profiles are part of a file")
        return name, {}, None, None
    read = read_draft(Path(name), [f"profile={profile}"] if profile is not None else [])
    if read.spec is None:
        raise BadStudy(read.problems)
    spec = read.spec
    space = None if spec.space is None else {key: parameter_spec_of(each) for key, each in spec.space.items()}
    return spec.task.name, spec.task.settings, spec.training, space
