"""What is wrong with a study: each problem with its file, line and field, in words for people.

A problem reads `file:line: field: expected ..., found ...`; where an override of the command line is to blame, the
override stands in place of file and line.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from services.errors import SpecError
from services.located_yaml import Path as Place
from services.profiles import PROFILE


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong with a study.

    Args:
        origin: `file:line`, `file` or `--set field=value`.
        field: dotted name, empty where no field is to blame.
        message: what was expected and what was found.
    """

    origin: str
    field: str
    message: str

    def __str__(self) -> str:
        parts = (self.origin, self.field, self.message)
        return ": ".join(part for part in parts if part)


class BadStudy(SpecError):
    """A study can't be accepted as it is written; all problems at once.

    Args:
        problems: at least one, in the order of the file.
    """

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


@dataclass(frozen=True, slots=True)
class Source:
    """Where the values of a study come from.

    Args:
        name: of the file, as errors should call it.
        lines: line of each value, by place.
        overrides: the override that set a value, by place.
        moved: where in the file a profile wrote a value, by place in the study.
    """

    name: str
    lines: Mapping[Place, int]
    overrides: Mapping[Place, str] = field(default_factory=dict)
    moved: Mapping[Place, Place] = field(default_factory=dict)

    def problem(self, place: Place, message: str) -> Problem:
        """A problem at a place; where the place was never written, the nearest one around it names the line."""
        return Problem(self.origin(place), dotted(self.written(place)), message)

    def written(self, place: Place) -> Place:
        """The place as the file has it: within a profile, where that wrote it."""
        for length in range(len(place), 0, -1):
            here = place[:length]
            if here in self.overrides:
                return place
            if here in self.moved:
                return (*self.moved[here], *place[length:])
            if here in self.lines:
                return place
        return place

    def origin(self, place: Place) -> str:
        """`file:line` of the innermost written value that holds the place, or the override that set it."""
        for length in range(len(place), 0, -1):
            here = place[:length]
            if here in self.overrides:
                return _shown_override(self.overrides[here])
            if here in self.lines:
                return f"{self.name}:{self.lines[here]}"
            # a mapping that the file doesn't have, made for an override within it
            made = [override for other, override in self.overrides.items() if length > 1 and other[:length] == here]
            if made:
                return _shown_override(made[0])
        return f"{self.name}:1"

    def order(self, problem: Problem) -> tuple[bool, int]:
        """Sorting key: by line, overrides last."""
        line = problem.origin.removeprefix(f"{self.name}:")
        return (not line.isdigit(), int(line) if line.isdigit() else 0)


def _shown_override(override: str) -> str:
    head = f"{PROFILE}="
    return f"--profile {override.removeprefix(head)}" if override.startswith(head) else f"--set {override}"


def nearest(word: str, known: Iterable[str]) -> str:
    """`; did you mean X?` where a known word is near, else the known words."""
    known = sorted(known)
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    return f"did you mean {close[0]}?" if close else f"known: {', '.join(known)}"


def dotted(place: Place) -> str:
    """`search.trials` for ("search", "trials"), `network.hidden[0]` for ("network", "hidden", 0)."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).removeprefix(".")


def found_value(value: Any) -> str:
    """A value as a message should show it: short, and saying what kind of thing it is."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text '{_shortened(value)}'"
    if isinstance(value, dict):
        return (
            f"the mapping {_shortened(json.dumps(value, ensure_ascii=False, default=str))}"
            if value
            else "an empty mapping"
        )
    if isinstance(value, list):
        return (
            f"the list {_shortened(json.dumps(value, ensure_ascii=False, default=str))}" if value else "an empty list"
        )
    return _shortened(str(value))


def _shortened(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."
