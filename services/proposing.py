"""Asking the search: what a proposal sees, what it gives, and who computes it.

A strategy is a function of the record. `Proposer` holds the strategy of one study and the record as far as it has
been told, so that a long history travels once; whoever asks says from which position on it tells, and a proposer
that is missing something says so. `services.ray_adapters` puts a proposer into an actor of its own.
"""

from __future__ import annotations

import json
import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from search import Candidate, Observation, SearchError
from search.record import SEARCH
from services.store.port import JSON, TrialRow
from services.translate import build_strategy

PROPOSE = zlib.crc32(b"propose")


def trial_seed(study_seed: int, number: int) -> int:
    """Seed of a trial: unsigned 64-bit, from `SeedSequence(study seed, trial number)`."""
    return int(np.random.SeedSequence((study_seed, number)).generate_state(1, np.uint64)[0])


def proposal_key(study_seed: int, first_number: int) -> tuple[int, ...]:
    """Entropy of a proposal's generator: the study's seed, the first trial it will name, the purpose."""
    return (study_seed, first_number, PROPOSE)


@dataclass(frozen=True, slots=True)
class ProposalRequest:
    """What a proposal sees.

    Args:
        study: row id of the study.
        start: history position of the first of `observations`; what is before has been told.
        history: length of the whole history, so that the proposer can notice what it is missing.
        observations: `observation_json` of finished trials, in order of position.
        pending: `candidate_json` of open trials, by number.
        count: how many candidates are wanted.
        rng_key: entropy of the generator.
        target_cost: samples that the study may spend now, for strategies that plan them; it may have been extended.
        target_trials: trials of the search now, after which further stages begin; likewise.
    """

    study: int
    start: int
    history: int
    observations: Sequence[Mapping[str, JSON]]
    pending: Sequence[Mapping[str, JSON]]
    count: int
    rng_key: tuple[int, ...]
    target_cost: float | None = None
    target_trials: int | None = None


@dataclass(frozen=True, slots=True)
class Proposed:
    """What a proposal gave.

    Args:
        study: row id of the study.
        candidates: `params`, `z`, `warm_start` (a trial number), `info` and `stage` of each; none where the search is
            done, or waits for open trials.
        seconds: how long it took.
        missing_from: where set, nothing was proposed: tell the history again from this position.
        error: where set, nothing was proposed: the sentence for the record.
    """

    study: int
    candidates: Sequence[Mapping[str, Any]] = ()
    seconds: float = 0.0
    missing_from: int | None = None
    error: str = ""


def candidate_json(trial: TrialRow) -> dict[str, JSON]:
    """A trial as the search's candidate, in JSON."""
    return {
        "number": trial.number,
        "params": dict(trial.params),
        "z": trial.z,
        "warm_start": trial.warm_start,
        "stage": trial.stage,
    }


def observation_json(trial: TrialRow) -> dict[str, JSON]:
    """A finished trial as the search's observation, in JSON. Cost is in samples: seconds differ between runs."""
    return {
        **candidate_json(trial),
        "status": trial.state.value,
        "value": trial.value,
        "features": None if trial.features is None else list(trial.features),
        "cost": float(trial.samples),
    }


