"""Optuna's samplers as strategies: the record becomes a study in memory, which is asked once for each candidate."""

from __future__ import annotations

import math
import warnings
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.samplers import BaseSampler, GPSampler, TPESampler
from optuna.trial import FrozenTrial, TrialState, create_trial

from search.quality.budget import CostModel, spent
from search.record import Candidate, Record
from search.settings import setting
from search.space import Angle, Array, Categorical, Float, Int, Space
from search.strategy import Strategy
from search.surrogate.threads import one_torch_thread


def distributions(space: Space) -> dict[str, BaseDistribution]:
    """A space in Optuna's words. Optuna knows no circles: an angle is an interval there."""
    out: dict[str, BaseDistribution] = {}
    for name, p in space.parameters.items():
        if isinstance(p, Float):
            out[name] = FloatDistribution(float(p.low), float(p.high), log=p.log)
        elif isinstance(p, Int):
            out[name] = IntDistribution(int(p.low), int(p.high), log=p.log)
        elif isinstance(p, Categorical):
            out[name] = CategoricalDistribution(p.choices)
        elif isinstance(p, Angle):
            out[name] = FloatDistribution(-math.pi, math.pi)
    return out


@contextmanager
def quietly() -> Iterator[None]:
    """Optuna without its announcements; its level of speech is put back afterwards."""
    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            yield
    finally:
        optuna.logging.set_verbosity(before)


def ask(space: Space, sampler: BaseSampler, trials: list[FrozenTrial], count: int) -> Array:
    """What a sampler proposes after these trials, ``count x d``; each proposal is running for the next."""
    kinds = distributions(space)
    with quietly(), one_torch_thread():
        study = optuna.create_study(direction="maximize", sampler=sampler, study_name="halma")
        study.add_trials(trials)
        return np.stack([space.to_unit(study.ask(kinds).params) for _ in range(count)])


def frozen(space: Space, unit: Array, state: TrialState, value: float | None = None, **more: Any) -> FrozenTrial:
    """A trial of the record in Optuna's words."""
    return create_trial(
        state=state, params=space.from_unit(unit), distributions=distributions(space), value=value, **more
    )


def trials_of(space: Space, record: Record) -> list[FrozenTrial]:
    """The whole record as trials: failures failed, pending ones running."""
    out = []
    for u, value, complete in zip(record.X, record.value, record.complete, strict=True):
        state = TrialState.COMPLETE if complete else TrialState.FAIL
        out.append(frozen(space, u, state, float(value) if complete else None))
    return out + [frozen(space, u, TrialState.RUNNING) for u in record.pending]


class OptunaStrategy(Strategy):
    """Any Optuna sampler as a strategy. A subclass says which."""

    uses_values = True

    @abstractmethod
    def sampler(self, seed: int) -> BaseSampler:
        """A fresh sampler. It must take what it knows from the study's trials."""

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:
        """Ask the sampler."""
        found = ask(self.space, self.sampler(int(rng.integers(2**31))), trials_of(self.space, record), count)
        return [self.candidate(u, mode=self.name) for u in found]


class SampledBy(OptunaStrategy):
    """A strategy around a sampler of your own: ``SampledBy(space, lambda seed: MySampler(seed=seed))``.

    Args:
        space: what to search over.
        factory: makes a sampler from a seed.
    """

    name = "sampled_by"
    summary = "any Optuna sampler"

    def __init__(self, space: Space, factory: Any) -> None:
        super().__init__(space)
        self._factory = factory

    def sampler(self, seed: int) -> BaseSampler:
        """What the factory makes."""
        made: BaseSampler = self._factory(seed)
        return made


@dataclass(frozen=True, slots=True)
class StartSettings:
    """Settings of `tpe` and `gp`."""

    start: int = setting(10, "random trials before the model decides (Optuna's default)", low=0)


class TPE(OptunaStrategy):
    """Optuna's tree-structured Parzen estimator."""

    name = "tpe"
    summary = "Optuna's tree-structured Parzen estimator"
    Settings = StartSettings

    def sampler(self, seed: int) -> BaseSampler:
        """With a constant liar, so that parallel trials don't repeat each other."""
        with quietly():
            return TPESampler(seed=seed, n_startup_trials=self.settings.start, constant_liar=True)


class OptunaGP(OptunaStrategy):
    """Optuna's Gaussian-process sampler."""

    name = "gp"
    summary = "Optuna's Gaussian-process sampler"
    Settings = StartSettings

    def sampler(self, seed: int) -> BaseSampler:
        """With its start-up trials."""
        with quietly():
            return GPSampler(seed=seed, n_startup_trials=self.settings.start)


@dataclass(frozen=True, slots=True)
class HyperbandSettings:
    """Settings of `tpe_hyperband`."""

    cost_budget: float | None = setting(None, "total cost, in the unit of the observations' costs", low=0)
    eta: int = setting(3, "one of so many goes on to the next difficulty", low=2)
    rungs: int = setting(3, "number of difficulties: 1, 1/eta, 1/eta^2, ...", low=1)
    start: int = setting(10, "random trials of a bracket before the model decides", low=0)


