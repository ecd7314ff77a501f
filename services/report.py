"""What a study found, from its record alone: the distinct strategies, or the best trials, and what they cost."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from search import cluster_joined, distinct
from services.spec import Behaviour, ResolvedSpec, StudySpec
from services.states import TrialState
from services.store.port import StudyRow, TrialRow
from services.translate import search_features

BEST = 5
"""How many trials stand for a study whose task has no behaviour."""

NAME = "name"
"""The detail in which a task says in words what a trial found."""

MOST_DETAILS = 2
"""Named results beside the value that a table has room for."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One distinct strategy, or one of the best trials.

    Args:
        trial: its representative: the member with the highest value.
        members: numbers of all trials that count as the same strategy, the representative among them.
    """

    trial: TrialRow
    members: tuple[int, ...]


def spec_of(row: StudyRow) -> StudySpec:
    """The spec that a study was created with."""
    return StudySpec.from_json(row.spec)


def behaviour_of(row: StudyRow) -> Behaviour | None:
    """What a behaviour is in a study; None where it plays no part."""
    spec = spec_of(row)
    return spec.behaviour if isinstance(spec, ResolvedSpec) else None


def units_of(row: StudyRow) -> Mapping[str, str]:
    """Units of a study's parameters."""
    spec = spec_of(row)
    return spec.units if isinstance(spec, ResolvedSpec) else {}


def distinct_trials(row: StudyRow, history: Sequence[TrialRow]) -> list[Finding]:
    """The distinct strategies among a study's complete trials, best first, of equals the earliest trial's;
    empty where behaviour plays no part.

    Two behaviours count as different where they are further apart than the task's `distinct`.
    """
    behaviour = behaviour_of(row)
    metric = search_features(behaviour)
    rows = [trial for trial in history if _shows_behaviour(trial)]
    if behaviour is None or metric is None or not rows:
        return []
    values = [_worth(trial) for trial in rows]
    clusters = distinct([trial.features for trial in rows], values, metric, behaviour.distinct)
    found = [
        Finding(rows[cluster.representative], tuple(rows[index].number for index in cluster.members))
        for cluster in clusters
    ]
    # Terminal, page and picture number them in this order, so that "strategy 3" is the same one everywhere.
    return sorted(found, key=lambda finding: (-_worth(finding.trial), finding.trial.number))


def distinct_with(row: StudyRow, found: Sequence[Finding], trial: TrialRow) -> list[Finding] | None:
    """The strategies with the trial that finished next; None where `distinct_trials` has to look at all of them.

    Args:
        row: the study.
        found: its strategies before, as `distinct_trials` gives them.
        trial: the one that finished after all of theirs.
    """
    behaviour = behaviour_of(row)
    metric = search_features(behaviour)
    if behaviour is None or metric is None or not _shows_behaviour(trial):
        return list(found)
    leaders = [finding.trial for finding in found]
    place = cluster_joined(
        trial.features,
        _worth(trial),
        [leader.features for leader in leaders],
        [_worth(leader) for leader in leaders],
        metric,
        behaviour.distinct,
    )
    if place is None:
        return None
    joined = Finding(leaders[place], (*found[place].members, trial.number))
    return [*found[:place], joined, *found[place + 1 :]]


def _shows_behaviour(trial: TrialRow) -> bool:
    return trial.state is TrialState.COMPLETE and trial.features is not None and not _refused(trial)


def _worth(trial: TrialRow) -> float:
    return -math.inf if trial.value is None else trial.value


def _refused(trial: TrialRow) -> bool:
    """Whether the task's own audit refused what the trial found; most tasks have none."""
    judged = trial.details.get("audit")
    return isinstance(judged, Mapping) and judged.get("passed") is False


def findings(row: StudyRow, history: Sequence[TrialRow]) -> list[Finding]:
    """The distinct strategies, or the best trials of the task itself (z = 1) where behaviour plays no part."""
    if behaviour_of(row) is not None:
        return distinct_trials(row, history)
    complete = [trial for trial in history if trial.state is TrialState.COMPLETE and trial.value is not None]
    complete = [trial for trial in complete if not _refused(trial)]
    # Values of easier versions of the task don't compare with those of the task itself, which alone is the answer.
    complete = [trial for trial in complete if trial.z in {None, 1.0}]
    best = sorted(complete, key=lambda trial: (-(trial.value or 0.0), trial.number))
    return [Finding(trial, (trial.number,)) for trial in best[:BEST]]


def value_name(found: Sequence[Finding]) -> str:
    """What the value is called: a detail that equals it in every finding names it (`bar`), else it is `value`."""
    shared = _shared_details(found)
    same = [name for name in shared if all(finding.trial.details[name] == finding.trial.value for finding in found)]
    return same[0] if same else "value"


def strategy_name(trial: TrialRow) -> str:
    """What a trial's task calls its behaviour (`face-up layout, head first`); empty where it calls it nothing."""
    name = trial.details.get(NAME)
    return name if isinstance(name, str) else ""


def shown_details(found: Sequence[Finding], behaviour: Behaviour | None) -> list[str]:
    """Names of the details worth a column: in every finding, and neither the value nor the behaviour once more.

    A task whose value has a name has said what counts; its other details are for `halma trials --json`.
    """
    if value_name(found) != "value":
        return []
    known = {NAME, *(behaviour.names if behaviour else ())}
    return [name for name in _shared_details(found) if name not in known][:MOST_DETAILS]


def _shared_details(found: Sequence[Finding]) -> list[str]:
    """Details that every finding has as a number or a word, in their order."""
    plain = [{name for name, value in finding.trial.details.items() if _is_figure(value)} for finding in found]
    shared = set.intersection(*plain) if plain else set()
    return [name for name in found[0].trial.details if name in shared] if found else []


def _is_figure(value: Any) -> bool:
    return isinstance(value, int | float | str) and not isinstance(value, bool)


def feature_words(features: Sequence[float] | None, behaviour: Behaviour) -> str:
    """A behaviour in words: an angle in degrees, other coordinates as numbers."""
    if features is None:
        return "-"
    if behaviour.unit == "rad" and behaviour.kind != "rotation":
        return ", ".join(f"{math.degrees(value):.0f}°" for value in features)
    return ", ".join(f"{value:.2f}" for value in features)


def feature_head(behaviour: Behaviour) -> str:
    """The head above `feature_words`."""
    if behaviour.kind == "rotation":
        return f"rotation ({' '.join(behaviour.names)})"
    unit = f" ({behaviour.unit})" if behaviour.unit and behaviour.unit != "rad" else ""
    return ", ".join(behaviour.names) + unit


def detail_words(value: Any) -> str:
    """A detail in a cell."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, int | float) else str(value)
