"""The complaints of the spec's models in our own words, with their places in the study file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from services.located_yaml import Path as Place
from services.problems import Problem, Source, found_value, nearest
from services.spec import (
    AngleParameter,
    CategoricalParameter,
    FloatParameter,
    IntParameter,
    NoveltyStage,
    PolishStage,
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
_STAGES: Mapping[str, type[BaseModel]] = {"novelty": NoveltyStage, "polish": PolishStage}
_UNIONS: Mapping[str, tuple[str, Mapping[str, type[BaseModel]]]] = {
    "space": ("type", _PARAMETERS),
    "stages": ("kind", _STAGES),
}
"""Sections of named entries, each of one of several kinds: the key that tells which, and the kinds."""


def explained(details: ErrorDetails, data: Mapping[str, Any], source: Source) -> Problem:
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
        key, kinds = _UNIONS[str(place[0])]
        tip = f"; {nearest(str(tag), kinds)}" if tag is not None else ""
        shown = "nothing" if tag is None else f"'{tag}'"
        return source.problem((*place, key), f"expected one of {', '.join(kinds)}, found {shown}{tip}")
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
        if place[:1] == ("stages",) and len(place) == 2:
            return "a stage, for example {kind: polish, after: search}"
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
    if len(loc) > 2 and loc[0] in _UNIONS and loc[2] in _UNIONS[str(loc[0])][1]:
        return (*loc[:2], *loc[3:])
    return loc


def _model(place: Place, data: Mapping[str, Any]) -> type[BaseModel] | None:
    """The section that stands at a place."""
    if not place:
        return StudySpec
    if len(place) == 1:
        return _SECTIONS.get(str(place[0]))
    if place[0] in _UNIONS and len(place) == 2:
        key, kinds = _UNIONS[str(place[0])]
        entry = data[str(place[0])][place[1]]
        return kinds.get(str(entry.get(key))) if isinstance(entry, dict) else None
    return None


def _known(place: Place, data: Mapping[str, Any]) -> list[str]:
    model = _model(place, data)
    return list(model.model_fields) if model else []


def _meaning(place: Place, data: Mapping[str, Any]) -> str:
    """What a missing field is, from its description."""
    model = _model(place[:-1], data)
    known = model.model_fields.get(str(place[-1])) if model else None
    return known.description if known and known.description else f"the section {place[-1]}"
