"""From the text of a study file to a `Draft`: a `StudySpec`, or every problem with its file, line and field."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from services.located_yaml import BadYaml, Located, parse
from services.located_yaml import Path as Place
from services.problems import BadStudy, Problem, Source, dotted, found_value, nearest
from services.profiles import PROFILE, PROFILES, BadProfile, choose, profiles_of
from services.spec import StudySpec
from services.spec_complaints import explained


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
        overrides: `field.field=value`, values in YAML; `profile=NAME` chooses a profile.

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
    wanted, given = profile_override(overrides)
    try:
        profiles = profiles_of(document.value)
        chosen = wanted if wanted is not None else document.value.get(PROFILE)
        if chosen is not None and chosen not in profiles:
            raise BadProfile((PROFILE,), _no_profile(chosen, profiles))
    except BadProfile as error:
        at = Source(name, document.lines, {} if wanted is None else {(PROFILE,): f"{PROFILE}={wanted}"})
        raise BadStudy([at.problem(error.place, error.message)]) from None
    read = _with_profile(document, name, chosen, given)
    others = [
        problem
        for other in profiles
        if other != chosen
        for problem in _with_profile(document, name, other, ()).problems
        if problem.field.startswith(f"{PROFILES}.{other}.")
    ]
    if not others:
        return read
    return Draft(read.data, read.source, None, tuple(sorted((*read.problems, *others), key=read.source.order)))


def _with_profile(document: Located, name: str, profile: str | None, overrides: Sequence[str]) -> Draft:
    """The study that a file describes under one of its profiles."""
    profiled = choose(document, profile)
    data, set_by = overridden(profiled.value, overrides)
    source = Source(name, profiled.lines, set_by, profiled.moved)
    try:
        return Draft(data, source, StudySpec.model_validate(data), ())
    except ValidationError as error:
        problems = [explained(details, data, source) for details in error.errors()]
        return Draft(data, source, None, tuple(sorted(problems, key=source.order)))


def profile_override(overrides: Sequence[str]) -> tuple[str | None, list[str]]:
    """The profile that the command line asks for (`profile=NAME`, the last one counts), and the other overrides."""
    head = f"{PROFILE}="
    asked = [override.removeprefix(head).strip() for override in overrides if override.startswith(head)]
    return (asked[-1] if asked else None), [override for override in overrides if not override.startswith(head)]


def _no_profile(chosen: Any, profiles: Iterable[str]) -> str:
    if not profiles:
        return f"expected a file with profiles to choose from, found {found_value(chosen)} and none"
    return f"expected a profile of this file, found {found_value(chosen)}; {nearest(str(chosen), profiles)}"


def _missing_file(path: Path) -> str:
    folder = path.parent
    message = "expected a study file, found no such file"
    if not folder.is_dir():
        return f"{message} (there is no folder {folder} either)"
    others = [other.name for other in folder.iterdir() if other.suffix in {".yaml", ".yml"}]
    close = difflib.get_close_matches(path.name, others, n=1, cutoff=0.6)
    return f"{message}; did you mean {folder / close[0]}?" if close else message


def overridden(study: Mapping[str, Any], overrides: Sequence[str]) -> tuple[dict[str, Any], dict[Place, str]]:
    """The study with the overrides applied, and which override set what. Raises `BadStudy`."""
    data: dict[str, Any] = json.loads(json.dumps(study))
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
        place = _in_space(place, value)
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


def _in_space(place: tuple[str, ...], value: object) -> tuple[str, ...]:
    """The place of what an override sets, where it is in the space: names of parameters (`ppo.clip`) have dots."""
    if place[0] != "space" or len(place) < 3:
        return place
    if isinstance(value, dict):
        return "space", ".".join(place[1:])
    return "space", ".".join(place[1:-1]), place[-1]


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
