"""Tables fit the window."""

from __future__ import annotations

import io

from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from services.cli.layout import SHORTEST, Column, fitted


def drawn(columns, width):
    console = Console(width=width, file=io.StringIO(), color_system=None)
    console.print(fitted(columns, width))
    return console.file.getvalue().splitlines()


def test_what_matters_least_gives_way_first_and_is_named():
    columns = [
        Column("name", ["a", "b"], left=True),
        Column("cost\n(s)", ["12345678", "1"], rank=2),
        Column("tries", ["12345", "1"], rank=1),
    ]
    assert [line.rstrip() for line in drawn(columns, 40)] == [
        "          cost",
        "name       (s)  tries",
        "─" * 21,
        "a     12345678  12345",
        "b            1      1",
    ]
    narrow = " ".join(line.strip() for line in drawn(columns, 20))
    assert "12345678" not in narrow
    assert narrow.endswith("(not shown in so narrow a window: cost (s))")


def test_sentences_are_cut_and_left_out_where_there_are_none():
    columns = [Column("id", ["1"]), Column("note", ["a long sentence that has no room at all"], sentences=True)]
    line = drawn(columns, 24)[-1].rstrip()
    assert line == " 1  a long sentence tha…"
    silent = [Column("id", ["1"]), Column("note", [""], sentences=True)]
    assert "note" not in "".join(drawn(silent, 24))


@given(
    st.lists(st.tuples(st.integers(1, 12), st.integers(0, 3), st.booleans()), min_size=1, max_size=8),
    st.integers(20, 120),
)
def test_no_line_is_longer_than_the_window_where_anything_could_give_way(shapes, width):
    columns = [
        Column(f"c{n}", ["x" * size * (8 if sentences else 1)], rank=rank, sentences=sentences)
        for n, (size, rank, sentences) in enumerate(shapes)
    ]
    kept = [column for column in columns if not column.rank]
    least = sum(min(column.width, SHORTEST) if column.sentences else column.width for column in kept) + 2 * len(kept)
    lines = drawn(columns, width)
    assert all(len(line.rstrip()) <= max(width, least) for line in lines)
