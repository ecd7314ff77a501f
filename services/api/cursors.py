"""Cursors of lists: where a page ended, as text that nobody has to understand.

A cursor holds the key of the last row that was given, not how many rows there were: what is added or removed elsewhere
in the list between two pages makes no row come twice and none be left out. It says of which list it is, so that one of
another list is refused.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
from collections.abc import Callable, Sequence
from typing import Annotated, Any, TypeVar

from fastapi import Query

from services.errors import BadInput

Row = TypeVar("Row")

LONGEST = 1500
"""Characters; the longest key is that of a worker, whose four names have 255 each at most."""

PageCursor = Annotated[
    str | None,
    Query(
        max_length=LONGEST,
        description="cursor: the `next` of the page before, as it came; the first page where there is none",
    ),
]
"""A route's parameter that says where its page begins."""


def cursor(of: str, *key: float | str | None) -> str:
    """The cursor behind a row.

    Args:
        of: which list.
        key: what the list is ordered by, of that row.
    """
    return base64.urlsafe_b64encode(json.dumps([of, *key]).encode()).decode().rstrip("=")


def key_of(of: str, text: str, *kinds: type | tuple[type, ...]) -> list[Any]:
    """The key that a cursor holds.

    Args:
        of: which list.
        text: the cursor.
        kinds: of the parts of the key.

    Raises:
        BadInput: it is no cursor of that list.
    """
    try:
        found = json.loads(base64.urlsafe_b64decode(text.encode("ascii") + b"=" * (-len(text) % 4)))
    except (ValueError, binascii.Error, RecursionError):
        found = None
    if isinstance(found, list) and len(found) == 1 + len(kinds) and found[0] == of:
        key = found[1:]
        if all(_is(part, kind) for part, kind in zip(key, kinds, strict=True)):
            return key
    raise BadInput(f"page: expected the `next` of a page of {of}, found {text[:80]!r}; leave it out for the first page")


def _is(part: Any, kind: type | tuple[type, ...]) -> bool:
    """Whether a part of a key is of its kind, and a number that a database can hold."""
    if isinstance(part, bool) or not isinstance(part, kind):
        return False
    return not isinstance(part, int | float) or (abs(part) < 2**63 if isinstance(part, int) else math.isfinite(part))


def page_of(
    rows: Sequence[Row], limit: int, of: str, key: Callable[[Row], tuple[int | float | str | None, ...]]
) -> tuple[Sequence[Row], str | None]:
    """The first rows, and the cursor of what follows.

    Args:
        rows: those behind the cursor that was given; one more than `limit` is enough.
        limit: how many are wanted.
        of: which list.
        key: of a row.
    """
    shown = rows[:limit]
    return shown, cursor(of, *key(shown[-1])) if len(rows) > limit else None


def after_key(rows: Sequence[Row], of: str, page: str | None, key: Callable[[Row], tuple[int | float | str, ...]],
              *kinds: type | tuple[type, ...]) -> Sequence[Row]:  # fmt: skip
    """Of rows in ascending order of their keys those behind a cursor."""
    if page is None:
        return rows
    last = tuple(key_of(of, page, *kinds))
    return [row for row in rows if key(row) > last]