@dataclass
class Proposer:
    """The strategy of one study and the part of the record it has been told.

    Args:
        spec: the study's frozen spec, JSON.
    """

    spec: Mapping[str, JSON]
    _history: list[Observation] = field(default_factory=list)
    _numbers: list[int] = field(default_factory=list)
    _index: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        search = self.spec.get("search", {})
        self._planned = (search.get("cost"), search.get("trials"))
        self._strategy = build_strategy(self.spec)

    def _plan_for(self, target_cost: float | None, target_trials: int | None = None) -> None:
        """A study that was extended has more to plan with; its strategy is made anew, and remembers nothing anyway."""
        cost, trials = self._planned
        planned = (cost if target_cost is None else target_cost, trials if target_trials is None else target_trials)
        # How many trials there are is the coordinator's affair, unless stages follow them.
        if planned == self._planned or (planned[0] == cost and not self.spec.get("stages")):
            return
        search = {**self.spec["search"], "cost": planned[0], "trials": planned[1]}
        self._strategy = build_strategy({**self.spec, "search": search})
        self._planned = planned

    def propose(self, request: ProposalRequest) -> Proposed:
        """Propose, or say what is missing, or why it could not."""
        if request.start > len(self._history):
            return Proposed(request.study, missing_from=len(self._history))
        # What is told again replaces what was known: a record is append-only, so both are the same.
        del self._history[request.start :]
        del self._numbers[request.start :]
        for observation in request.observations:
            self._index[observation["number"]] = len(self._numbers)
            self._numbers.append(observation["number"])
            self._history.append(self._observation(observation))
        if len(self._history) != request.history:
            return Proposed(request.study, missing_from=0)
        self._plan_for(request.target_cost, request.target_trials)
        began = time.perf_counter()
        rng = np.random.default_rng(np.random.SeedSequence(request.rng_key))
        pending = [self._candidate(each) for each in request.pending]
        try:
            candidates = self._strategy.propose(self._history, pending, request.count, rng)
        except SearchError as error:
            return Proposed(request.study, error=f"{type(error).__name__}: {error}")
        return Proposed(
            request.study,
            candidates=[self._told(candidate) for candidate in candidates],
            seconds=time.perf_counter() - began,
        )

    def _candidate(self, values: Mapping[str, JSON]) -> Candidate:
        parent = values["warm_start"]
        return Candidate(
            params=dict(values["params"]),
            z=values["z"],
            warm_start=None if parent is None else self._index.get(parent),
            stage=values["stage"],
        )

    def _observation(self, values: Mapping[str, JSON]) -> Observation:
        return Observation(
            self._candidate(values),
            value=values["value"],
            features=values["features"],
            cost=values["cost"],
            status=values["status"],
        )

    def _told(self, candidate: Candidate) -> dict[str, Any]:
        # A task that learns nothing leaves no policy to start from, so there is no lineage to keep either; but a later
        # stage tells by it which strategies it has taken up.
        kept = self.spec.get("trains", True) or candidate.stage != SEARCH
        parent = candidate.warm_start if kept else None
        return {
            "params": dict(candidate.params),
            "z": candidate.z,
            "warm_start": None if parent is None else self._numbers[parent],
            "info": dict(candidate.info),
            "stage": candidate.stage,
        }


class Strategist(Protocol):
    """Computes proposals. Asking never blocks on an adapter with processes; answers come back through `answers`."""

    def open(self, study: int, spec: Mapping[str, JSON]) -> None:
        """Make the study's strategy ready."""

    def ask(self, request: ProposalRequest) -> None:
        """Ask for one proposal. At most one is under way for each study."""

    def answers(self) -> list[Proposed]:
        """The proposals that are ready, each once."""

    def close(self, study: int) -> None:
        """Let go of a study's strategy."""


class InlineStrategist:
    """The `Strategist` in the caller's own thread."""

    def __init__(self) -> None:
        self._proposers: dict[int, Proposer] = {}
        self._ready: list[Proposed] = []

    def open(self, study: int, spec: Mapping[str, JSON]) -> None:
        self._proposers[study] = Proposer(spec)

    def ask(self, request: ProposalRequest) -> None:
        self._ready.append(self._proposers[request.study].propose(request))

    def answers(self) -> list[Proposed]:
        ready, self._ready = self._ready, []
        return ready

    def close(self, study: int) -> None:
        self._proposers.pop(study, None)


def encode_request(request: ProposalRequest) -> str:
    """The request as JSON text."""
    return json.dumps({name: getattr(request, name) for name in request.__dataclass_fields__})


def decode_request(text: str) -> ProposalRequest:
    """The request that `encode_request` wrote."""
    values = json.loads(text)
    values["rng_key"] = tuple(values["rng_key"])
    return ProposalRequest(**values)


def encode_proposed(proposed: Proposed) -> str:
    """The answer as JSON text."""
    return json.dumps({name: getattr(proposed, name) for name in proposed.__dataclass_fields__})


def decode_proposed(text: str) -> Proposed:
    """The answer that `encode_proposed` wrote."""
    return Proposed(**json.loads(text))
