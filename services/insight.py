"""What a study's search has learnt, as plain JSON, the same for the command line and the API.

The figures come from `search.insight`; here the record is translated for it, and its words into a study's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from search import Candidate, Observation, SearchError
from search.insight.importance import Importances, importances, narrowed
from search.insight.slices import Ask, Axis, NothingYet, Slice, foot_of, slice_of
from search.insight.surrogates import MODELS_BEHAVIOUR, MODELS_VALUE, Subject, Surrogates
from search.record import SEARCH, read_record
from services.course import answers
from services.errors import BadInput
from services.lineage import learnt_before
from services.proposing import proposal_key
from services.report import spec_of
from services.space_text import space_yaml
from services.spec import ResolvedSpec
from services.states import OBSERVED_TRIAL
from services.store.port import StudyRow, TrialRow
from services.translate import begin_with_points, make_strategy_of

MOST_FOR_NEXT = 2000
"""Observations up to which the next proposal is worked out for looking: a strategy may take seconds beyond."""
ROUNDED_FROM = 200
"""Observations from which surrogates for looking are fitted anew only every 1 % or so."""


def looked_at(n: int) -> int:
    """How many of `n` observations a surrogate for looking is fitted to: all up to 200, then every 1 to 2 % anew."""
    if n <= ROUNDED_FROM:
        return n
    step = 1 << int(math.log2(n / 100))
    return n - n % step


@dataclass(frozen=True, slots=True)
class Looked:
    """A study's strategy and surrogates over the first trials of its history.

    Args:
        spec: of the study.
        trials: the observed trials, in the order of finishing.
        known: the surrogates.
    """

    spec: ResolvedSpec
    trials: Sequence[TrialRow]
    known: Surrogates


def look(row: StudyRow, history: Sequence[TrialRow]) -> Looked:
    """Surrogates of a study; nothing is fitted yet.

    Args:
        row: the study.
        history: its finished trials, in order of position.

    Raises:
        BadInput: the study has no space.
    """
    spec = spec_of(row)
    if not isinstance(spec, ResolvedSpec):
        raise BadInput(f"study {row.name!r}: expected one with a space, found one that was never checked by its task")
    # What later stages train from the same states on is theirs: it would be noise to the search.
    trials = [trial for trial in history if trial.state in OBSERVED_TRIAL and trial.stage == SEARCH]
    trials = trials[: looked_at(len(trials))]
    strategy = make_strategy_of(spec)
    record = read_record(strategy.space, strategy.features, _observations(trials), [])
    return Looked(spec, trials, Surrogates(strategy, record))


def _observations(trials: Sequence[TrialRow]) -> list[Observation]:
    places = {trial.number: place for place, trial in enumerate(trials)}
    return [
        Observation(
            _candidate(trial, places),
            value=trial.value,
            features=None if trial.features is None else list(trial.features),
            cost=float(trial.samples),
            status=trial.state.value,  # type: ignore[arg-type]  # the observed states are the statuses
        )
        for trial in trials
    ]


def _candidate(trial: TrialRow, places: Mapping[int, int]) -> Candidate:
    parent = None if trial.warm_start is None else places.get(trial.warm_start)
    return Candidate(dict(trial.params), trial.z, parent)


def next_proposal(looked: Looked, pending: Sequence[TrialRow], next_number: int) -> dict[str, Any] | None:
    """What the study's strategy would propose now, exactly; None where that isn't worked out or there is nothing more.

    Args:
        looked: with its whole history.
        pending: open trials, by number.
        next_number: number of the trial that it would become.
    """
    if looked.known.strategy.name not in MODELS_BEHAVIOUR | MODELS_VALUE or len(looked.trials) > MOST_FOR_NEXT:
        return None
    places = {trial.number: place for place, trial in enumerate(looked.trials)}
    rng = np.random.default_rng(np.random.SeedSequence(proposal_key(looked.spec.seed, next_number)))
    try:
        found = begin_with_points(looked.known.strategy, looked.spec).propose(
            _observations(looked.trials), [_candidate(trial, places) for trial in pending], 1, rng
        )
    except SearchError:
        return None  # a record that the strategy can't learn from stops the study, which says why
    return {"params": dict(found[0].params), "z": found[0].z, "info": dict(found[0].info)} if found else None


def default_output(looked: Looked) -> str:
    """What a slice shows if nothing else is said."""
    return "value" if looked.known.subject == "value" else "novelty"


def default_axes(looked: Looked, subject: Subject) -> tuple[str, str | None]:
    """The two parameters that the surrogate says matter most; the first two before anything is known."""
    known, names = looked.known, looked.known.space.names
    ready = known.has_values if subject == "value" else known.has_behaviours
    order = np.argsort(known.lengths(subject), kind="stable") if ready else np.arange(len(names))
    return names[order[0]], names[order[1]] if len(names) > 1 else None


def slice_json(looked: Looked, ask: Ask) -> dict[str, Any]:
    """A slice without what is open. Raises `BadInput`."""
    names = looked.spec.behaviour.names if looked.spec.behaviour else ()
    try:
        found = slice_of(looked.known, ask, names)
    except NothingYet as error:
        return _empty(looked, ask, str(error))
    except SearchError as error:
        raise BadInput(f"slice: {error}") from None
    return {
        "x": axis_json(looked.spec, found.x),
        "y": None if found.y is None else axis_json(looked.spec, found.y),
        "output": {"name": ask.output, **output_words(looked.spec, ask.output)},
        "z": ask.z,
        "mean": matrix(found.mean),
        "deviation": matrix(found.deviation),
        "acquisition": None if found.acquisition is None else matrix(found.acquisition),
        "acquisition_name": found.acquisition_name,
        "samples": _samples(looked, ask, found),
        "others": dict(found.others),
        "observations": len(looked.trials),
        "note": " ".join(found.notes),
    }


def _empty(looked: Looked, ask: Ask, why: str) -> dict[str, Any]:
    """A slice before anything is known: axes and a reason."""
    from search.insight.slices import axis, centre  # noqa: PLC0415 - only here

    known = looked.known
    others = known.space.from_unit(centre(known))
    return {
        "x": axis_json(looked.spec, axis(known.space, ask.x, ask.size)),
        "y": None if ask.y is None else axis_json(looked.spec, axis(known.space, ask.y, ask.size)),
        "output": {"name": ask.output, **output_words(looked.spec, ask.output)},
        "z": ask.z,
        "mean": [],
        "deviation": [],
        "acquisition": None,
        "acquisition_name": "",
        "samples": [],
        "others": {name: value for name, value in others.items() if name not in {ask.x, ask.y}},
        "observations": 0,
        "note": f"{why[0].upper()}{why[1:]}.",
    }


def axis_json(spec: ResolvedSpec, axis: Axis) -> dict[str, Any]:
    """An axis with its unit."""
    return {
        "name": axis.name,
        "label": words(axis.name),
        "unit": unit_of(spec, axis.name, axis.scale),
        "scale": axis.scale,
        "values": list(axis.values),
    }


def words(name: str) -> str:
    """A name for people."""
    return name.replace("_", " ")


def unit_of(spec: ResolvedSpec, name: str, scale: str = "") -> str:
    """Unit of a parameter; angles are in radians where nothing else is said."""
    return spec.units.get(name, "rad" if scale == "angle" else "")


def output_words(spec: ResolvedSpec, output: str) -> dict[str, str]:
    """Label and unit of what a slice shows."""
    behaviour = spec.behaviour
    distance = "" if behaviour is None else "rad" if behaviour.kind != "euclidean" else behaviour.unit
    if output == "novelty":
        return {"label": "distance to the nearest known behaviour", "unit": distance}
    if output == "feasible":
        return {"label": "probability that a trial completes", "unit": ""}
    number = output.removeprefix("feature:")
    if behaviour is not None and number.isdigit() and int(number) < len(behaviour.names):
        return {"label": words(behaviour.names[int(number)]), "unit": behaviour.unit}
    return {"label": words(output), "unit": ""}


def _samples(looked: Looked, ask: Ask, found: Slice) -> list[dict[str, Any]]:
    samples = []
    for shown in found.samples:
        trial = looked.trials[shown.index]
        samples.append({
            "number": trial.number,
            **_place(looked, ask, trial.params),
            "z": trial.z,
            "value": number_or_none(shown.value),
            "state": trial.state.value,
            "near": significant(shown.near),
        })  # fmt: skip
    return samples


def _place(looked: Looked, ask: Ask, params: Mapping[str, Any]) -> dict[str, Any]:
    space = looked.known.space
    return {
        "x": foot_of(space, params, ask.x),
        "y": None if ask.y is None else foot_of(space, params, ask.y),
    }


def open_json(
    looked: Looked, ask: Ask, pending: Sequence[TrialRow], proposal: Mapping[str, Any] | None
) -> dict[str, Any]:
    """What is open on a slice: pending trials, and the next proposal."""
    return {
        "pending": [
            {"number": trial.number, **_place(looked, ask, trial.params), "z": trial.z, "state": trial.state.value}
            for trial in pending
        ],
        "next": None if proposal is None else {**_place(looked, ask, proposal["params"]), **proposal},
    }


def importance_json(looked: Looked, subject: Subject | None = None) -> dict[str, Any]:
    """Which parameters matter, and the setting to go on from."""
    known = looked.known
    subject = known.subject if subject is None else subject
    if subject == "behaviour" and known.strategy.features is None:
        raise BadInput("of: expected `value`, because behaviour plays no part in this study, found behaviour")
    found = importances(known, subject, np.random.default_rng(0))
    return {
        "of": subject,
        "parameters": [
            {
                "name": each.name,
                "label": words(each.name),
                "unit": unit_of(looked.spec, each.name),
                "length_scale": significant(each.length_scale),
                "from_length_scales": significant(each.from_length_scales),
                "permutation": significant(each.permutation),
                "interval": [significant(each.interval[0]), significant(each.interval[1])],
            }
            for each in (found.parameters if found else ())
        ],
        "agreement": None if found is None or found.agreement is None else significant(found.agreement),
        "explained": None if found is None else significant(found.explained),
        "observations": 0 if found is None else found.observations,
        "best": best_json(looked),
        "note": _importance_note(looked, subject, found),
    }


LITTLE = 0.1
"""Share of the variance below which the surrogate predicts too little for its importances to say much."""
AGREES = 0.5
"""Rank correlation from which the two importances are said to agree."""


def _importance_note(looked: Looked, subject: Subject, found: Importances | None) -> str:
    if found is None:
        level = " at full difficulty" if any(trial.z is not None for trial in looked.trials) else ""
        known = sum(map(answers, looked.trials))
        return f"Too few complete trials{level} ({known}) to tell which parameters matter."
    share = max(0.0, found.explained)
    seen = f"From {found.observations} observations: {share:.0%} of the variance of the {subject} is predicted unseen."
    said = [seen]
    if found.explained < LITTLE:
        said.append("That is too little for these importances to say much; more trials would help.")
    elif found.agreement is not None and found.agreement < AGREES:
        said.append(
            "The two importances rank the parameters differently: trust the permutation, which counts how much changes."
        )
    if not looked.known.is_own(subject):
        said.append(f"The surrogate was fitted for looking: {looked.known.strategy.name} uses none of the {subject}.")
    return " ".join(said)


def best_trial(trials: Sequence[TrialRow]) -> TrialRow | None:
    """The complete trial of the real task (no difficulty, or z = 1) with the highest value; the first of equals."""
    return max(filter(answers, trials), key=lambda trial: (trial.value or 0.0, -trial.number), default=None)


def best_json(looked: Looked) -> dict[str, Any] | None:
    """The best setting at full difficulty, and the part of the space around it as a section of a study file."""
    trial = best_trial(looked.trials)
    if trial is None:
        return None
    known = looked.known
    lengths = known.lengths("value")
    parameters = narrowed(known.space, known.space.to_unit(trial.params), lengths)
    return {
        "number": trial.number,
        "value": trial.value,
        "params": dict(trial.params),
        "yaml": space_yaml(parameters, trial, learnt_before(trial, looked.trials)),
    }


def significant(value: float) -> float:
    """Six significant digits: what a picture can show, in a third of the bytes."""
    return float(f"{value:.6g}")


def number_or_none(value: float) -> float | None:
    """JSON has no NaN."""
    return significant(value) if math.isfinite(value) else None


def matrix(values: np.ndarray[Any, np.dtype[np.float64]]) -> list[list[float]]:
    """Rows of numbers."""
    return [[significant(value) for value in line] for line in values.tolist()]


def with_defaults(looked: Looked, ask: Ask) -> Ask:
    """An ask whose empty output or axes are filled in: the output of the study's search, the parameters that matter."""
    output = ask.output or default_output(looked)
    subject: Subject = "value" if output == "value" else "behaviour"
    if looked.known.strategy.features is None:
        subject = "value"
    first, second = default_axes(looked, subject)
    x = ask.x or first
    y = ask.y or next((name for name in (second, first) if name not in {None, x}), None)
    return replace(ask, output=output, x=x, y=y)