class TPEHyperband(Strategy):
    """Optuna's TPE with Hyperband, the difficulty being the resource.

    As in Optuna: bracket s starts at rung s; a trial that finishes a rung goes on if it is among the best 1/eta of what
    its bracket has seen at that rung, and is pruned otherwise; TPE learns from its own bracket, pruned trials included.
    Going on is a candidate of its own at the next difficulty, which starts from the policy of the rung before.
    """

    name = "tpe_hyperband"
    summary = "Optuna's TPE with Hyperband over the difficulty"
    uses_values = True
    uses_z = True
    Settings = HyperbandSettings

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:
        """Promotions first, then new trials; fewer where the budget is used up."""
        s = self.settings
        levels = [float(s.eta) ** (i + 1 - s.rungs) for i in range(s.rungs)]
        costs = CostModel(record)
        paid, budget = spent(record, costs), math.inf if s.cost_budget is None else s.cost_budget
        chains: dict[bytes, list[int]] = {}
        for i, u in enumerate(record.X):
            chains.setdefault(u.tobytes(), []).append(i)
        running = {u.tobytes(): float(z) for u, z in zip(record.pending, record.pending_z, strict=True)}
        bracket = {key: self._rung(levels, float(record.z[rows].min())) for key, rows in chains.items()}
        for key, z in running.items():
            bracket.setdefault(key, self._rung(levels, z))
        ready = self._promotions(record, levels, chains, bracket, running)
        found: list[Candidate] = []
        while len(found) < count and paid + 0.5 * costs.at(levels[0]) <= budget:
            if ready:
                row, z = ready.pop(0)
                found.append(Candidate(record.params[row], z, row, {"mode": "promote"}))
            else:
                # brackets that start low hold more trials: weights as in Hyperband, eta^s / (s + 1)
                weight = np.array([s.eta ** (s.rungs - 1 - b) * s.rungs / (s.rungs - b) for b in range(s.rungs)])
                b = int(rng.choice(s.rungs, p=weight / weight.sum()))
                z = levels[b]
                u = self._new(record, chains, bracket, running, b, levels, rng)
                found.append(Candidate(self.space.from_unit(u), z, None, {"mode": "tpe", "bracket": b}))
            paid += costs.at(z)
        return found

    @staticmethod
    def _rung(levels: list[float], z: float) -> int:
        return int(np.argmin(np.abs(np.array(levels) - z)))

    def _promotions(
        self,
        record: Record,
        levels: list[float],
        chains: dict[bytes, list[int]],
        bracket: dict[bytes, int],
        running: dict[bytes, float],
    ) -> list[tuple[int, float]]:
        """Observations that go on, with the difficulty they go on to, in the order of finishing."""
        rung = [self._rung(levels, float(z)) for z in record.z]
        out = []
        for key, rows in chains.items():
            last = rows[-1]
            if key in running or rung[last] == len(levels) - 1 or not record.complete[last]:
                continue
            # what the bracket had seen at this rung when the trial reported
            seen = [
                record.value[i]
                for i in range(last + 1)
                if rung[i] == rung[last] and record.complete[i] and bracket[record.X[i].tobytes()] == bracket[key]
            ]
            best = sorted(seen, reverse=True)[: max(1, len(seen) // self.settings.eta)]
            if record.value[last] >= best[-1]:
                out.append((last, levels[rung[last] + 1]))
        return sorted(out)

    def _new(
        self,
        record: Record,
        chains: dict[bytes, list[int]],
        bracket: dict[bytes, int],
        running: dict[bytes, float],
        b: int,
        levels: list[float],
        rng: np.random.Generator,
    ) -> Array:
        """A new point from TPE on the trials of one bracket."""
        trials = []
        for key, rows in chains.items():
            if bracket[key] != b:
                continue
            good = [i for i in rows if record.complete[i]]
            steps = {self._rung(levels, float(record.z[i])) + 1: float(record.value[i]) for i in good}
            u = record.X[rows[0]]
            if key in running:
                trials.append(frozen(self.space, u, TrialState.RUNNING, intermediate_values=steps))
            elif not good:
                trials.append(frozen(self.space, u, TrialState.FAIL))
            elif len(levels) in steps:
                trials.append(frozen(self.space, u, TrialState.COMPLETE, steps[len(levels)], intermediate_values=steps))
            else:
                trials.append(frozen(self.space, u, TrialState.PRUNED, intermediate_values=steps))
        seen = set(chains)
        trials += [
            frozen(self.space, u, TrialState.RUNNING)
            for u in record.pending
            if u.tobytes() not in seen and bracket[u.tobytes()] == b
        ]
        with quietly():
            sampler = TPESampler(
                seed=int(rng.integers(2**31)), n_startup_trials=self.settings.start, constant_liar=True
            )
        return np.asarray(ask(self.space, sampler, trials, 1)[0])
