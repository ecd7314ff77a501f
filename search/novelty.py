"""Novelty seeking, stage 2 of Yin et al. 2021: from each good initial state, policies unlike all known ones.

Stage 1 (`bds`) finds initial states that lead to distinct strategies. Stage 2 trains again from each of the best of
them, with a reward for being unlike every policy known so far (equation 12); each such training adds its behaviour to
the archive. What a training needs to know is in `candidate.info`: `avoid`, the behaviours it is to keep away from, and
`round`, which of the k further trainings it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from search.distinct import Cluster, distinct
from search.errors import BadSetting
from search.features import Features
from search.record import Candidate, Observation, Record
from search.settings import setting
from search.space import Array
from search.strategy import Strategy


@dataclass(frozen=True, slots=True)
class Archive:
    """Behaviours found so far.

    Args:
        metric: the feature space.
        features: ``n x D`` behaviours.
        values: ``n``.
    """

    metric: Features
    features: Array
    values: Array
    indices: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    """``n``, where each came from: indices into the history."""

    @classmethod
    def from_history(cls, metric: Features, history: Sequence[Observation]) -> Archive:
        """The behaviours of the complete observations."""
        rows = [i for i, o in enumerate(history) if o.status == "complete" and o.features is not None]
        Y = np.stack([metric.check(history[i].features) for i in rows]) if rows else np.empty((0, metric.d))
        values = np.array([v if (v := history[i].value) is not None else np.nan for i in rows])
        return cls(metric, Y, values, np.array(rows, dtype=np.int64))

    def novelty(self, features: Array) -> Array:
        """Distance of ``m x D`` behaviours to the nearest in the archive, ``m``; infinite where it is empty."""
        if not len(self.features):
            return np.full(len(features), np.inf)
        return np.asarray(self.metric.pairwise(features, self.features).min(axis=1))

    def novelty_reward(self, features: Array, threshold: float) -> Array:
        """Equation 12: clip(distance to the nearest known policy / threshold, 0.01, 1), ``m``; a factor of the reward.

        The floor keeps a reward for learning the task at all.
        """
        return np.clip(self.novelty(features) / threshold, REWARD_FLOOR, 1.0)

    def distinct(self, threshold: float) -> list[Cluster]:
        """Distinct strategies; representatives and members are indices into the history."""
        found = distinct(self.features, self.values, self.metric, threshold)
        return [
            Cluster(int(self.indices[c.representative]), tuple(int(self.indices[i]) for i in c.members)) for c in found
        ]


REWARD_FLOOR = 0.01
"""What is left of the reward for a behaviour that is known already."""


@dataclass(frozen=True, slots=True)
class NoveltySettings:
    """Settings of `novelty`."""

    threshold: float = setting(0.5, "behaviours further apart are different strategies (unit of the metric)", low=1e-9)
    initial: int = setting(5, "how many good initial states", low=1)
    k: int = setting(3, "further trainings for each of them", low=1)
    explore: str = setting("bds", "strategy of stage 1, which runs until its trials are used up")
    trials: int = setting(10, "trials of stage 1", low=1)


class Novelty(Strategy):
    """Stage 1 for a number of trials, then k further trainings from each good initial state.

    Good initial states are those of the representatives of the distinct strategies of stage 1, best first. Trainings go
    round by round: one from every state, then the second from every state, so that each round knows the one before.
    """

    name = "novelty"
    summary = "diversity search, then further trainings from its best states, rewarded for unlike behaviour"
    uses_features = True
    uses_values = True
    Settings = NoveltySettings

    def propose_from(self, record: Record, count: int, rng: np.random.Generator) -> list[Candidate]:
        """Stage 1 or stage 2; fewer than `count`, or none, where all trainings have been proposed."""
        s = self.settings
        known, total = record.n, record.n + len(record.pending)
        if total < s.trials:
            return self._stage_one().propose_from(record, min(count, s.trials - total), rng)
        if known < s.trials:
            return []  # which states are good is known when stage 1 is in
        first = record.first(s.trials)
        rows = np.flatnonzero(first.known & first.complete)
        clusters = distinct(first.features[rows], first.value[rows], self.metric, s.threshold) if len(rows) else []
        states = [int(rows[c.representative]) for c in clusters[: s.initial]]
        plan = [(row, r) for r in range(s.k) for row in states]
        done = total - s.trials
        archive = record.features[record.known & record.complete]
        avoid = [
            archive[c.representative].tolist() for c in distinct(archive, np.zeros(len(archive)), self.metric, 0.0)
        ]
        return [
            Candidate(
                record.params[row],
                None,
                row,
                {"mode": "novelty", "round": r + 1, "avoid": avoid, "threshold": s.threshold},
            )
            for row, r in plan[done : done + count]
        ]

    def _stage_one(self) -> Strategy:
        from search.registry import strategy_class  # noqa: PLC0415  # the registry imports this module

        if self.settings.explore == self.name:
            raise BadSetting(self.name, "explore", "expected another strategy than novelty itself")
        return strategy_class(self.settings.explore)(self.space, self.features, {})
