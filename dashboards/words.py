"""Numbers, times and states in words, for pages."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from services.value import UNIT_OF_VALUE

GLYPHS: Mapping[str, str] = {
    "queued": "○",
    "running": "◐",
    "paused": "‖",
    "complete": "●",
    "infeasible": "◇",
    "diverged": "≈",
    "failed": "✕",
    "cancelled": "–",
    "lost": "⌁",
    "preempted": "‖",
}
"""One shape for each state, so that colour is never the only sign."""


UNITS: Mapping[str, str] = {**UNIT_OF_VALUE, "facing": "rad", "approach": "m/s", "level": "m"}
"""Units of the results that tasks name, by their names."""


def number(value: Any, digits: int = 4) -> str:
    """A number with so many significant digits; text as it is, nothing as a dash."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f").replace("-", "\u2212")
    if isinstance(value, float):
        if not math.isfinite(value):
            return str(value)
        return f"{value:.{digits}g}".replace("-", "\u2212")
    return str(value)


def amount(value: float) -> str:
    """A large count, short: 1.2 M."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:.3g}\u202f{letter}"
    return f"{value:.0f}"


def duration(seconds: float | None) -> str:
    """A time span in its two largest units."""
    if seconds is None:
        return "–"
    if seconds < 10:
        return f"{seconds:.1f}\u202fs"
    whole = round(seconds)
    parts: list[str] = []
    for size, unit in ((86400, "d"), (3600, "h"), (60, "min"), (1, "s")):
        count, whole = divmod(whole, size)
        if count or parts:
            parts.append(f"{count}\u202f{unit}")
        if len(parts) == 2:
            break
    return " ".join(parts) or "0\u202fs"


def size(count: int) -> str:
    """Bytes, short."""
    if count < 1000:
        return f"{count}\u202fB"
    return f"{count / 1000:.3g}\u202fkB" if count < 1_000_000 else f"{count / 1e6:.3g}\u202fMB"


def moment(at: datetime | None) -> str:
    """A time as ISO 8601 in UTC, which the page's script turns into the reader's own."""
    return "" if at is None else at.astimezone(UTC).isoformat(timespec="seconds")


def glyph(state: str) -> str:
    """The shape of a state."""
    return GLYPHS.get(state, "·")


def feature(value: float, unit: str) -> str:
    """One coordinate of a behaviour; angles in degrees, which is what people picture."""
    if unit == "rad":
        return f"{math.degrees(value):.0f}°".replace("-", "\u2212")
    return number(float(value), 3) + (f"\u202f{unit}" if unit else "")


def listing(value: Any) -> str:
    """A list or a mapping in a cell: its parts as `number` writes them."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {listing(inner)}" for key, inner in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(listing(inner) for inner in value)
    return number(value)


def result(value: Any, name: str) -> str:
    """A named result with its unit, where its name has one."""
    unit = UNITS.get(name)
    if unit is None or isinstance(value, bool) or not isinstance(value, int | float):
        return number(value)
    return feature(value, unit)
