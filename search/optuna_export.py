"""A record as an Optuna study, in a database that Optuna and its dashboard open."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import optuna
from optuna.storages._rdb import models

from search.errors import SearchError
from search.space import Angle, Categorical, Int, Space

_STATES: Mapping[str, optuna.trial.TrialState] = {
    "complete": optuna.trial.TrialState.COMPLETE,
    "infeasible": optuna.trial.TrialState.PRUNED,
    "diverged": optuna.trial.TrialState.FAIL,
    "failed": optuna.trial.TrialState.FAIL,
    "cancelled": optuna.trial.TrialState.FAIL,
    "running": optuna.trial.TrialState.RUNNING,
    "queued": optuna.trial.TrialState.WAITING,
}
"""Optuna knows no infeasible trial; pruned comes closest: it is learnt from, but is no candidate for the best."""


class ExportRefused(SearchError):
    """The record can't become an Optuna study there."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One trial.

    Args:
        params: in natural units.
        status: how it ended, or `running`, `queued`, `cancelled`.
        value: the objective; None where it has none.
        started, finished: for Optuna's timelines; times with a zone, or None.
        attributes: JSON, kept as user attributes: number, features, cost.
        intermediate: values of one metric by step.
    """

    params: Mapping[str, Any]
    status: str
    value: float | None
    started: datetime | None
    finished: datetime | None
    attributes: Mapping[str, Any]
    intermediate: Mapping[int, float] = field(default_factory=dict)


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


AT_A_TIME = 1000
"""Trials that are written by one statement."""


class _Quick(sqlite3.Connection):
    """A connection to a file that nobody reads before it is whole: a power cut may take it, so it waits for no disk."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.execute("PRAGMA synchronous = OFF")


def export(
    name: str, space: Space, trials: Sequence[Trial], storage: str, attributes: Mapping[str, Any] | None = None
) -> int:
    """Write an Optuna study that maximises.

    Args:
        name: of the study in the storage.
        space: what was searched over.
        trials: in the order of their numbers, or of finishing; Optuna numbers them as they come. A complete one
            without a value counts as failed: Optuna keeps none.
        storage: URL of an Optuna storage, e.g. `sqlite:///path`.
        attributes: JSON, kept as user attributes of the study.

    Returns:
        How many trials were written.

    Raises:
        ExportRefused: the storage has a study of that name, or can't be written.
    """
    verbosity = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    quick = {"connect_args": {"factory": _Quick}} if storage.startswith("sqlite:") else None
    opened = optuna.storages.RDBStorage(storage, engine_kwargs=quick)
    try:
        study = optuna.create_study(study_name=name, storage=opened, direction="maximize")
        for key, value in (attributes or {}).items():
            study.set_user_attr(key, value)
        known = distributions(space)
        with opened.engine.begin() as connection:
            for start in range(0, len(trials), AT_A_TIME):
                frozen = [_frozen(trial, known) for trial in trials[start : start + AT_A_TIME]]
                _insert(connection, study._study_id, start, frozen)
    except optuna.exceptions.DuplicatedStudyError:
        raise ExportRefused(f"expected no Optuna study {name} in {storage}, found one; give another file") from None
    except optuna.exceptions.StorageInternalError as error:
        raise ExportRefused(f"expected an Optuna storage that can be written, found {storage}: {error}") from None
    finally:
        opened.remove_session()
        opened.engine.dispose()
        optuna.logging.set_verbosity(verbosity)
    return len(trials)


def _insert(connection: Any, study: int, start: int, trials: Sequence[optuna.trial.FrozenTrial]) -> None:
    """Write trials as `Study.add_trials` would, in one statement a table.

    `add_trials` reads each trial back for every attribute, parameter and value that it sets, and counts all trials
    before it: 37 ms a trial. What stands in each column is Optuna's own business, so its own tables, converters and
    distributions are used, and a test compares every cell with what `add_trials` writes.

    Args:
        connection: to the storage, in a transaction.
        study: its id there.
        start: number of the first one; the study has all before it.
        trials: validated.
    """
    numbered = list(enumerate(trials, start))
    made = connection.execute(
        models.TrialModel.__table__.insert().returning(models.TrialModel.trial_id, sort_by_parameter_order=True),
        [
            {
                "number": number,
                "study_id": study,
                "state": trial.state,
                "datetime_start": _utc(trial.datetime_start),
                "datetime_complete": _utc(trial.datetime_complete),
            }
            for number, trial in numbered
        ],
    )
    ids = list(made.scalars())
    rows: dict[Any, list[dict[str, Any]]] = {
        models.TrialValueModel: [],
        models.TrialParamModel: [],
        models.TrialUserAttributeModel: [],
        models.TrialIntermediateValueModel: [],
    }
    for id_, trial in zip(ids, trials, strict=True):
        if trial.value is not None:
            value, kind = models.TrialValueModel.value_to_stored_repr(trial.value)
            rows[models.TrialValueModel].append({"trial_id": id_, "objective": 0, "value": value, "value_type": kind})
        for name, given in trial.params.items():
            distribution = trial.distributions[name]
            rows[models.TrialParamModel].append(
                {
                    "trial_id": id_,
                    "param_name": name,
                    "param_value": distribution.to_internal_repr(given),
                    "distribution_json": optuna.distributions.distribution_to_json(distribution),
                }
            )
        for key, attribute in trial.user_attrs.items():
            rows[models.TrialUserAttributeModel].append(
                {"trial_id": id_, "key": key, "value_json": json.dumps(attribute)}
            )
        for step, reported in trial.intermediate_values.items():
            seen, sort = models.TrialIntermediateValueModel.intermediate_value_to_stored_repr(reported)
            rows[models.TrialIntermediateValueModel].append(
                {"trial_id": id_, "step": step, "intermediate_value": seen, "intermediate_value_type": sort}
            )
    for model, each in rows.items():
        if each:
            connection.execute(model.__table__.insert(), each)


def _utc(at: datetime | None) -> datetime | None:
    """A local time without a zone as the storage keeps it: in UTC, without a zone."""
    return None if at is None else at.astimezone(UTC).replace(tzinfo=None)


def _frozen(trial: Trial, known: Mapping[str, optuna.distributions.BaseDistribution]) -> optuna.trial.FrozenTrial:
    state = _STATES[trial.status]
    if trial.value is None and state is optuna.trial.TrialState.COMPLETE:
        state = optuna.trial.TrialState.FAIL
    frozen = optuna.trial.create_trial(
        state=state,
        value=trial.value if state is optuna.trial.TrialState.COMPLETE else None,
        params=dict(trial.params),
        distributions=dict(known),
        intermediate_values=dict(trial.intermediate),
        user_attrs={**trial.attributes, "status": trial.status},
    )
    # Optuna's times are local and have no zone. One that never began, such as a cancelled one, began when it ended.
    begin = _local(trial.started or trial.finished)
    frozen.datetime_start = None if state is optuna.trial.TrialState.WAITING else begin or frozen.datetime_start
    if state.is_finished():
        frozen.datetime_complete = _local(trial.finished or trial.started) or frozen.datetime_complete
    return frozen


def _local(at: datetime | None) -> datetime | None:
    return None if at is None else at.astimezone().replace(tzinfo=None)
