"""Commands that look at studies and tell them what to do: ls, show, trials, watch, pause, resume, cancel, extend."""

from __future__ import annotations

import time
from typing import Annotated

import typer

from services.amending import AMENDABLE, SHORT, field_of, read_amendments
from services.artifacts.root import settle
from services.budget import check_rounds, has_stages, rounds_of
from services.cli.driving import drive_here, is_driven_elsewhere
from services.cli.events import event_line
from services.cli.findings import findings_table
from services.cli.matters import matters_of, show_matters
from services.cli.session import (
    Artifacts,
    AsJson,
    Db,
    RayAddress,
    Session,
    TakeOver,
    console,
    print_json,
    print_json_line,
    say,
    session,
)
from services.cli.tables import done_of, fields_table, stages_table, state_text, studies_table, trials_table
from services.cli.words import count, duration, several, state_words, value_of
from services.driver import driving_words, this_process
from services.errors import BadInput, HalmaError, Refused, StudyDriven, WrongState
from services.lineage import lineage_words
from services.listings import artifacts_by_trial, event_json, study_json, trial_json
from services.report import behaviour_of, distinct_trials, units_of
from services.stages import stages_of_study
from services.states import LIVE_STUDY, OBSERVED_TRIAL, StudyState, TrialState
from services.store.port import StudyRow

WATCH_SECONDS = 0.5
"""How often `watch` looks for news."""


def complete_study(incomplete: str) -> list[str]:
    """Names of studies for the shell's completion. Nothing that fails here may disturb somebody's prompt."""
    try:
        with session(None) as opened:
            return [row.name for row in opened.store.studies() if row.name.startswith(incomplete)]
    except HalmaError:
        return []


StudyName = Annotated[str, typer.Argument(metavar="STUDY", help="Name of the study.", autocompletion=complete_study)]


def ls(db: Db = None, as_json: AsJson = False) -> None:
    """List the studies, newest first."""
    with session(db) as opened:
        rows = opened.store.studies()
    if as_json:
        print_json([study_json(row) for row in rows])
    elif rows:
        screen = console()
        screen.print(studies_table(rows, screen.width))
    else:
        say("No studies yet. Start one: halma run studies/quickstart.yaml")


def show(name: StudyName, db: Db = None, as_json: AsJson = False) -> None:
    """Show one study: where it stands, what it has found so far, and which parameters matter."""
    with session(db) as opened:
        row = opened.store.study(name)
        every = opened.store.trials(row.id)
    matters = matters_of(row, every)
    if as_json:
        stages = {"stages": [stage.to_json() for stage in stages_of_study(row, every)]}
        print_json({**study_json(row, spec=True), **stages, **matters.to_json()})
        return
    placed = [trial for trial in every if trial.position is not None]
    found = distinct_trials(row, sorted(placed, key=lambda trial: trial.position or 0))
    lineage = lineage_words(every)
    search = row.spec.get("search", {})
    fields = {
        "study": row.name,
        "state": state_text(row.state.value),
        "note": row.reason or None,
        "task": row.spec.get("task", {}).get("name"),
        "strategy": search.get("strategy"),
        "profile": row.spec.get("profile"),
        "trials": f"{done_of(row)} ({', '.join(f'{count(n)} {state}' for state, n in sorted(row.counts.items()) if n)})"
        if row.counts
        else done_of(row),
        "best value": None if row.best_value is None else value_of(row.best_value),
        "distinct": several(len(found), "strategy") if behaviour_of(row) else None,
        "cost": f"{count(row.samples)} samples, {duration(row.seconds)} of training",
        "warm starts": lineage,
        "driven by": driving_words(row) if row.driver else None,
        "seed": str(row.seed),
        "created": row.created_at.astimezone().strftime("%Y-%m-%d %H:%M:%S"),
        "finished": row.finished_at.astimezone().strftime("%Y-%m-%d %H:%M:%S") if row.finished_at else None,
    }
    console().print(fields_table({name: value for name, value in fields.items() if value is not None}))
    if has_stages(row):
        say()
        screen = console()
        screen.print(stages_table(stages_of_study(row, every), screen.width))
    if found:
        say()
        screen = console()
        screen.print(findings_table(row, found, screen.width))
    show_matters(matters)
    say()
    say(f"Next: {what_next(row)}")


