"""Listings as tables for people; `services.listings` is what scripts get."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from services.cli.words import count, duration, first_line, value_of
from services.spec import Behaviour
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
}

MOST_COLUMNS = 8
"""Parameters that get a column each; a space with more is shown in one column."""


def plain_table(*, title: str | None = None) -> Table:
    """A table in the house's style: no frame, one line under the head."""
    return Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)


def state_text(state: str) -> Text:
    """A state in its colour."""
    return Text(state, style=STATE_STYLES.get(state, ""))


def done_of(row: StudyRow) -> str:
    """Finished trials of those wanted: `12 of 20`."""
    open_trials = row.counts.get("queued", 0) + row.counts.get("running", 0)
    done = sum(row.counts.values()) - open_trials - row.counts.get("cancelled", 0)
    return count(done) if row.target_trials is None else f"{count(done)} of {count(row.target_trials)}"


def studies_table(rows: Iterable[StudyRow]) -> Table:
    """`halma ls`."""
    table = plain_table()
    for head in ("study", "state", "task", "strategy"):
        table.add_column(head, no_wrap=True)
    for head in ("trials", "best", "samples", "training"):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("created", no_wrap=True)
    table.add_column("note")
    for row in rows:
        table.add_row(
            Text(row.name),
            state_text(row.state.value),
            Text(str(row.spec.get("task", {}).get("name", "-"))),
            Text(str(row.spec.get("search", {}).get("strategy", "-"))),
            done_of(row),
            value_of(row.best_value),
            count(row.samples),
            duration(row.seconds),
            row.created_at.astimezone().strftime("%Y-%m-%d %H:%M"),
            Text(first_line(row.reason, 60)),
        )
    return table


def feature_heads(behaviour: Behaviour | None) -> list[str]:
    """Column heads of the features, with their unit."""
    if behaviour is None:
        return []
    unit = f" ({behaviour.unit})" if behaviour.unit else ""
    return [f"{name}{unit}" for name in behaviour.names]


def parameter_heads(names: Sequence[str], units: Mapping[str, str]) -> list[str]:
    """Column heads of the parameters, with their units; one for all of them where they are many."""
    if len(names) > MOST_COLUMNS:
        return ["parameters"]
    return [f"{name} ({units[name]})" if units.get(name) else name for name in names]


def parameter_cells(names: Sequence[str], params: Mapping[str, Any]) -> list[str]:
    """The cells under `parameter_heads`."""
    if len(names) > MOST_COLUMNS:
        return [", ".join(f"{name} {value_of(params.get(name))}" for name in names)]
    return [value_of(params.get(name)) for name in names]


def trials_table(
    rows: Sequence[TrialRow], behaviour: Behaviour | None, units: Mapping[str, str], *, with_z: bool
) -> Table:
    """`halma trials`."""
    names = list(rows[0].params) if rows else []
    table = plain_table()
    table.add_column("trial", justify="right")
    table.add_column("state", no_wrap=True)
    heads = ["value", *feature_heads(behaviour), *(["z"] if with_z else []), *parameter_heads(names, units)]
    for head in [*heads, "samples", "time", "tries"]:
        table.add_column(head, justify="right")
    table.add_column("note")
    for row in rows:
        features: list[Any] = list(row.features or [None] * len(behaviour.names)) if behaviour else []
        table.add_row(
            str(row.number),
            state_text(row.state.value),
            value_of(row.value),
            *map(value_of, features),
            *([value_of(row.z)] if with_z else []),
            *parameter_cells(names, row.params),
            count(row.samples),
            duration(row.seconds),
            str(row.attempts),
            Text(first_line(row.message, 60)),
        )
    return table


def fields_table(fields: Mapping[str, Any]) -> Table:
    """Names and values, one a line."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in fields.items():
        table.add_row(Text(name), value if isinstance(value, Text) else Text(value_of(value)))
    return table
