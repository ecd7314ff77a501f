"""Commands about the files that trials leave: gc, verify."""

from __future__ import annotations

from typing import Annotated

import typer

from services.artifacts.root import adopt, confirm
from services.cli.session import Artifacts, AsJson, Db, print_json, say, session
from services.cli.studies import complete_study
from services.cli.words import file_size, several
from services.errors import HalmaError
from services.garbage import LEAST_AGE, Collected, Fate, collect
from services.verifying import Mismatch, verify


class DoNotMatch(HalmaError):
    """Files are missing or altered; each has been printed."""


def gc(
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be removed, and remove nothing.")] = False,
    least_hours: Annotated[
        float, typer.Option("--older-than", metavar="HOURS", min=0.0, help="Leave what is younger.")
    ] = LEAST_AGE / 3600,
    db: Db = None,
    artifacts: Artifacts = None,
    as_json: AsJson = False,
) -> None:
    """Remove files that nothing needs: checkpoints of ended trials, what no trial names, what deleted studies left.

    Studies may run meanwhile: what belongs to a trial that has not ended stays.
    """
    with session(db, artifacts, here="gc") as opened:
        collected = collect(opened.store, opened.artifacts, least_age=least_hours * 3600, dry_run=dry_run)
        url = opened.artifacts.url
    if as_json:
        print_json(
            {
                "dry_run": dry_run,
                "removed": {"files": collected.removed[0], "bytes": collected.removed[1]},
                "fates": {
                    fate.name.lower(): {"files": collected.files[fate], "bytes": collected.sizes[fate]} for fate in Fate
                },
            }
        )
        return
    _say_collected(collected, url, dry_run=dry_run)


def _say_collected(collected: Collected, url: str, *, dry_run: bool) -> None:
    files, size = collected.removed
    say(f"{'Would remove' if dry_run else 'Removed'} {several(files, 'file')}, {file_size(size)}, from {url}")
    for fate in Fate:
        if fate.goes and collected.files[fate]:
            say(f"  {collected.files[fate]:>7,}  {file_size(collected.sizes[fate]):>9}  {fate.value}")
    stay = [fate for fate in Fate if not fate.goes and collected.files[fate]]
    if stay:
        kept = ", ".join(f"{collected.files[fate]:,} {fate.value}" for fate in stay)
        say(f"Left {file_size(sum(collected.sizes[fate] for fate in stay))}: {kept}")


def verify_files(
    name: Annotated[
        str | None,
        typer.Argument(metavar="[STUDY]", help="Only this study; default: all.", autocompletion=complete_study),
    ] = None,
    adopting: Annotated[
        bool, typer.Option("--adopt", help="Take this place for the artifacts' from now on, whatever is missing.")
    ] = False,
    db: Db = None,
    artifacts: Artifacts = None,
    as_json: AsJson = False,
) -> None:
    """Check that every file that a trial names exists and matches its hash. Exit code 1 where one doesn't."""

    def tell(mismatch: Mismatch) -> None:
        if not as_json:
            say(f"{mismatch.study}, trial {mismatch.trial}, {mismatch.artifact.name}: {mismatch.found}")

    with session(db, artifacts, here="verify") as opened:
        rows = opened.store.studies() if name is None else [opened.store.study(name)]
        if adopting:
            adopt(opened.store, opened.artifacts)
        else:
            confirm(opened.store, opened.artifacts)
        verified = verify(opened.store, opened.artifacts, rows, tell)
        url = opened.artifacts.url
    bad = len(verified.mismatches)
    if as_json:
        print_json(
            {
                "artifacts": url,
                "files": verified.files,
                "bytes": verified.size,
                "mismatches": [
                    {
                        "study": each.study,
                        "trial": each.trial,
                        "artifact": each.artifact.name,
                        "path": each.artifact.path,
                        "found": each.found,
                    }
                    for each in verified.mismatches
                ],
            }
        )
    else:
        say(f"{several(verified.files, 'file')}, {file_size(verified.size)}, in {url}: as recorded")
    if bad:
        raise DoNotMatch(
            f"verify: expected every file that a trial names, found {several(bad, 'file')} missing or altered"
        )
