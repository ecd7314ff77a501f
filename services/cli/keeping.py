"""Commands that take something out of a study: replay a policy, export the trials."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from services.cli.session import Db, say, session
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


def replay(
    name: StudyName,
    number: Annotated[int, typer.Argument(metavar="TRIAL", min=0, help="Number of the trial.")],
    video: Annotated[Path | None, typer.Option("--video", help="Write a video: a .mp4 or a .gif.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Exit with 1 unless it is the stored one.")] = False,
    db: Db = None,
) -> None:
    """Simulate the policy of a trial again, exactly."""
    kind = None if video is None else _kind_of(video)
    with session(db) as opened:
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


def _kind_of(video: Path) -> Literal["gif", "mp4"]:
    if video.suffix.lower() == ".mp4":
        return "mp4"
    if video.suffix.lower() == ".gif":
        return "gif"
    raise BadInput(f"--video: expected a file that ends in .mp4 or .gif, found {video}")
