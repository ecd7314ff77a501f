"""Numbers, times and values as people read them in a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from services.states import StudyState


def count(number: float) -> str:
    """12,345."""
    return f"{number:,.0f}"


def several(number: int, thing: str) -> str:
    """1 trial, 2 trials."""
    plural = f"{thing[:-1]}ies" if thing.endswith("y") else f"{thing}s"
    return f"{count(number)} {thing if number == 1 else plural}"


def file_size(size: float) -> str:
    """0 B, 999 B, 12.3 kB, 4.56 MB: powers of 1,000, as disks are sold."""
    if size < 1000:
        return f"{size:.0f} B"
    for unit in ("kB", "MB", "GB"):
        size /= 1000
        if size < 999.5:
            return f"{size:.3g} {unit}"
    return f"{size / 1000:,.3g} TB"


def duration(seconds: float) -> str:
    """45 s, 3 min 20 s, 2 h 5 min."""
    whole = round(seconds)
    if seconds < 10:
        return f"{seconds:.1f} s"
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def number(value: float) -> str:
    """Four significant digits, without an exponent where it can be avoided."""
    if isinstance(value, int):
        return str(value)
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"
    return f"{value:.3g}"


def value_of(value: Any) -> str:
    """A JSON value in a cell of a table; a dash for nothing."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return number(value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(value_of(each) for each in value)
    return str(value)


def state_words(state: StudyState) -> str:
    """What one says of a study in this state."""
    said = {StudyState.FAILED: "failed", StudyState.CANCELLED: "was cancelled"}
    return said.get(state, f"is {state.value}")


def first_line(text: str, width: int = 80) -> str:
    """The beginning of a message, for a cell."""
    line = text.strip().splitlines()[0] if text.strip() else ""
    return line if len(line) <= width else f"{line[: width - 3]}..."
