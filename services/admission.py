"""Taking a checked study into the trial database, and telling an old study from a changed one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from services.amending import AMENDABLE
from services.budget import rounds_of
from services.errors import BadInput, NameTaken, UnknownStudy
from services.problems import found_value
from services.spec import ResolvedSpec, StudySpec
from services.store.port import JSON, Store, StudyRow


class StudyChanged(BadInput):
    """A study of that name exists, and its file now asks for something else."""


def admit(store: Store, spec: ResolvedSpec) -> StudyRow:
    """Create a study, `queued`.

    Raises:
        NameTaken: a study of that name exists; the message says how to go on with it.
    """
    try:
        with store.transaction() as change:
            return change.create_study(
                spec.name,
                spec.to_json(),
                seed=spec.seed,
                pool=spec.resources.pool,
                priority=spec.priority,
                target_trials=spec.search.trials,
                target_cost=spec.search.cost,
            )
    except NameTaken:
        raise NameTaken(
            f"name: expected the name of a new study, found {spec.name}, which exists; "
            f"look at it with `halma show {spec.name}`, go on with `halma resume {spec.name}` or "
            f"`halma extend {spec.name} --trials N`, or give this one another name (--name)"
        ) from None


def find(store: Store, name: str) -> StudyRow | None:
    """The study of that name, or None."""
    try:
        return store.study(name)
    except UnknownStudy:
        return None


@dataclass(frozen=True, slots=True)
class Changes:
    """What a study file asks for that its study doesn't have yet, and may have.

    Args:
        fields: to be amended, by dotted name.
        trials: so many more.
        cost: so many more samples.
        words: `field: what it was -> what it will be`, for people.
    """

    fields: Mapping[str, JSON]
    trials: int
    cost: float
    words: tuple[str, ...]

    def __bool__(self) -> bool:
        return bool(self.words)


def changes_of(row: StudyRow, spec: StudySpec, origin: str, anew: str) -> Changes:
    """What a study file asks for, other than when its study was created.

    What the file leaves to the task is no change: a newer task may have another space, the study keeps its own.
    Neither is a budget that the study has meanwhile been extended to, nor the one it began with.

    Args:
        row: the study.
        spec: what its file asks for now, not resolved.
        origin: where the file gives the name, `file:line`.
        anew: the command that makes a new study of the file.

    Raises:
        StudyChanged: something that makes the study what it is; says what, what may be changed, and what can be done.
    """
    stored, asked = StudySpec.from_json(row.spec).to_json(), spec.to_json()
    if asked["space"] is None:
        asked["space"] = stored["space"]
    old, new = (flat({name: fields[name] for name in StudySpec.model_fields}) for fields in (stored, asked))
    differing = [key for key in sorted({*old, *new}) if old.get(key) != new.get(key)]
    fields, more, fixed, words = {}, dict[str, float](), [], []
    for key in differing:
        target = {"search.trials": row.target_trials, "search.cost": row.target_cost}.get(key)
        if key in AMENDABLE and key in new:
            fields[key] = new[key]
            words.append(f"{key}: {_shown(old, key)} -> {_shown(new, key)}")
        elif target is None or new.get(key) is None or new[key] < target:
            fixed.append(f"  {key}: {_found(old, key, target)} in the study, {_shown(new, key)} in the file")
        elif new[key] > target:
            more[key] = new[key] - target
            words.append(f"{key}: {found_value(target)} -> {_shown(new, key)}")
    if fixed:
        raise StudyChanged("\n".join([*_what_changed(row, origin, fixed), *_what_may(row, words, anew)]))
    return Changes(fields, int(more.get("search.trials", 0)), more.get("search.cost", 0.0), tuple(words))


def apply_changes(store: Store, row: StudyRow, changes: Changes) -> StudyRow:
    """Make the changes, all or none."""
    with store.transaction() as change:
        if changes.fields:
            row = change.amend(row.name, changes.fields)
        if changes.trials or changes.cost:
            row = change.extend(row.name, trials=changes.trials, cost=changes.cost)
    return row


def _what_changed(row: StudyRow, origin: str, fixed: list[str]) -> list[str]:
    return [f"{origin}: name: expected the study {row.name} as it was created, or a new name, found changes:", *fixed]


def _what_may(row: StudyRow, words: list[str], anew: str) -> list[str]:
    fine = f" Of this file that is: {'; '.join(words)}." if words else ""
    how = ", ".join(AMENDABLE)
    return [
        "A study keeps what makes it what it is: task, space, seed, search, training, stages. Nothing was changed.",
        f"What can change is how it is run ({how}), and its budget (search.trials, search.cost) can be raised.{fine}",
        *([f"More rounds of a polish: halma extend {row.name} --rounds N."] if rounds_of(row) else []),
        f"Run this file as a new study: {anew}. Go on with the old one as it is: halma resume {row.name}",
    ]


def _found(flattened: Mapping[str, Any], key: str, target: float | None) -> str:
    return _shown(flattened, key) if target is None else found_value(target)


def _shown(flattened: Mapping[str, Any], key: str) -> str:
    return found_value(flattened[key]) if key in flattened else "nothing"


def flat(value: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as one, with dotted keys; empty mappings vanish."""
    flattened: dict[str, Any] = {}
    for key, inner in value.items():
        name = f"{prefix}{key}"
        if isinstance(inner, Mapping):
            flattened.update(flat(inner, f"{name}."))
        else:
            flattened[name] = inner
    return flattened
