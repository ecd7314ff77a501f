"""What matters in a study, for the terminal: importances, the best setting, the ladder of difficulties."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import RenderableType

from services.cli.layout import Column, fitted
from services.cli.session import console, say
from services.cli.words import count, duration, value_of
from services.fidelity import levels
from services.report import spec_of
from services.spec import ResolvedSpec
from services.states import OBSERVED_TRIAL
from services.store.port import StudyRow, TrialRow


@dataclass(frozen=True, slots=True)
class Matters:
    """What a study has learnt about its parameters and difficulties.

    Args:
        importance: as the API tells it; None for a study that has no space.
        ladder: difficulties and their cost, easiest first; empty where there are none.
    """

    importance: Mapping[str, Any] | None
    ladder: Sequence[Mapping[str, Any]]

    def to_json(self) -> dict[str, Any]:
        """For scripts."""
        return {"importance": self.importance, "ladder": list(self.ladder)}


def matters_of(row: StudyRow, trials: Sequence[TrialRow]) -> Matters:
    """Work it out.

    Args:
        row: the study.
        trials: all its trials, by number.
    """
    importance = None
    if isinstance(spec_of(row), ResolvedSpec):
        from services.insight import importance_json, look  # noqa: PLC0415 - a surrogate, which other commands need not

        placed = [trial for trial in trials if trial.state in OBSERVED_TRIAL]
        importance = importance_json(look(row, sorted(placed, key=lambda trial: trial.position or 0)))
    return Matters(importance, levels(trials))


def show_matters(matters: Matters) -> None:
    """Print it; nothing where nothing is known yet."""
    screen = console()
    told = matters.importance
    if told is not None and told["parameters"]:
        say()
        say(f"What matters to the {told['of']}:")
        screen.print(importance_table(told["parameters"], screen.width))
        say(told["note"])
    elif told is not None and told["best"] is not None:
        say()
        say(told["note"])
    if matters.ladder:
        say()
        say("Difficulties:")
        screen.print(ladder_table(matters.ladder, screen.width))
    if told is not None and told["best"] is not None and told["parameters"]:
        say()
        say("To search on around the best setting, put this into the next study file:")
        for line in told["best"]["yaml"].splitlines():
            say(f"  {line}")


def importance_table(parameters: Sequence[Mapping[str, Any]], width: int) -> RenderableType:
    """Parameters, the most important first."""
    return fitted(
        [
            Column("parameter", [each["name"] for each in parameters], left=True),
            Column("permutation", [f"{each['permutation']:.3f}" for each in parameters]),
            Column(
                "95 % interval", [f"{each['interval'][0]:.3f} to {each['interval'][1]:.3f}" for each in parameters], 2
            ),
            Column("by length scale", [f"{each['from_length_scales']:.0%}" for each in parameters]),
            Column("length scale\n(ranges)", [value_of(each["length_scale"]) for each in parameters], rank=1),
        ],
        width,
    )


def ladder_table(ladder: Sequence[Mapping[str, Any]], width: int) -> RenderableType:
    """Difficulties, easiest first."""
    whole = sum(level["samples"] for level in ladder)
    return fitted(
        [
            Column("z", [value_of(level["z"]) for level in ladder]),
            Column("trials", [count(level["trials"]) for level in ladder]),
            Column("best", [value_of(level["best"]) for level in ladder]),
            Column("samples", [count(level["samples"]) for level in ladder]),
            Column("share", [f"{level['samples'] / whole:.0%}" if whole else "-" for level in ladder]),
            Column("training", [duration(level["seconds"]) for level in ladder], rank=1),
        ],
        width,
    )
