"""The end of `halma run`: the distinct strategies, a picture of them, what they cost, and what to type next."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import RenderableType

from services.budget import has_stages
from services.cli.layout import Column, fitted
from services.cli.session import Session, console, say
from services.cli.tables import parameter_columns
from services.cli.words import count, duration, first_line, several, state_words, value_of
from services.contact_sheet import POSE, Tile, draw
from services.errors import ArtifactDamaged
from services.report import (
    Finding,
    behaviour_of,
    detail_words,
    feature_head,
    feature_words,
    findings,
    shown_details,
    spec_of,
    strategy_name,
    units_of,
    value_name,
)
from services.spec import ResolvedSpec
from services.states import StudyState
from services.store.port import StudyRow


def report(opened: Session, row: StudyRow) -> None:
    """Print what a study found."""
    history = opened.store.history(row.id)
    found = findings(row, history)
    say(_headline(row, found))
    if row.reason and row.state is not StudyState.COMPLETE:
        say(f"Why: {row.reason}")
    elif not found and history:
        say(
            f"The newest trial is {history[-1].state.value}: {first_line(history[-1].message, 200) or 'without a word'}"
        )
    if found:
        say()
        console().print(findings_table(row, found, console().width))
        say()
        _picture(opened, row, found)
    ended = {name: n for name, n in sorted(row.counts.items()) if n}
    say(
        f"Cost: {several(sum(ended.values()), 'trial')} ({', '.join(f'{n} {state}' for state, n in ended.items())}), "
        f"{count(row.samples)} samples, {duration(row.seconds)} of training"
    )
    _next(row, found)


def _headline(row: StudyRow, found: Sequence[Finding]) -> str:
    done = several(sum(row.counts.values()), "trial")
    if behaviour_of(row) is None:
        return f"{row.name} {state_words(row.state)}: {done}" + (f", the best {len(found)} of them:" if found else "")
    if not found:
        return f"{row.name} {state_words(row.state)}: {done}, no strategy that works"
    return f"{row.name} {state_words(row.state)}: {several(len(found), 'distinct strategy')} in {done}"


def findings_table(row: StudyRow, found: Sequence[Finding], width: int) -> RenderableType:
    """What a study found, one a line, in so many columns."""
    behaviour = behaviour_of(row)
    trials = [finding.trial for finding in found]
    columns = [Column("", [str(place) for place in range(1, len(found) + 1)])]
    names = [strategy_name(trial) for trial in trials]
    if any(names):
        columns.append(Column("strategy", names, left=True))
    if behaviour is not None:
        columns.append(Column(feature_head(behaviour), [feature_words(trial.features, behaviour) for trial in trials]))
    columns.append(Column(value_name(found), [value_of(trial.value) for trial in trials]))
    columns += [
        Column(name.replace("_", " "), [detail_words(trial.details[name]) for trial in trials], rank=2)
        for name in shown_details(found, behaviour)
    ]
    columns += parameter_columns(trials, units_of(row), rank=1)
    if has_stages(row):
        columns.append(Column("stage", [trial.stage for trial in trials], left=True))
    columns.append(Column("trial", [str(trial.number) for trial in trials]))
    if behaviour is not None:
        columns.append(Column("also found by", [_others(finding) for finding in found], rank=3, sentences=True))
    return fitted(columns, width)


def _others(finding: Finding) -> str:
    return ", ".join(str(number) for number in finding.members if number != finding.trial.number)


def _picture(opened: Session, row: StudyRow, found: Sequence[Finding]) -> None:
    path = contact_sheet(opened, row, found)
    if path is not None:
        say(f"Picture: {path}")
    elif _may_have_pictures(row):
        say("Picture: none, because the trials left no pose.png")


def _may_have_pictures(row: StudyRow) -> bool:
    spec = spec_of(row)
    return isinstance(spec, ResolvedSpec) and spec.trains


def contact_sheet(opened: Session, row: StudyRow, found: Sequence[Finding]) -> Path | None:
    """Draw one tile for each finding that left a picture; None where there is none, or no place to save it."""
    behaviour = behaviour_of(row)
    details = shown_details(found, behaviour)
    tiles = []
    for place, finding in enumerate(found, start=1):
        trial = finding.trial
        pose = next((left for left in opened.store.artifacts(trial.id) if left.name == POSE), None)
        if pose is None:
            continue
        try:
            data = opened.artifacts.read(pose)
        except ArtifactDamaged as error:
            say(f"Warning: {error}")
            continue
        words = feature_words(trial.features, behaviour) if behaviour else value_of(trial.value)
        named = f"{behaviour.names[0]} {words}" if behaviour and len(behaviour.names) == 1 else words
        name = strategy_name(trial)
        figures = {value_name(found): trial.value, **{name: trial.details[name] for name in details}}
        extra = ", ".join(f"{name.replace('_', ' ')} {detail_words(value)}" for name, value in figures.items())
        caption = f"{named}, {extra}, trial {trial.number}" if name else f"trial {trial.number}, {extra}"
        tiles.append(Tile(data, f"{place}. {name or named}", caption))
    if not tiles:
        return None
    try:
        return draw(tiles, opened.settings.reports / f"{row.name}.png")
    except (OSError, ValueError) as error:
        say(f"Warning: the picture could not be drawn: {error}")
        return None


def _next(row: StudyRow, found: Sequence[Finding]) -> None:
    spec = spec_of(row)
    commands = []
    if found and isinstance(spec, ResolvedSpec) and spec.trains:
        best = found[0].trial.number
        commands.append((f"halma replay {row.name} {best} --video {row.name}-{best}.mp4", "watch it"))
    commands.append((f"halma trials {row.name}", "all trials"))
    if row.state is StudyState.COMPLETE:
        commands.append((f"halma extend {row.name} --trials 10", "search on"))
    else:
        commands.append((f"halma resume {row.name}", "try again" if row.state is StudyState.FAILED else "go on"))
    commands.append(("halma serve", "look at it in the browser"))
    width = max(len(command) for command, _ in commands)
    say("Next:")
    for command, purpose in commands:
        say(f"  {command.ljust(width)}  # {purpose}")
