"""Taking a checked study into the trial database, and telling an old study from a changed one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from services.errors import BadInput, NameTaken, UnknownStudy
from services.problems import found_value
from services.spec import ResolvedSpec, StudySpec
from services.store.port import Store, StudyRow


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


def refuse_changes(row: StudyRow, spec: StudySpec, origin: str) -> None:
    """Refuse a study file that no longer asks for what its study was created with.

    What the file leaves to the task is no change: a newer task may have another space, the study keeps its own.
    Neither is a budget that the study has meanwhile been extended to.

    Args:
        row: the study.
        spec: what its file asks for now, not resolved.
        origin: where the file gives the name, `file:line`.

    Raises:
        StudyChanged: what changed, and what can be done.
    """
    stored, asked = StudySpec.from_json(row.spec).to_json(), spec.to_json()
    if asked["space"] is None:
        asked["space"] = stored["space"]
    old, new = (flat({name: fields[name] for name in StudySpec.model_fields}) for fields in (stored, asked))
    if row.target_trials == new.get("search.trials"):
        old["search.trials"] = new["search.trials"]
    if row.target_cost == new.get("search.cost"):
        old["search.cost"] = new["search.cost"]
    changed = [key for key in sorted({*old, *new}) if old.get(key) != new.get(key)]
    if not changed:
        return
    lines = [f"  {key}: {_shown(old, key)} in the study, {_shown(new, key)} in the file" for key in changed]
    raise StudyChanged(
        "\n".join(
            [
                f"{origin}: name: expected the study {row.name} as it was created, or a new name, found changes:",
                *lines,
                f"A study keeps what it was created with. {_advice(row, changed, new)}",
            ]
        )
    )


def _advice(row: StudyRow, changed: list[str], new: Mapping[str, Any]) -> str:
    fresh = "run the changed file as a new study with `--name NEW`"
    trials = new.get("search.trials")
    if changed == ["search.trials"] and trials is not None and row.target_trials is not None:
        more = trials - row.target_trials
        if more > 0:
            return f"Raise its budget with `halma extend {row.name} --trials {more}`, or {fresh}."
    return f"Go on with it as it is (`halma resume {row.name}`), or {fresh}."


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
