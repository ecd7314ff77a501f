"""Listings as tables for people; `services.listings` is what scripts get."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from search.record import SEARCH
from services.budget import has_stages, most_trials
from services.cli.layout import Column, fitted
from services.cli.words import count, duration, first_line, value_of
from services.lineage import began_anew
from services.spec import Behaviour
from services.stages import StageProgress
from services.store.port import StudyRow, TrialRow

STATE_STYLES: Mapping[str, str] = {
    "running": "cyan",
    "complete": "green",
    "paused": "yellow",
    "queued": "dim",
    "infeasible": "yellow",
    "diverged": "magenta",
    "failed": "red",
    "cancelled": "dim",
    "waiting": "dim",
    "over": "green",
}

MOST_COLUMNS = 8
"""Parameters that get a column each; a space with more is shown in one column."""


def state_text(state: str) -> Text:
    """A state in its colour."""
    return Text(state, style=STATE_STYLES.get(state, ""))


def done_of(row: StudyRow) -> str:
    """Finished trials of those wanted: `12 of 20`."""
    open_trials = row.counts.get("queued", 0) + row.counts.get("running", 0)
    done = sum(row.counts.values()) - open_trials - row.counts.get("cancelled", 0)
    most = most_trials(row)
    return count(done) if most is None else f"{count(done)} of {'at most ' if has_stages(row) else ''}{count(most)}"


def studies_table(rows: Sequence[StudyRow], width: int) -> RenderableType:
    """`halma ls`."""
    return fitted(
        [
            Column("study", [row.name for row in rows], left=True),
            Column("state", [state_text(row.state.value) for row in rows], left=True),
            Column("task", [str(row.spec.get("task", {}).get("name", "-")) for row in rows], rank=3, left=True),
            Column("strategy", [str(row.spec.get("search", {}).get("strategy", "-")) for row in rows], 4, left=True),
            Column("trials", [done_of(row) for row in rows]),
            Column("best", [value_of(row.best_value) for row in rows]),
            Column("samples", [count(row.samples) for row in rows], rank=6),
            Column("training", [duration(row.seconds) for row in rows], rank=2),
            Column("created", [row.created_at.astimezone().strftime("%Y-%m-%d %H:%M") for row in rows], 5, left=True),
            Column("note", [first_line(row.reason) for row in rows], rank=1, sentences=True),
        ],
        width,
    )


def with_unit(name: str, unit: str | None) -> str:
    """A head with its unit below it: narrower than beside it."""
    return f"{name}\n({unit})" if unit else name


def parameter_columns(trials: Sequence[TrialRow], units: Mapping[str, str], rank: int = 0) -> list[Column]:
    """The parameters of trials, a column each; one column for all where they are many."""
    names = list(trials[0].params) if trials else []
    if len(names) > MOST_COLUMNS:
        cells = [", ".join(f"{name} {value_of(trial.params.get(name))}" for name in names) for trial in trials]
        return [Column("parameters", cells, rank=rank, sentences=True)]
    return [
        Column(with_unit(name, units.get(name)), [value_of(trial.params.get(name)) for trial in trials], rank=rank)
        for name in names
    ]


def feature_columns(trials: Sequence[TrialRow], behaviour: Behaviour | None) -> list[Column]:
    """The features of trials, a column each."""
    if behaviour is None:
        return []
    return [
        Column(
            with_unit(name, behaviour.unit),
            [value_of(None if trial.features is None else trial.features[index]) for trial in trials],
        )
        for index, name in enumerate(behaviour.names)
    ]


def parent_of(trial: TrialRow) -> str:
    """The trial whose policy it started from; `(statistics)` where its networks have other sizes and began anew."""
    if trial.warm_start is None:
        return "-"
    return f"{trial.warm_start} (statistics)" if began_anew(trial) else str(trial.warm_start)


def trials_table(
    rows: Sequence[TrialRow], behaviour: Behaviour | None, units: Mapping[str, str], width: int
) -> RenderableType:
    """`halma trials`."""
    with_z = any(trial.z is not None for trial in rows)
    with_stages = any(trial.stage != SEARCH for trial in rows)
    with_parents = any(trial.warm_start is not None for trial in rows)
    return fitted(
        [
            Column("trial", [str(trial.number) for trial in rows]),
            *([Column("stage", [trial.stage for trial in rows], left=True)] if with_stages else []),
            Column("state", [state_text(trial.state.value) for trial in rows], left=True),
            Column("value", [value_of(trial.value) for trial in rows]),
            *feature_columns(rows, behaviour),
            *([Column("z", [value_of(trial.z) for trial in rows])] if with_z else []),
            *([Column("from", [parent_of(trial) for trial in rows], left=True)] if with_parents else []),
            *parameter_columns(rows, units, rank=2),
            Column("samples", [count(trial.samples) for trial in rows], rank=4),
            Column("time", [duration(trial.seconds) for trial in rows], rank=3),
            Column("tries", [str(trial.attempts) for trial in rows], rank=5),
            Column("note", [first_line(trial.message) for trial in rows], rank=1, sentences=True),
        ],
        width,
    )


def stages_table(stages: Sequence[StageProgress], width: int) -> RenderableType:
    """The stages of a study, in the order in which they follow each other."""
    return fitted(
        [
            Column("stage", [stage.name for stage in stages], left=True),
            Column("kind", [stage.kind for stage in stages], left=True),
            Column("after", [", ".join(stage.after) or "-" for stage in stages], left=True),
            Column("state", [state_text(stage.state) for stage in stages], left=True),
            Column("trials", [f"{count(stage.done)} of at most {count(stage.most)}" for stage in stages]),
            Column("running", [count(stage.running) for stage in stages], rank=2),
            Column("new strategies", [count(stage.new) for stage in stages]),
            Column("best", [value_of(stage.best) for stage in stages]),
            Column("samples", [count(stage.samples) for stage in stages], rank=3),
            Column("training", [duration(stage.seconds) for stage in stages], rank=1),
        ],
        width,
    )


def fields_table(fields: Mapping[str, Any]) -> Table:
    """Names and values, one a line."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in fields.items():
        table.add_row(Text(name), value if isinstance(value, Text) else Text(value_of(value)))
    return table
