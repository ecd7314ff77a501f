"""Candidates, observations, and the record of a study as arrays."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from search.errors import BadFeatures, BadHistory, BadParams
from search.features import Features
from search.space import Array, Scalar, Space

Status = Literal["complete", "infeasible", "diverged", "failed"]

LARGEST = 1e100
"""Values further from 0 are learnt from as if they were this far: their squares have to be numbers."""

SEARCH = "search"
"""The stage of a study that has no others, and the first one of a study that has."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """What to try.

    Args:
        params: in natural units, by name.
        z: difficulty in [0, 1] (1 is the real task), or None where the search has no fidelity.
        warm_start: index in the history of the observation whose policy to start from, or None.
        info: why it was proposed, as JSON: `mode`, acquisition values, `warnings`. No proposal depends on it; trainings
            for novelty do, on `avoid` and `threshold`.
        stage: the stage of the study that proposed it (`search.stages`).
    """

    params: Mapping[str, Scalar]
    z: float | None = None
    warm_start: int | None = None
    info: Mapping[str, Any] = field(default_factory=dict)
    stage: str = SEARCH


def with_warnings(candidates: Sequence[Candidate], told: Sequence[str]) -> list[Candidate]:
    """The candidates, with what went wrong on the way to them in `info["warnings"]`, if anything did."""
    if not told:
        return list(candidates)
    return [replace(c, info={**c.info, "warnings": [*c.info.get("warnings", ()), *told]}) for c in candidates]


@dataclass(frozen=True, slots=True)
class Observation:
    """A candidate with what came of it.

    Args:
        candidate: what was tried.
        value: the objective, to be maximised; None only where the status is not `complete`, or nothing is valued.
        features: the behaviour, in the coordinates of the study's `Features`; None likewise.
        cost: at least 0, in any one unit that does not depend on the machine's mood, e.g. simulation samples.
        status: `complete`, `infeasible`, `diverged` or `failed`.
    """

    candidate: Candidate
    value: float | None = None
    features: Sequence[float] | None = None
    cost: float = 0.0
    status: Status = "complete"


@dataclass(frozen=True, slots=True)
class Record:
    """History and pending trials as arrays. ``n`` observations, ``m`` pending, ``d`` parameters, ``D`` features.

    Args:
        X: ``n x d`` unit coordinates.
        value: ``n``, within `LARGEST` of 0, NaN where unknown.
        features: ``n x D``, NaN rows where unknown.
        complete: ``n``, whether the status is `complete`.
        z: ``n``, 1 where the candidate had no difficulty.
        cost: ``n``.
        pending: ``m x d`` unit coordinates.
        pending_z: ``m``.
        params: of the observations as they came: asking for the same point again means asking with the same numbers.
    """

    X: Array
    value: Array
    features: Array
    complete: NDArray[np.bool_]
    z: Array
    cost: Array
    pending: Array
    pending_z: Array
    params: tuple[Mapping[str, Scalar], ...]

    @property
    def n(self) -> int:
        """Number of observations."""
        return len(self.X)

    def first(self, n: int) -> Record:
        """The record as it was after `n` observations, with nothing pending."""
        return Record(
            self.X[:n],
            self.value[:n],
            self.features[:n],
            self.complete[:n],
            self.z[:n],
            self.cost[:n],
            self.pending[:0],
            self.pending_z[:0],
            self.params[:n],
        )

    def only(self, rows: NDArray[np.bool_]) -> Record:
        """The record of some of the observations, pending trials kept."""
        return Record(
            self.X[rows],
            self.value[rows],
            self.features[rows],
            self.complete[rows],
            self.z[rows],
            self.cost[rows],
            self.pending,
            self.pending_z,
            tuple(p for p, kept in zip(self.params, rows, strict=True) if kept),
        )

    def digest(self, n: int) -> bytes:
        """Digest of all that the first `n` observations say; fitted models are kept under it."""
        digest = hashlib.blake2b(digest_size=16)
        for array in (self.X, self.value, self.features, self.complete, self.z, self.cost):
            digest.update(np.ascontiguousarray(array[:n]).tobytes())
        return digest.digest()

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which observations came with a behaviour, ``n``."""
        if not self.features.shape[1]:
            return np.zeros(self.n, dtype=bool)
        return np.asarray(~np.isnan(self.features).any(axis=1))

    @property
    def asked(self) -> Array:
        """All points ever asked for, ``(n + m) x d``."""
        return np.concatenate([self.X, self.pending])


