"""Driving a study from the command line: `run` and `resume` share it."""

from __future__ import annotations

import os

from services.address import find_server
from services.cli.findings import report
from services.cli.progress import shown_progress
from services.cli.session import Session, say
from services.driver import lives
from services.errors import HalmaError, InterruptedByUser, StudyDriven
from services.stages import stage_names
from services.states import StudyState
from services.store.port import StudyRow


class StudyFailed(HalmaError):
    """The study was stopped by the service; its reason has been printed."""


def is_driven_elsewhere(row: StudyRow) -> bool:
    """Whether another process drives the study and lives, as far as can be seen from here."""
    return row.driver is not None and lives(row.driver) is not False


def drive_here(
    opened: Session,
    name: str,
    *,
    inline: bool,
    take_over: bool,
    cores: int | None = None,
    ray_address: str | None = None,
) -> None:
    """Drive a study to its end in this process and report; or say who does.

    Raises:
        InterruptedByUser: Ctrl-C or SIGTERM; the study can be resumed.
        StudyFailed: the service stopped it.
    """
    row = opened.store.study(name)
    if not take_over and is_driven_elsewhere(row):
        with opened.store.transaction() as change:
            row = change.ask(name, "run")
        driver = row.driver
        where = f"process {driver.pid} on {driver.host}" if driver else "another process"
        say(f"{name} is being driven by {where}. Follow it: halma watch {name}")
        return
    with opened.store.transaction() as change:
        row = change.ask(name, "run")
    server = find_server(opened.settings)
    if server is not None and not take_over:
        say(f"The service at {server.url} goes on with {name}. Follow it: halma watch {name}")
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
            )
    except InterruptedByUser:
        raise InterruptedByUser(f"Interrupted; nothing that was finished is lost. Go on: halma resume {name}") from None
    except StudyDriven as error:
        raise StudyDriven(f"{error}; or take it over: halma resume {name} --take-over") from None
    report(opened, opened.store.study(name))
    if row.state is StudyState.FAILED:
        raise StudyFailed(f"{name} failed; the reason is above. All of a trial's words: halma trials {name} --json")


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
