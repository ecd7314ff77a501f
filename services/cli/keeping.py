"""Commands that take something out of a study: replay a policy, export the trials."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import RenderableType

from services.auditing import Audited, AuditFailed, audit_study
from services.cli.layout import Column, fitted
from services.cli.session import AsJson, Db, console, print_json, say, session
from services.cli.studies import StudyName
from services.cli.words import several, value_of
from services.errors import BadInput, HalmaError
from services.export import SUFFIXES, Format, write
from services.replaying import simulate_again, video_of


class NotEqual(HalmaError):
    """A replay is not the stored one."""


def export(
    name: StudyName,
    form: Annotated[Format, typer.Option("--format", "-f", help="What to write.")] = Format.CSV,
    output: Annotated[
        Path | None, typer.Option("--output", "--out", "-o", help="File or folder; default: STUDY and a suffix, here.")
    ] = None,
    db: Db = None,
) -> None:
    """Export the trials of a study."""
    with session(db) as opened:
        row = opened.store.study(name)
        path = (output if output is not None else Path(f"{name}{SUFFIXES[form]}")).absolute()
        number = write(opened.store, row, form, path)
    say(f"Wrote {several(number, 'trial')} to {path}")


def replay(
    name: StudyName,
    number: Annotated[int, typer.Argument(metavar="TRIAL", min=0, help="Number of the trial.")],
    video: Annotated[Path | None, typer.Option("--video", help="Write a video: a .mp4 or a .gif.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Exit with 1 unless it is the stored one.")] = False,
    db: Db = None,
) -> None:
    """Simulate the policy of a trial again, exactly."""
    kind = None if video is None else _kind_of(video)
    with session(db, here="replay") as opened:
        row = opened.store.study(name)
        again = simulate_again(opened.store, opened.artifacts, row, number)
    value = "" if again.trial.value is None else f", value {value_of(again.trial.value)}"
    say(f"Trial {number} of {name}: {again.recording.seconds:.2f} s{value}")
    if again.stored is None:
        say("The trial left no replay to compare it with.")
    elif again.equal:
        say(f"Bit-equal to the stored replay (SHA-256 {again.sha256[:16]}...).")
    else:
        say(f"Differs from the stored replay: SHA-256 {again.sha256[:16]}... now, {again.stored[:16]}... then.")
    if video is not None and kind is not None:
        try:
            video.write_bytes(video_of(again.recording, kind))
        except OSError as error:
            message = f"--video: expected a file that can be written, found {video}: {error.strerror or error}"
            raise BadInput(message) from None
        say(f"Video: {video.absolute()}")
    if check and not again.equal:
        raise NotEqual("replay --check: expected the stored replay to the last bit, found another one")


def audit(
    name: StudyName,
    rollouts: Annotated[int, typer.Option("--rollouts", min=0, help="Episodes with noise, for the success rate.")] = 50,
    db: Db = None,
    as_json: AsJson = False,
) -> None:
    """Judge every strategy that a study reports: is it humanly possible? Exit code 1 where one is not."""
    with session(db, here="audit") as opened:
        row = opened.store.study(name)
        judged = audit_study(opened.store, opened.artifacts, row, rollouts)
    failed = [each for each in judged if not each.passed]
    if as_json:
        print_json({"study": name, "passed": not failed, "strategies": [each.to_json() for each in judged]})
    elif not judged:
        say(f"{name} reports no strategy yet: there is nothing to audit.")
    else:
        screen = console()
        screen.print(audit_table(judged, screen.width))
        for each in judged:
            if each.message:
                say(f"Trial {each.finding.trial.number} could not be judged: {each.message}")
    if failed:
        numbers = ", ".join(str(each.finding.trial.number) for each in failed)
        raise AuditFailed(f"audit of {name}: expected every strategy to pass, found trial {numbers} failing")


def audit_table(judged: Sequence[Audited], width: int) -> RenderableType:
    """Checks down, strategies across: what was found, beside what it may be at most. What fails is marked with !."""
    names = list(dict.fromkeys(check for each in judged for check in each.checks))
    some = {check: next(each.checks[check] for each in judged if check in each.checks) for check in names}
    bounds = ["-" if some[check]["bound"] is None else value_of(some[check]["bound"]) for check in names]
    columns = [
        Column("check", [*(check.replace("_", " ") for check in names), "verdict"], left=True),
        Column("at most", [*bounds, ""]),
    ]
    for each in judged:
        cells = []
        for check in names:
            result = each.checks.get(check)
            mark = "" if result is None or result["passed"] else " !"
            cells.append("-" if result is None else f"{value_of(result['found'])}{mark}")
        columns.append(Column(f"trial {each.finding.trial.number}", [*cells, "passed" if each.passed else "FAILED"]))
    columns.append(Column("unit", [*(str(some[check]["unit"]) for check in names), ""], left=True, rank=1))
    return fitted(columns, width)


def _kind_of(video: Path) -> Literal["gif", "mp4"]:
    if video.suffix.lower() == ".mp4":
        return "mp4"
    if video.suffix.lower() == ".gif":
        return "gif"
    raise BadInput(f"--video: expected a file that ends in .mp4 or .gif, found {video}")