def what_next(row: StudyRow) -> str:
    """The command that makes sense now."""
    if row.state is StudyState.COMPLETE:
        return f"halma trials {row.name}, halma extend {row.name} --trials 10"
    if row.state is StudyState.RUNNING and is_driven_elsewhere(row):
        return f"halma watch {row.name}, halma pause {row.name}"
    return f"halma resume {row.name}"


def trials(
    name: StudyName,
    state: Annotated[list[TrialState] | None, typer.Option("--state", help="Only trials in this state.")] = None,
    db: Db = None,
    as_json: AsJson = False,
) -> None:
    """List the trials of a study."""
    with session(db) as opened:
        row = opened.store.study(name)
        rows = opened.store.trials(row.id, states=state or None)
        if as_json:
            left = artifacts_by_trial(opened.store.study_artifacts(row.id))
            print_json([trial_json(trial, left.get(trial.id, ())) for trial in rows])
            return
    if not rows:
        say(f"{name} has no trials yet." if not state else f"{name} has no trial that is {' or '.join(state)}.")
        return
    screen = console()
    screen.print(trials_table(rows, behaviour_of(row), units_of(row), screen.width))


def watch(
    name: StudyName,
    since: Annotated[
        int | None, typer.Option("--since", min=0, help="Begin after this event (0: all); default: now.")
    ] = None,
    db: Db = None,
    as_json: AsJson = False,
) -> None:
    """Follow what happens in a study, until it ends. With --json, one object a line; `id` is the cursor for --since."""
    with session(db) as opened:
        row = opened.store.study(name)
        cursor = since
        if cursor is None:
            cursor = opened.store.last_event()
            if not as_json:
                say(f"{row.name}: {row.state.value}, {done_of(row)} trials. Ctrl-C stops watching, not the study.")
        while True:
            # The state is read before the events: whatever made it final is then among them.
            row = opened.store.study(name)
            while batch := opened.store.events(after=cursor, study_id=row.id):
                cursor = batch[-1].id
                for event in batch:
                    if as_json:
                        print_json_line(event_json(event))
                    elif line := event_line(event):
                        say(line)
            if row.state not in LIVE_STUDY:
                break
            time.sleep(WATCH_SECONDS)
    if not as_json:
        reason = f": {row.reason}" if row.reason else ""
        say(f"{row.name} {state_words(row.state)}{reason}")


def pause(name: StudyName, db: Db = None, as_json: AsJson = False) -> None:
    """Stop a study at its next checkpoints; it can be resumed."""
    _ask(name, "pause", db, as_json=as_json, driven="pauses as soon as its trials have reached a checkpoint")


def cancel(name: StudyName, db: Db = None, as_json: AsJson = False) -> None:
    """End a study; its open trials are cancelled, what was found is kept."""
    _ask(name, "cancel", db, as_json=as_json, driven="ends as soon as its running trials have been told")


def _ask(name: str, wanted: str, db: str | None, *, as_json: bool, driven: str) -> None:
    with session(db) as opened:
        row = opened.store.study(name)
        if row.driver is not None and opened.server is None and not is_driven_elsewhere(row):
            _let_go(opened, row)
        with opened.store.transaction() as change:
            row = change.ask(name, wanted)
    if as_json:
        print_json(study_json(row))
    elif row.driver is not None:
        say(f"{name} {driven}.")
    else:
        say(f"{name} {state_words(row.state)}.")


def _let_go(opened: Session, row: StudyRow) -> None:
    """Release a study from a driver that is dead, so that a request takes effect at once."""
    try:
        with opened.store.transaction() as change:
            token = change.drive(row.name, this_process(), take_over_from=row.drive_token)
            change.release_drive(row.id, token, StudyState.PAUSED, "its driver had died")
    except (Refused, StudyDriven):
        return


