"""Profiles of a study file: named sets of sections laid over the rest of it, of which one is chosen.

    name: walk
    search: {strategy: cmfbo, cost: 20000000}
    profile: quick                 # what runs where nobody says otherwise; may be left out
    profiles:
      quick: {name: walk-quick, search: {cost: 200000}, training: {network: {hidden: [64, 64]}}}
      paper: {training: {network: {hidden: [1024, 512]}}}

Mappings are merged key by key, everything else (numbers, texts, lists, nothing) replaces what the file says. A study
keeps the name of its profile and the sections as they came out, not the profiles that were not chosen.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from services.located_yaml import Located
from services.located_yaml import Path as Place

PROFILE, PROFILES = "profile", "profiles"


class BadProfile(ValueError):
    """The profiles of a file are none, or lack the one that was asked for.

    Args:
        place: where in the file.
        message: what was expected and what was found.
    """

    def __init__(self, place: Place, message: str) -> None:
        super().__init__(message)
        self.place = place
        self.message = message


@dataclass(frozen=True, slots=True)
class Profiled:
    """A study file with one of its profiles laid over it.

    Args:
        value: the study, without its profiles.
        lines: of each value, wherever it was written.
        moved: for each place that a profile wrote, its place in the file.
    """

    value: dict[str, Any]
    lines: dict[Place, int]
    moved: dict[Place, Place] = field(default_factory=dict)


def profiles_of(document: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """The profiles of a file by name, none where it has none. Raises `BadProfile`."""
    given = document.get(PROFILES)
    if given is None:
        return {}
    if not isinstance(given, dict):
        raise BadProfile((PROFILES,), "expected profiles by name, for example quick: {search: {trials: 4}}")
    for name, sections in given.items():
        if not isinstance(sections, dict):
            raise BadProfile((PROFILES, name), "expected the sections that it changes, for example {search: ...}")
        for key in (PROFILE, PROFILES):
            if key in sections:
                raise BadProfile((PROFILES, name, key), f"expected a section of a study, found {key} in a profile")
    return given


def choose(document: Located, name: str | None) -> Profiled:
    """Lay a profile over the file that holds it.

    Args:
        document: the file, a mapping, its profiles checked by `profiles_of`.
        name: of a profile that it has, or None for the file as it stands.
    """
    value = {key: inner for key, inner in document.value.items() if key not in {PROFILE, PROFILES}}
    result = Profiled(json.loads(json.dumps(value)), dict(document.lines))
    if name is None:
        return result
    result.value[PROFILE] = name
    sections = document.value[PROFILES][name]
    if isinstance(result.value.get("task"), str) and isinstance(sections.get("task"), dict):
        result.value["task"] = {"name": result.value["task"]}  # the short form, spelled out to be merged with
    _lay(result, document, (), (PROFILES, name), result.value, sections)
    return result


def _lay(
    result: Profiled, document: Located, to: Place, origin: Place, below: dict[str, Any], above: Mapping[str, Any]
) -> None:
    """Merge one mapping of a profile, written at `origin`, into the one of the study at `to`."""
    for key, value in above.items():
        place, source = (*to, key), (*origin, key)
        if isinstance(value, dict) and isinstance(below.get(key), dict):
            _lay(result, document, place, source, below[key], value)
            continue
        below[key] = json.loads(json.dumps(value))
        for stale in [known for known in result.lines if known[: len(place)] == place]:
            del result.lines[stale]
        for written in [known for known in document.lines if known[: len(source)] == source]:
            here = (*place, *written[len(source) :])
            result.lines[here] = document.lines[written]
            result.moved[here] = written


def relaxed(schema: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON schema of what a profile may hold: that of a study, where nothing is required.

    Args:
        schema: of a study, with its definitions under `$defs`.
    """
    definitions = schema.get("$defs", {})

    def loosen(part: Any) -> Any:
        if isinstance(part, list):
            return [loosen(each) for each in part]
        if not isinstance(part, Mapping):
            return part
        if "$ref" in part:
            return loosen(definitions[part["$ref"].rpartition("/")[2]])
        # Without their required keys the kinds of a parameter can't be told apart any more.
        return {
            {"oneOf": "anyOf"}.get(key, key): loosen(inner)
            for key, inner in part.items()
            if key not in {"required", "discriminator"}
        }

    properties = {name: loosen(part) for name, part in schema["properties"].items() if name != PROFILE}
    return {"type": "object", "properties": properties, "additionalProperties": False}
