"""What may be changed of a study once it exists: how it is run, never what it is.

Space, seed, task, search and training make a study what it is: its trials would no longer belong together, and no
proposal could be repeated. How many trials run at once, where, before whom, and how often they are tried again changes
nothing of what a trial comes to.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from services.errors import BadInput
from services.problems import BadStudy, Source, nearest
from services.spec import StudySpec
from services.spec_complaints import explained
from services.spec_file import overridden
from services.store.port import JSON, StudyRow

AMENDABLE = (
    "priority",
    "share",
    "resources.pool",
    "resources.parallel",
    "resources.cpus",
    "retries.limit",
    "retries.total",
    "retries.backoff_seconds",
    "stop_after_failures",
    "keep_checkpoints",
)
"""Fields of the study file, by dotted name, besides its budget (which can be raised)."""

SHORT = {name.rpartition(".")[2]: name for name in AMENDABLE if name.startswith("resources.")}
"""What may be typed instead: `pool` for `resources.pool`."""


def read_amendments(row: StudyRow, texts: Sequence[str]) -> dict[str, JSON]:
    """`["priority=5", "pool=gpu"]` as fields and values that this study can have.

    Raises:
        BadInput: a field that can't be changed, or a value that it can't have.
    """
    full = []
    for text in texts:
        name, equals, value = text.partition("=")
        full.append(f"{SHORT.get(name.strip(), name.strip())}{equals}{value}")
    try:
        data, set_by = overridden(row.spec, full)
    except BadStudy as error:
        raise BadInput(_as_typed(error)) from None
    fields = {".".join(map(str, place)): _at(data, place) for place in set_by}
    return checked(row, fields)


def checked(row: StudyRow, fields: Mapping[str, JSON]) -> dict[str, JSON]:
    """Fields and values that this study can have, as its spec keeps them.

    Raises:
        BadInput: see `read_amendments`.
    """
    for name in fields:
        if name not in AMENDABLE:
            budget = name in {"search.trials", "search.cost"}
            what = f"raise it with `halma extend {row.name}`" if budget else nearest(name, AMENDABLE)
            raise BadInput(f"{name}: expected a field that can be changed once the study exists, found {name}; {what}")
    data = json.loads(json.dumps(row.spec))
    for name, value in fields.items():
        *outer, last = name.split(".")
        inner = data
        for part in outer:
            inner = inner.setdefault(part, {})
        inner[last] = value
    try:
        spec = StudySpec.from_json(data)
    except ValidationError as error:
        source = Source(row.name, {}, {tuple(name.split(".")): f"{name}={value}" for name, value in fields.items()})
        problems = [explained(details, data, source) for details in error.errors()]
        raise BadInput(_as_typed(BadStudy(problems))) from None
    plain = spec.to_json()
    return {name: _at(plain, tuple(name.split("."))) for name in fields}


def field_of(spec: Mapping[str, JSON], name: str) -> JSON:
    """The value of a field by its dotted name; None where an older study doesn't have it."""
    value: Any = spec
    for part in name.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def _at(data: Mapping[str, Any], place: Sequence[Any]) -> Any:
    for part in place:
        data = data[part]
    return data


def _as_typed(error: BadStudy) -> str:
    """The problems without the `--set` that study files' overrides are given with."""
    return "\n".join(line.removeprefix("--set ") for line in str(error).splitlines())
