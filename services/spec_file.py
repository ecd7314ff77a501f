"""From the text of a study file to a `Draft`: a `StudySpec`, or every problem with its file, line and field.

A problem reads `file:line: field: expected ..., found ...`; where an override of the command line is to blame, the
override stands in place of file and line.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from services.errors import SpecError
from services.located_yaml import BadYaml, Located, parse
from services.located_yaml import Path as Place
from services.spec import (
    AngleParameter,
    CategoricalParameter,
    FloatParameter,
    IntParameter,
    Resources,
    Retries,
    SearchPlan,
    StudySpec,
    TaskChoice,
)

_SECTIONS: Mapping[str, type[BaseModel]] = {
    "task": TaskChoice,
    "search": SearchPlan,
    "resources": Resources,
    "retries": Retries,
}
_PARAMETERS: Mapping[str, type[BaseModel]] = {
    "float": FloatParameter,
    "int": IntParameter,
    "categorical": CategoricalParameter,
    "angle": AngleParameter,
}


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
    """

    name: str
    lines: Mapping[Place, int]
    overrides: Mapping[Place, str] = field(default_factory=dict)

    def problem(self, place: Place, message: str) -> Problem:
        """A problem at a place; where the place was never written, the nearest one around it names the line."""
        return Problem(self.origin(place), dotted(place), message)

    def origin(self, place: Place) -> str:
        """`file:line` of the innermost written value that holds the place, or the override that set it."""
        for length in range(len(place), 0, -1):
            here = place[:length]
            if here in self.overrides:
                return f"--set {self.overrides[here]}"
            if here in self.lines:
                return f"{self.name}:{self.lines[here]}"
        return f"{self.name}:1"

    def order(self, problem: Problem) -> tuple[bool, int]:
        """Sorting key: by line, overrides last."""
        line = problem.origin.removeprefix(f"{self.name}:")
        return (not line.isdigit(), int(line) if line.isdigit() else 0)


@dataclass(frozen=True, slots=True)
class Draft:
    """A study file that has been read.

    Args:
        data: plain values, overrides applied, short forms spelled out; a mapping, or nothing usable.
        source: to name lines with.
        spec: None where a problem keeps it from being one.
        problems: what is wrong so far.
    """

    data: Mapping[str, Any]
    source: Source
    spec: StudySpec | None
    problems: tuple[Problem, ...]


def read_draft(path: Path, overrides: Sequence[str] = ()) -> Draft:
    """Read a study file.

    Args:
        path: of the YAML file.
        overrides: `field.field=value`, values in YAML.

    Raises:
        BadStudy: the file can't be read, or is no YAML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise BadStudy([Problem(str(path), "", _missing_file(path))]) from None
    except UnicodeDecodeError as error:
        message = f"expected text in UTF-8, found the byte 0x{error.object[error.start]:02x} at position {error.start}"
        raise BadStudy([Problem(str(path), "", message)]) from None
    except OSError as error:
        message = f"expected a readable study file, found: {error.strerror or error}"
        raise BadStudy([Problem(str(path), "", message)]) from None
    return draft(text, name=str(path), overrides=overrides)


def draft(text: str, *, name: str, overrides: Sequence[str] = ()) -> Draft:
    """Read the text of a study file. `name` stands for the file in errors.

    Raises:
        BadStudy: the text is no YAML, or an override is no override.
    """
    try:
        document = parse(text)
    except BadYaml as error:
        origin = f"{name}:{error.line}" if error.line else name
        raise BadStudy([Problem(origin, dotted(error.path), error.message)]) from None
    if not isinstance(document.value, dict):
        found = "an empty file" if document.value is None else found_value(document.value)
        raise BadStudy([Problem(f"{name}:1", "", f"expected a study (name, task, search, ...), found {found}")])
    data, set_by = _overridden(document, overrides)
    source = Source(name, document.lines, set_by)
    try:
        return Draft(data, source, StudySpec.model_validate(data), ())
    except ValidationError as error:
        problems = [_explained(details, data, source) for details in error.errors()]
        return Draft(data, source, None, tuple(sorted(problems, key=source.order)))


def nearest(word: str, known: Iterable[str]) -> str:
    """`; did you mean X?` where a known word is near, else the known words."""
    known = sorted(known)
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    return f"did you mean {close[0]}?" if close else f"known: {', '.join(known)}"


def dotted(place: Place) -> str:
    """`search.trials` for ("search", "trials")."""
    return ".".join(str(part) for part in place)


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


def _missing_file(path: Path) -> str:
    folder = path.parent
    message = "expected a study file, found no such file"
    if not folder.is_dir():
        return f"{message} (there is no folder {folder} either)"
    others = [other.name for other in folder.iterdir() if other.suffix in {".yaml", ".yml"}]
    close = difflib.get_close_matches(path.name, others, n=1, cutoff=0.6)
    return f"{message}; did you mean {folder / close[0]}?" if close else message


def _overridden(document: Located, overrides: Sequence[str]) -> tuple[dict[str, Any], dict[Place, str]]:
    """The document with the overrides applied, and which override set what."""
    data: dict[str, Any] = json.loads(json.dumps(document.value))
    if overrides and isinstance(data.get("task"), str):
        data["task"] = {"name": data["task"]}
    set_by: dict[Place, str] = {}
    problems: list[Problem] = []
    for override in overrides:
        origin = f"--set {override}"
        name, equals, text = override.partition("=")
        place = tuple(name.strip().split("."))
        if not equals or not all(place):
            problems.append(Problem(origin, "", "expected field=value, for example search.trials=4"))
            continue
        try:
            value = parse(text).value
        except BadYaml as error:
            problems.append(Problem(origin, dotted(place), error.message))
            continue
        inner = _mapping_for(data, place)
        if inner is None:
            problems.append(
                Problem(origin, dotted(place), f"expected a field of a mapping, found that {_leaf(data, place)}")
            )
            continue
        inner[place[-1]] = value
        set_by[place] = override
    if problems:
        raise BadStudy(problems)
    return data, set_by


def _mapping_for(data: dict[str, Any], place: tuple[str, ...]) -> dict[str, Any] | None:
    """The mapping that holds the last part of a place, made where it is missing; None where a value is in the way."""
    for part in place[:-1]:
        inner = data.get(part)
        if inner is None:
            inner = data[part] = {}
        if not isinstance(inner, dict):
            return None
        data = inner
    return data


def _leaf(data: Mapping[str, Any], place: tuple[str, ...]) -> str:
    """Which part of a place is no mapping, in words."""
    value: Any = data
    for length, part in enumerate(place, start=1):
        value = value.get(part)
        if not isinstance(value, dict):
            return f"{dotted(place[:length])} is {found_value(value)}"
    return f"{dotted(place)} is a mapping"


def _explained(details: ErrorDetails, data: Mapping[str, Any], source: Source) -> Problem:
    """One of pydantic's complaints, in our words and with its place in the file."""
    place = _place(details["loc"])
    kind = details["type"]
    found = details["input"]
    context: Mapping[str, Any] = details.get("ctx", {})
    if kind == "section":
        return source.problem((*place, *context["field"].split(".")), context["message"])
    if kind == "choices":
        return source.problem(place, details["msg"])
    if kind == "extra_forbidden":
        return source.problem(
            place, f"expected a known key, found {place[-1]}; {nearest(str(place[-1]), _known(place[:-1], data))}"
        )
    if kind == "missing":
        return source.problem(place, f"expected {_meaning(place, data)}, found nothing")
    if kind in {"union_tag_not_found", "union_tag_invalid"}:
        tag = context.get("tag")
        tip = f"; {nearest(str(tag), _PARAMETERS)}" if tag is not None else ""
        shown = "nothing" if tag is None else f"'{tag}'"
        return source.problem((*place, "type"), f"expected one of {', '.join(_PARAMETERS)}, found {shown}{tip}")
    return source.problem(place, f"expected {_expectation(kind, context, place)}, found {found_value(found)}")