def _difficulty(candidate: Candidate, where: str) -> float:
    z = candidate.z
    if z is None:
        return 1.0
    if isinstance(z, bool) or not isinstance(z, (int, float, np.floating)) or not 0 <= z <= 1:
        raise BadHistory(f"{where}: expected a difficulty z in [0, 1], found {z!r}")
    return float(z)


def _unit(space: Space, candidate: Candidate, where: str) -> Array:
    if not isinstance(candidate, Candidate):
        raise BadHistory(f"{where}: expected a Candidate, found {candidate!r}")
    try:
        return space.to_unit(candidate.params)
    except BadParams as error:
        raise BadHistory(f"{where}: {error}") from None


def _finite(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise BadHistory(f"{what}: expected a number, found {value!r}")
    if not math.isfinite(value):
        raise BadHistory(f"{what}: expected a finite number, found {value!r}; report such a trial as diverged")
    return float(value)


def _outcome(
    o: Observation, where: str, features: Features | None, *, needs_value: bool, needs_features: bool
) -> tuple[float, Array | None, float]:
    """Value, features and cost of one observation, checked."""
    if o.status not in get_args(Status):
        raise BadHistory(f"{where}: expected a status among {', '.join(get_args(Status))}, found {o.status!r}")
    if o.status == "complete" and needs_value and o.value is None:
        raise BadHistory(f"{where}: expected a value for a complete trial, found None")
    if o.status == "complete" and needs_features and o.features is None:
        raise BadHistory(f"{where}: expected features for a complete trial, found None")
    value = math.nan if o.value is None else max(-LARGEST, min(LARGEST, _finite(o.value, f"{where}: value")))
    cost = _finite(o.cost, f"{where}: cost")
    if cost < 0:
        raise BadHistory(f"{where}: expected a cost of at least 0, found {cost!r}")
    if features is None or o.features is None:
        return value, None, cost
    try:
        return value, features.check(o.features), cost
    except BadFeatures as error:
        raise BadHistory(f"{where}: {error}") from None


def read_record(
    space: Space,
    features: Features | None,
    history: Sequence[Observation],
    pending: Sequence[Candidate],
    *,
    needs_value: bool = False,
    needs_features: bool = False,
) -> Record:
    """Check a history and its pending candidates, and lay them out as arrays.

    Args:
        space: what the parameters must belong to.
        features: what the behaviours must belong to; None ignores them.
        history: in the order of finishing.
        pending: proposed and not finished.
        needs_value: refuse complete observations without a value.
        needs_features: refuse complete observations without a behaviour.

    Raises:
        BadHistory: naming the index, what was expected and what was found.
    """
    n, D = len(history), 0 if features is None else features.d
    X, value, z, cost = np.empty((n, space.d)), np.empty(n), np.empty(n), np.empty(n)
    Y = np.full((n, D), np.nan)
    complete = np.zeros(n, dtype=bool)
    for i, o in enumerate(history):
        where = f"history[{i}]"
        if not isinstance(o, Observation):
            raise BadHistory(f"{where}: expected an Observation, found {o!r}")
        X[i] = _unit(space, o.candidate, where)
        z[i] = _difficulty(o.candidate, where)
        value[i], y, cost[i] = _outcome(o, where, features, needs_value=needs_value, needs_features=needs_features)
        if y is not None:
            Y[i] = y
        complete[i] = o.status == "complete"
    P, pz = np.empty((len(pending), space.d)), np.empty(len(pending))
    for j, candidate in enumerate(pending):
        P[j] = _unit(space, candidate, f"pending[{j}]")
        pz[j] = _difficulty(candidate, f"pending[{j}]")
    return Record(X, value, Y, complete, z, cost, P, pz, tuple(o.candidate.params for o in history))
