"""Tables that fit the window: what matters least gives way first, and the table says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

GAP = 2
"""Columns between two columns of a table."""

SHORTEST = 16
"""A column of sentences is cut to no less."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    Args:
        head: its head; may have two lines.
        cells: one for each row.
        rank: 0 is never left out; of the others the highest goes first.
        left: whether it is aligned to the left, as words are; numbers aren't.
        sentences: whether its cells may be cut at the end.
    """

    head: str
    cells: Sequence[Text | str]
    rank: int = 0
    left: bool = False
    sentences: bool = False

    @property
    def empty(self) -> bool:
        """Whether no cell says anything."""
        return not any(str(cell) for cell in self.cells)

    @property
    def width(self) -> int:
        """Of its longest line."""
        lines = [line for text in (self.head, *map(str, self.cells)) for line in text.splitlines()]
        return max(map(len, lines), default=0)

    @property
    def least(self) -> int:
        """The least width that it can be given."""
        return min(self.width, SHORTEST) if self.sentences else self.width


def plain_table() -> Table:
    """A table in the house's style: no frame, one line under the head."""
    return Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, padding=(0, GAP - 1, 0, 0))


def fitted(columns: Sequence[Column], width: int) -> RenderableType:
    """A table of these columns in so many terminal columns. Columns of sentences that say nothing are left out."""
    kept = [column for column in columns if not (column.sentences and column.empty)]
    hidden: list[Column] = []
    while _needed(kept) > width and (last := max(kept, key=lambda column: column.rank)).rank:
        kept.remove(last)
        hidden.append(last)
    table = plain_table()
    spare = max(0, width - _needed(kept))
    for column in kept:
        most = column.least + spare if column.sentences else None
        table.add_column(
            column.head,
            justify="left" if column.left or column.sentences else "right",
            no_wrap=True,
            overflow="ellipsis",
            max_width=most,
        )
    for cells in zip(*(column.cells for column in kept), strict=True):
        table.add_row(*(cell if isinstance(cell, Text) else Text(cell) for cell in cells))
    if not hidden:
        return table
    names = ", ".join(" ".join(column.head.split()) for column in columns if column in hidden)
    return Group(table, Text(f"(not shown in so narrow a window: {names})", style="dim"))


def _needed(columns: Sequence[Column]) -> int:
    return sum(column.least for column in columns) + GAP * max(0, len(columns) - 1)
