"""`bds` and `cmfbo` as Optuna samplers.

    study = optuna.create_study(direction="maximize", sampler=CMFBOSampler(seed=0))
    study.optimize(objective, n_trials=50)

A diversity search needs to know how a trial behaved: the objective says so with
``trial.set_user_attr("features", [...])``. A study with one objective is maximised or minimised as it says. Parameters
suggested conditionally, and ranges that change between trials, are sampled independently and uniformly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.samplers import BaseSampler, RandomSampler
from optuna.search_space import IntersectionSearchSpace
from optuna.study import Study, StudyDirection
from optuna.trial import FrozenTrial, TrialState

from search.errors import BadFeatures, SearchError
from search.features import Features
from search.record import Candidate, Observation
from search.registry import make_strategy
from search.space import Categorical, Float, Int, Parameter, Space

FEATURES = "features"
"""The user attribute that holds a trial's behaviour."""


def _parameter(distribution: BaseDistribution) -> Parameter | None:
    """A distribution as a parameter; None where it has a single value."""
    found: Parameter | None = None
    if distribution.single():
        return found
    if isinstance(distribution, CategoricalDistribution):
        # choices may be anything, None included: they are known by their index
        found = Categorical(tuple(range(len(distribution.choices))))
    elif isinstance(distribution, FloatDistribution):
        low, high, step = distribution.low, distribution.high, distribution.step
        found = Float(low, high, distribution.log) if step is None else Int(0, round((high - low) / step))
    elif isinstance(distribution, IntDistribution):
        low, high, step = distribution.low, distribution.high, distribution.step
        found = Int(low, high, distribution.log) if step == 1 else Int(0, (high - low) // step)
    return found


def _to_ours(distribution: BaseDistribution, value: Any) -> Any:
    if isinstance(distribution, CategoricalDistribution):
        return int(distribution.to_internal_repr(value))
    if isinstance(distribution, (FloatDistribution, IntDistribution)) and distribution.step not in {None, 1}:
        return round((value - distribution.low) / distribution.step)
    return value


def _to_theirs(distribution: BaseDistribution, value: Any) -> Any:
    if isinstance(distribution, CategoricalDistribution):
        return distribution.choices[int(value)]
    if isinstance(distribution, FloatDistribution) and distribution.step is not None:
        return float(min(distribution.low + value * distribution.step, distribution.high))
    if isinstance(distribution, IntDistribution) and distribution.step != 1:
        return int(distribution.low + value * distribution.step)
    return value


class StrategySampler(BaseSampler):
    """A strategy of ours as an Optuna sampler.

    Args:
        strategy: its name.
        features: what a behaviour is; None where it plays no part.
        settings: of the strategy.
        seed: of all randomness; None takes a fresh one.
    """

    def __init__(
        self,
        strategy: str,
        *,
        features: Features | None = None,
        settings: Mapping[str, Any] | None = None,
        seed: int | None = None,
    ) -> None:
        self._strategy = strategy
        self._features = features
        self._settings = dict(settings or {})
        self._rng = np.random.default_rng(seed)
        self._independent = RandomSampler(seed=int(self._rng.integers(2**31)))
        self._intersection = IntersectionSearchSpace()

    def reseed_rng(self) -> None:
        """Fresh randomness, e.g. in a process forked from another one."""
        self._rng = np.random.default_rng()
        self._independent.reseed_rng()

    def infer_relative_search_space(self, study: Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:  # noqa: ARG002  # Optuna's signature
        """The parameters that all finished trials share, as long as their ranges stay the same."""
        found = self._intersection.calculate(study)
        return {name: d for name, d in found.items() if _parameter(d) is not None}

    def sample_relative(
        self, study: Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """One candidate of the strategy.

        Raises:
            ValueError: the study has several objectives.
            SearchError: a trial that can't be learnt from; nothing more to propose, since a budget is used up.
        """
        self._refuse_many_objectives(study)
        if not search_space:
            return {}
        parameters = {name: p for name, d in search_space.items() if (p := _parameter(d)) is not None}
        made = make_strategy(self._strategy, Space(parameters), features=self._features, settings=self._settings)
        history, pending = [], []
        for t in study.get_trials(deepcopy=False):
            if t.number == trial.number or any(name not in t.params for name in search_space):
                continue
            candidate = self._candidate(t, search_space)
            if t.state.is_finished():
                history.append(self._observation(study, t, candidate))
            else:
                pending.append(candidate)
        found = made.propose(history, pending, 1, self._rng)
        if not found:
            raise SearchError(
                f"{self._strategy}: expected something more to propose after {len(history)} trials, found its budget "
                "used up; raise it, or give study.optimize fewer trials"
            )
        return {name: _to_theirs(d, found[0].params[name]) for name, d in search_space.items()}

    def _refuse_many_objectives(self, study: Study) -> None:
        if len(study.directions) > 1:
            # ValueError, not an error of our tree: it is what Optuna promises its users
            raise ValueError(
                f"expected a study with one objective, found {len(study.directions)}: the sampler of "
                f"{self._strategy!r} does not support multi-objective optimization"
            )

    @staticmethod
    def _candidate(t: FrozenTrial, search_space: Mapping[str, BaseDistribution]) -> Candidate:
        return Candidate({name: _to_ours(d, t.params[name]) for name, d in search_space.items()})

    def _observation(self, study: Study, t: FrozenTrial, candidate: Candidate) -> Observation:
        value = t.value if t.state == TrialState.COMPLETE else None
        if value is None or not math.isfinite(value):
            return Observation(candidate, status="failed")
        if study.direction == StudyDirection.MINIMIZE:
            value = -value
        features = t.user_attrs.get(FEATURES)
        if self._features is not None and features is None:
            raise BadFeatures(
                f"trial {t.number}: expected its behaviour in the user attribute {FEATURES!r}, found none; "
                f"call trial.set_user_attr({FEATURES!r}, [...]) in the objective"
            )
        return Observation(candidate, value=value, features=features, cost=1.0)

    def sample_independent(
        self, study: Study, trial: FrozenTrial, param_name: str, param_distribution: BaseDistribution
    ) -> Any:
        """Uniform."""
        self._refuse_many_objectives(study)
        return self._independent.sample_independent(study, trial, param_name, param_distribution)


class CMFBOSampler(StrategySampler):
    """`cmfbo` as an Optuna sampler. Optuna's trials have no difficulty, so all are asked at z = 1.

    Args:
        settings: of `cmfbo`.
        seed: of all randomness.
    """

    def __init__(self, *, settings: Mapping[str, Any] | None = None, seed: int | None = None) -> None:
        # with start_z = 1 and nothing below it to learn, every proposal is one of the real task
        super().__init__("cmfbo", settings={"start_z": 1.0, "share": 1.0, "easy": 0.0, **(settings or {})}, seed=seed)


class BDSSampler(StrategySampler):
    """`bds` as an Optuna sampler: what should behave unlike everything known.

    Args:
        features: what a behaviour is. None takes the objective's value itself, scaled by nothing, as the behaviour.
        settings: of `bds`.
        seed: of all randomness.
    """

    def __init__(
        self, features: Features | None = None, *, settings: Mapping[str, Any] | None = None, seed: int | None = None
    ) -> None:
        self._by_value = features is None
        super().__init__(
            "bds", features=features or Features.euclidean(1, low=-1, high=1), settings=settings, seed=seed
        )

    def _observation(self, study: Study, t: FrozenTrial, candidate: Candidate) -> Observation:
        if self._by_value and t.state == TrialState.COMPLETE and t.value is not None and math.isfinite(t.value):
            return Observation(candidate, value=t.value, features=[t.value], cost=1.0)
        return super()._observation(study, t, candidate)