_PLAIN_EXPECTATIONS: Mapping[str, str] = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing_size": "a whole number of at most 18 digits",
    "float_type": "a number",
    "finite_number": "a finite number",
    "string_type": "text",
    "bool_type": "true or false",
    "dict_type": "a mapping (key: value)",
    "mapping_type": "a mapping (key: value)",
    "model_type": "a mapping (key: value)",
    "model_attributes_type": "a mapping (key: value)",
    "list_type": "a list",
    "tuple_type": "a list",
}


def _expectation(kind: str, context: Mapping[str, Any], place: Place) -> str:
    """What a value should have been."""
    if kind in _PLAIN_EXPECTATIONS:
        if place[:1] == ("space",) and len(place) == 2:
            return "a parameter, for example {type: float, low: 0, high: 1}, or angle"
        return _PLAIN_EXPECTATIONS[kind]
    bounds = {
        "greater_than": ("gt", "a number above {}"),
        "greater_than_equal": ("ge", "a number of at least {}"),
        "less_than": ("lt", "a number below {}"),
        "less_than_equal": ("le", "a number of at most {}"),
        "too_short": ("min_length", "at least {} entry"),
        "string_too_short": ("min_length", "at least {} character"),
        "string_too_long": ("max_length", "at most {} characters"),
    }
    if kind in bounds:
        key, sentence = bounds[kind]
        limit = context[key]
        return sentence.format(int(limit) if float(limit).is_integer() else limit)
    if kind == "string_pattern_mismatch":
        return "a name of letters, digits, `_`, `-` and `.`, beginning with a letter or a digit"
    return str(context.get("expected", "another value"))


def _place(loc: tuple[int | str, ...]) -> Place:
    """Pydantic's place without the name of the union member, which is no part of the file."""
    if loc[:1] == ("space",) and len(loc) > 2 and loc[2] in _PARAMETERS:
        return (*loc[:2], *loc[3:])
    return loc


def _model(place: Place, data: Mapping[str, Any]) -> type[BaseModel] | None:
    """The section that stands at a place."""
    if not place:
        return StudySpec
    if len(place) == 1:
        return _SECTIONS.get(str(place[0]))
    if place[0] == "space" and len(place) == 2:
        entry = data["space"][place[1]]
        return _PARAMETERS.get(str(entry.get("type"))) if isinstance(entry, dict) else None
    return None


def _known(place: Place, data: Mapping[str, Any]) -> list[str]:
    model = _model(place, data)
    return list(model.model_fields) if model else []


def _meaning(place: Place, data: Mapping[str, Any]) -> str:
    """What a missing field is, from its description."""
    model = _model(place[:-1], data)
    known = model.model_fields.get(str(place[-1])) if model else None
    return known.description if known and known.description else f"the section {place[-1]}"
