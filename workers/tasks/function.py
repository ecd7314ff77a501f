"""A plain Python function as a task: ``f(params, z) -> value, features``. Nothing is trained.

    def hill(params, z):
        return -(params["x"] - 0.3) ** 2, [params["x"]]

    task:
      name: my_module:hill
      settings: {features: {kind: euclidean, names: [x], low: [0], high: [1], distinct: 0.1}}

The function may return a value alone, ``value, features``, or ``value, features, cost`` (in samples, rounded up). It
may take `z` (then the task has a difficulty), `rng` (a `numpy.random.Generator` of its own for each trial), and `avoid`
(in a stage that is to find something new, the behaviours ``n x D`` that are known; None in any other).
"""

from __future__ import annotations

import inspect
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from workers.contracts import JSON, BadJob, BadSetting, Context, Cost, Job, Outcome, TaskInfo, WorkerError
from workers.novelty import Novelty
from workers.tasks.features import WrongFeatures, declared_features, read_behaviour
from workers.user_code import suggestion, user_traceback, where

_SETTINGS = ("features",)


class Infeasible(WorkerError):
    """For functions to raise where a candidate makes no sense; the search learns from it. The message says why."""


class _WrongResult(Exception):
    """The function returned something that is no result."""


@dataclass(frozen=True, slots=True)
class _Signature:
    takes_z: bool
    takes_rng: bool
    takes_avoid: bool = False


class FunctionTask:
    """The task that a function makes.

    Args:
        name: as the study file writes it.
        function: called with the parameters as a dict, and `z` and `rng` where it takes them.
    """

    def __init__(self, name: str, function: Callable[..., Any]) -> None:
        self.name, self.function = name, function
        self._signature = _read_signature(name, function)

    def info(self, settings: Mapping[str, JSON]) -> TaskInfo:
        """The function's first docstring line, and the features that the settings declare."""
        for key in settings:
            if key not in _SETTINGS:
                raise BadSetting("task.settings", key, f"unknown setting of a function{suggestion(key, _SETTINGS)}")
        summary = (inspect.getdoc(self.function) or "a function").splitlines()[0]
        return TaskInfo(
            self.name,
            summary,
            features=declared_features(settings),
            has_difficulty=self._signature.takes_z,
            trains=False,
            seeks_novelty=self._signature.takes_avoid,
            settings={"features": settings.get("features")},
        )

    def validate(self, settings: Mapping[str, JSON], training: Mapping[str, JSON], names: Sequence[str]) -> None:
        """Any parameter names will do, but there must be some, and no training settings."""
        self.info(settings)
        for key in training:
            raise BadSetting("training", key, "expected none: a function is not trained")
        if not names:
            raise BadSetting("space", "", "expected at least one parameter: a function has no space of its own")

    def run(self, job: Job, context: Context) -> Outcome:
        """Call it. An exception in it fails the trial, with the user's traceback in log and details."""
        spec = declared_features(job.task_settings)
        arguments: dict[str, Any] = {"rng": job.rng("function")} if self._signature.takes_rng else {}
        if self._signature.takes_avoid:
            away = None if spec is None else Novelty.of(job, spec)
            arguments["avoid"] = None if away is None else away.avoid
        positional = (dict(job.params), job.z) if self._signature.takes_z else (dict(job.params),)
        started = time.perf_counter()
        try:
            result = self.function(*positional, **arguments)
        except Infeasible as error:
            return Outcome("infeasible", cost=Cost(1, time.perf_counter() - started), message=str(error))
        except WorkerError:
            raise
        except Exception as error:  # noqa: BLE001 - the user's code may raise anything, and it is told to the user
            trace = user_traceback(error)
            context.log(trace)
            cost = Cost(1, time.perf_counter() - started)
            return Outcome("failed", cost=cost, message=where(error), details={"traceback": trace})
        seconds = time.perf_counter() - started
        try:
            value, behaviour, samples = _read_result(result)
            features = read_behaviour(spec, behaviour)
        except (_WrongResult, WrongFeatures) as error:
            raise BadJob(f"task {self.name!r}: {error}") from None
        cost = Cost(samples, seconds)
        numbers = [("value", value)] + [("features", f) for f in features or ()]
        for quantity, number in numbers:
            if not math.isfinite(number):
                became = "NaN" if math.isnan(number) else "infinite"
                return Outcome("diverged", cost=cost, message=f"{quantity} became {became}")
        context.report(1, {"value": value}, cost)
        return Outcome("complete", value, features, cost)


def _read_signature(name: str, function: Callable[..., Any]) -> _Signature:
    try:
        parameters = inspect.signature(function).parameters
    except (TypeError, ValueError):
        return _Signature(takes_z=True, takes_rng=False)  # a compiled function that doesn't say
    positional = [
        p.name
        for p in parameters.values()
        if p.kind in {p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD, p.VAR_POSITIONAL} and p.name not in {"rng", "avoid"}
    ]
    if not positional:
        raise BadJob(f"task {name!r}: expected a function f(params, z), found one without arguments")
    return _Signature(len(positional) > 1, takes_rng="rng" in parameters, takes_avoid="avoid" in parameters)


def _read_result(result: Any) -> tuple[float, Any, int]:
    """Value, behaviour and samples. Raises `_WrongResult`."""
    parts = result if isinstance(result, tuple) else (result,)
    if not 1 <= len(parts) <= 3:
        raise _WrongResult(f"expected value, features and cost at most, found {len(parts)} values")
    value = parts[0]
    behaviour = parts[1] if len(parts) > 1 else None
    samples = parts[2] if len(parts) > 2 else None
    if not _is_real(value):
        raise _WrongResult(f"expected a number as value, found {value!r}")
    if samples is None:
        samples = 1
    if not _is_real(samples) or not math.isfinite(samples) or samples < 0:
        raise _WrongResult(f"expected a number of at least 0 as cost, found {samples!r}")
    return float(value), behaviour, math.ceil(samples)


def _is_real(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and np.issubdtype(value.dtype, np.number) and not np.iscomplexobj(value)
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