def extend(
    name: StudyName,
    trials: Annotated[int, typer.Option("--trials", min=0, help="So many more trials.")] = 0,
    cost: Annotated[float, typer.Option("--cost", min=0.0, help="So many more samples.")] = 0.0,
    rounds: Annotated[
        int, typer.Option("--rounds", min=0, max=1000, help="So many more trainings of each strategy in the polish.")
    ] = 0,
    db: Db = None,
    as_json: AsJson = False,
) -> None:
    """Raise the budget of a study. `halma resume` then spends it."""
    if not (trials or cost or rounds):
        raise BadInput(
            "extend: expected --trials N, --cost N or --rounds N, found none of them; "
            f"for example halma extend {name} --trials 10"
        )
    with session(db) as opened:
        check_rounds(opened.store.study(name), rounds)
        with opened.store.transaction() as change:
            row = change.extend(name, trials=trials, cost=cost, rounds=rounds)
        driven = opened.server is not None or is_driven_elsewhere(row)
    if as_json:
        print_json(study_json(row))
        return
    budget = [several(row.target_trials, "trial")] if row.target_trials is not None else []
    if budget and has_stages(row):
        budget[0] += " of the search"
    budget += [f"{count(row.target_cost)} samples"] if row.target_cost is not None else []
    if rounds:
        budget += [f"{several(most, 'round')} of {stage}" for stage, most in rounds_of(row).items()]
    say(f"{name} now has a budget of {' and '.join(budget)}." + ("" if driven else f" Go on: halma resume {name}"))


def set_fields(
    name: StudyName,
    fields: Annotated[
        list[str], typer.Argument(metavar="FIELD=VALUE...", help=f"Fields: {', '.join((*SHORT, *AMENDABLE))}.")
    ],
    db: Db = None,
    as_json: AsJson = False,
) -> None:
    """Change how a study is run: its priority, share, pool, width, retries. A running study follows at once.

    For example: halma set STUDY priority=5 pool=gpu
    """
    with session(db) as opened:
        before = opened.store.study(name)
        asked = read_amendments(before, fields)
        with opened.store.transaction() as change:
            row = change.amend(name, asked)
    if as_json:
        print_json(study_json(row, spec=True))
        return
    for field in asked:
        was, now = (value_of(field_of(each.spec, field)) for each in (before, row))
        say(f"{name}: {field} is {now}" + ("" if was == now else f" (it was {was})"))


def _resume_there(opened: Session, row: StudyRow, *, here: bool) -> None:
    """Let a service go on with a study."""
    if here:
        raise BadInput("resume: expected none of --inline, --take-over, --ray-address with a service, found one")
    with opened.store.transaction() as change:
        change.ask(row.name, "run")
    say(f"The service at {opened.server} goes on with {row.name}. Follow it: halma watch {row.name}")


def resume(
    name: StudyName,
    inline: Annotated[bool, typer.Option("--inline", help="Run trials in this process, without Ray.")] = False,
    take_over: TakeOver = False,
    ray: RayAddress = None,
    db: Db = None,
    artifacts: Artifacts = None,
) -> None:
    """Go on with a study that was paused, interrupted, cancelled or extended."""
    with session(db, artifacts) as opened:
        row = opened.store.study(name)
        if row.state is StudyState.COMPLETE:
            done = sum(row.counts.get(state.value, 0) for state in OBSERVED_TRIAL)
            raise WrongState(
                f"resume: expected a study with budget left, found {name} complete after {several(done, 'trial')}; "
                f"look at it with `halma show {name}`, or give it more with `halma extend {name} --trials 10`"
            )
        if opened.server is not None:
            _resume_there(opened, row, here=inline or take_over or ray is not None)
            return
        settle(opened.store, opened.artifacts)
        drive_here(opened, name, inline=inline, take_over=take_over, ray_address=ray)
