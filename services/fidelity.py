"""The difficulties a study searched at, and what each level cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from services.states import OBSERVED_TRIAL
from services.store.port import TrialRow


def level_of(z: float) -> float:
    """The level that a difficulty belongs to: to a thousandth."""
    return round(z, 3)


def levels(trials: Sequence[TrialRow]) -> list[dict[str, Any]]:
    """Each difficulty, easiest first: trials (all of them, and those that finished), samples and seconds.

    Empty where no trial has a difficulty.
    """
    found: dict[float, dict[str, Any]] = {}
    for trial in trials:
        if trial.z is None:
            continue
        z = level_of(trial.z)
        level = found.setdefault(z, {"z": z, "trials": 0, "finished": 0, "samples": 0, "seconds": 0.0, "best": None})
        level["trials"] += 1
        level["finished"] += trial.state in OBSERVED_TRIAL
        level["samples"] += trial.samples
        level["seconds"] += trial.seconds
        if trial.state.value == "complete" and trial.value is not None:
            level["best"] = trial.value if level["best"] is None else max(level["best"], trial.value)
    return [{**found[z], "seconds": round(found[z]["seconds"], 3)} for z in sorted(found)]


TENTHS_FROM = 12
"""Different difficulties from which they count as continuous: a bar for each trial would tell nothing."""


def gathered(trials: Sequence[TrialRow]) -> list[dict[str, Any]]:
    """The levels as a chart of costs shows them: `levels`, or its tenths where the difficulty is continuous."""
    found = levels(trials)
    if len(found) <= TENTHS_FROM:
        return found
    tenths: dict[float, dict[str, Any]] = {}
    for level in found:
        middle = round(min(9, math.floor(level["z"] * 10)) / 10 + 0.05, 2)
        tenth = tenths.setdefault(middle, {"z": middle, "trials": 0, "samples": 0, "seconds": 0.0})
        for figure in ("trials", "samples", "seconds"):
            tenth[figure] += level[figure]
    return [tenths[middle] for middle in sorted(tenths)]


def point(trial: TrialRow) -> dict[str, Any]:
    """A trial on the ladder."""
    return {
        "number": trial.number,
        "z": trial.z,
        "value": trial.value,
        "samples": trial.samples,
        "state": trial.state.value,
    }
