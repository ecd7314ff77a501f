"""Reading what the terminal shows."""

from __future__ import annotations


def rows_below(text, head):
    """The lines of a table: those after its rule, up to the next empty line."""
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if head in line)
    body = lines[start + 2 :]
    return body[: body.index("")] if "" in body else body
