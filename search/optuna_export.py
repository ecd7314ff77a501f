"""A record as an Optuna study, in a database that Optuna and its dashboard open."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import optuna

from search.errors import SearchError
from search.record import Status
from search.space import Angle, Categorical, Int, Space

_STATES: Mapping[str, optuna.trial.TrialState] = {
    "complete": optuna.trial.TrialState.COMPLETE,
    "infeasible": optuna.trial.TrialState.PRUNED,
    "diverged": optuna.trial.TrialState.FAIL,
    "failed": optuna.trial.TrialState.FAIL,
}
"""Optuna knows no infeasible trial; pruned comes closest: it is learnt from, but is no candidate for the best."""


class ExportRefused(SearchError):
    """The record can't become an Optuna study there."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One finished trial.

    Args:
        params: in natural units.
        status: how it ended.
        value: the objective; None where it has none.
        started, finished: for Optuna's timelines.
        attributes: JSON, kept as user attributes: number, features, cost.
    """

    params: Mapping[str, Any]
    status: Status
    value: float | None
    started: datetime | None
    finished: datetime | None
    attributes: Mapping[str, Any]


def distributions(space: Space) -> dict[str, optuna.distributions.BaseDistribution]:
    """The space in Optuna's words. An angle becomes a float from -pi to pi: Optuna knows no circle."""
    found: dict[str, optuna.distributions.BaseDistribution] = {}
    for name, parameter in space.parameters.items():
        if isinstance(parameter, Angle):
            found[name] = optuna.distributions.FloatDistribution(-math.pi, math.pi)
        elif isinstance(parameter, Categorical):
            found[name] = optuna.distributions.CategoricalDistribution(parameter.choices)
        elif isinstance(parameter, Int):
            found[name] = optuna.distributions.IntDistribution(parameter.low, parameter.high, log=parameter.log)
        else:
            found[name] = optuna.distributions.FloatDistribution(parameter.low, parameter.high, log=parameter.log)
    return found


def export(name: str, space: Space, trials: Sequence[Trial], storage: str) -> int:
    """Write an Optuna study that maximises.

    Args:
        name: of the study in the storage.
        space: what was searched over.
        trials: in the order of finishing. One without a value counts as failed, whatever its status: Optuna keeps
            no complete trial without one.
        storage: URL of an Optuna storage, e.g. `sqlite:///path`.

    Returns:
        How many trials were written.

    Raises:
        ExportRefused: the storage has a study of that name.
    """
    verbosity = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        study = optuna.create_study(study_name=name, storage=storage, direction="maximize")
        known = distributions(space)
        study.add_trials([_frozen(trial, known) for trial in trials])
    except optuna.exceptions.DuplicatedStudyError:
        raise ExportRefused(f"expected no Optuna study {name} in {storage}, found one; give another file") from None
    finally:
        optuna.logging.set_verbosity(verbosity)
    return len(trials)


def _frozen(trial: Trial, known: Mapping[str, optuna.distributions.BaseDistribution]) -> optuna.trial.FrozenTrial:
    state = _STATES[trial.status]
    if trial.value is None and state is optuna.trial.TrialState.COMPLETE:
        state = optuna.trial.TrialState.FAIL
    frozen = optuna.trial.create_trial(
        state=state,
        value=trial.value if state is optuna.trial.TrialState.COMPLETE else None,
        params=dict(trial.params),
        distributions=dict(known),
        user_attrs={**trial.attributes, "status": trial.status},
    )
    frozen.datetime_start = trial.started or frozen.datetime_start
    frozen.datetime_complete = trial.finished or frozen.datetime_complete
    return frozen
