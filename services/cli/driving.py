"""Driving a study from the command line: `run` and `resume` share it."""

from __future__ import annotations

import os
import time

from services.address import find_server
from services.cli.findings import report
from services.cli.progress import shown_progress
from services.cli.session import Session, say, warn
from services.cli.words import several
from services.driver import DriverWatch, driving_words, lives
from services.errors import HalmaError, InterruptedByUser, StudyDriven
from services.stages import stage_names
from services.states import StudyState, TrialState
from services.store.port import StudyRow


class StudyFailed(HalmaError):
    """The study was stopped by the service, or no trial of it came to anything; the reason has been printed."""


def is_driven_elsewhere(row: StudyRow) -> bool:
    """Whether another process drives the study and lives, as far as can be seen from here."""
    return row.driver is not None and lives(row.driver) is not False


def refuse_driven(opened: Session, row: StudyRow) -> None:
    """Refuse a study that is being driven. One whose driver is on another host is watched for up to 15 s.

    Raises:
        StudyDriven: who drives it, where, since when, and what can be done.
    """
    if row.driver is None:
        return
    if lives(row.driver) is None:
        say(f"{row.name} was driven by {driving_words(row)}. Looking whether it still is.")
    if not DriverWatch(opened.store, time.monotonic, time.sleep).is_dead(row.name):
        raise StudyDriven(_driven(opened.store.study(row.name)))


def _driven(row: StudyRow) -> str:
    return (
        f"study {row.name!r}: expected that nobody drives it, found {driving_words(row)}; "
        f"follow it: halma watch {row.name}; stop it: halma pause {row.name}; "
        f"or take it over: halma resume {row.name} --take-over"
    )


def drive_here(
    opened: Session,
    name: str,
    *,
    inline: bool,
    take_over: bool,
    cores: int | None = None,
    ray_address: str | None = None,
) -> None:
    """Drive a study to its end in this process and report; or leave it to the service of this home.

    Raises:
        StudyDriven: somebody drives it; nothing was changed.
        InterruptedByUser: Ctrl-C or SIGTERM; the study can be resumed.
        StudyFailed: the service stopped it.
    """
    row = opened.store.study(name)
    if not take_over and row.wanted == "run":
        refuse_driven(opened, row)
    with opened.store.transaction() as change:
        row = change.ask(name, "run")
    server = find_server(opened.settings)
    if server is not None and not take_over:
        say(f"The service at {server.url} goes on with {name}. Follow it: halma watch {name}")
        return
    if not take_over and is_driven_elsewhere(row):
        # It was winding down, because it had been asked to; that has just been taken back.
        say(f"{name} is told to go on; it is driven by {driving_words(row)}. Follow it: halma watch {name}")
        return
    _announce(row)
    from services.running import drive  # noqa: PLC0415 - the coordinator, which most commands never need

    try:
        with shown_progress(opened.store, name):
            row = drive(
                opened.settings.database,
                opened.settings.artifacts,
                name,
                inline=inline,
                take_over=take_over,
                pools=_pools(row, cores) if cores or ray_address is None else None,
                ray_address=ray_address,
                tell=warn,
            )
    except InterruptedByUser:
        raise InterruptedByUser(f"Interrupted; nothing that was finished is lost. Go on: halma resume {name}") from None
    except KeyboardInterrupt:
        raise InterruptedByUser(
            f"Interrupted at once; what had finished is on record. Go on: halma resume {name}"
        ) from None
    except StudyDriven as error:
        raise StudyDriven(_driven(opened.store.study(name))) from error
    row = opened.store.study(name)
    report(opened, row)
    if row.state is StudyState.FAILED:
        raise StudyFailed(f"{name} failed; the reason is above. All of a trial's words: halma trials {name} --json")
    ended = sum(row.counts.values())
    if row.state is StudyState.COMPLETE and ended and not _has_results(row):
        raise StudyFailed(
            f"{name}: expected a result, found none in {several(ended, 'trial')}; what ended the newest is above. "
            f"halma task check with the study file tells what to mend; then go on: halma extend {name} --trials {ended}"
        )


def _has_results(row: StudyRow) -> bool:
    """Whether a trial came to a value, or to the knowledge that there is none."""
    return any(row.counts.get(state) for state in (TrialState.COMPLETE, TrialState.INFEASIBLE))


def _pools(row: StudyRow, cores: int | None) -> dict[str, int] | None:
    """Pools of a study driven alone: the one it asks for gets all cores."""
    size = cores or os.cpu_count() or 1
    return {row.pool: size}


def _announce(row: StudyRow) -> None:
    budget = []
    if row.target_trials is not None:
        later = "".join(f", then {name}" for name in stage_names(row))
        budget.append(f"{row.target_trials} trials{later}")
    if row.target_cost is not None:
        budget.append(f"{row.target_cost:,.0f} samples")
    task, strategy = row.spec["task"]["name"], row.spec["search"]["strategy"]
    parallel = row.spec.get("resources", {}).get("parallel", 1)
    begun = sum(row.counts.values())
    verb = "goes on" if begun else "starts"
    say(
        f"{row.name} {verb}: {strategy} on {task}, {' or '.join(budget)}"
        f"{f', {parallel} at a time' if parallel > 1 else ''}. Ctrl-C interrupts; halma resume {row.name} goes on."
    )
