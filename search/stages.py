"""A study in stages: what a search has found is taken up again, by trainings for novelty and by a polish.

Stages 1 and 2 are those of Yin et al. 2021 (sections 4.1 and 4.2); the polish is their training of each strategy found
to its highest difficulty. A search proposes as it always does. A later stage begins when the stages it comes `after`
are over, groups what they found into distinct strategies, and trains again from the best of them:

    novelty   k trainings from each, rewarded for being unlike every policy known (equation 12)
    polish    each trained on, again and again, until its value stops rising

Like every strategy this is a function of the record, so a study goes on after any crash, and one whose search is
extended later takes up only what is new: a strategy counts as done by its members, not by its name.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from search.distinct import Cluster, distinct
from search.errors import BadHistory
from search.features import Features
from search.given import Given
from search.record import SEARCH, Candidate, Observation
from search.strategy import Strategy


@dataclass(frozen=True, slots=True)
class NoveltyStage:
    """Stage 2: trainings away from what is known.

    Args:
        name: of the stage.
        after: stages whose distinct strategies it starts from.
        strategies: at most so many of them, best first.
        trainings: from each of them (k).
        threshold: d_threshold of equation 12, in the metric's unit.
    """

    name: str
    after: tuple[str, ...]
    strategies: int
    trainings: int
    threshold: float


@dataclass(frozen=True, slots=True)
class PolishStage:
    """Each strategy trained on, until its value stops rising.

    Args:
        name: of the stage.
        after: stages whose distinct strategies it takes up.
        strategies: at most so many of them, best first.
        rounds: at most so many trainings of each, one after the other.
        rise: a training that raises the value by no more than this was the strategy's last.
    """

    name: str
    after: tuple[str, ...]
    strategies: int
    rounds: int
    rise: float


Stage = NoveltyStage | PolishStage


def in_order(after: dict[str, Sequence[str]]) -> list[str]:
    """Names of stages, each behind those it comes after; of equals the alphabetically first comes first.

    Args:
        after: for each stage those it comes after; the search itself is no key.

    Returns:
        The stages that can be ordered: those in a circle, and what comes after them, are missing.
    """
    ordered: list[str] = []
    while True:
        known = {SEARCH, *ordered}
        ready = [name for name in sorted(after) if name not in known and known.issuperset(after[name])]
        if not ready:
            return ordered
        ordered.append(ready[0])


@dataclass(frozen=True, slots=True)
class _Seen:
    """What a stage sees: the record, and who belongs to which stage."""

    history: Sequence[Observation]
    pending: Sequence[Candidate]

    def of(self, stage: str) -> list[int]:
        """Indices of a stage's observations."""
        return [i for i, o in enumerate(self.history) if o.candidate.stage == stage]

    def pending_of(self, stage: str) -> list[Candidate]:
        """A stage's open candidates."""
        return [candidate for candidate in self.pending if candidate.stage == stage]

    def origin(self, candidate: Candidate) -> int | None:
        """The observation of an earlier stage that a candidate's line of policies began from."""
        at = candidate.warm_start
        while at is not None and self.history[at].candidate.stage == candidate.stage:
            at = self.history[at].candidate.warm_start
        return at

    def complete(self, stages: Iterable[str] | None = None) -> list[int]:
        """Indices of complete observations of the real task that came with a behaviour, of some stages or of all."""
        wanted = None if stages is None else set(stages)
        return [
            i
            for i, o in enumerate(self.history)
            if o.status == "complete"
            and o.features is not None
            and o.candidate.z in {None, 1}
            and (wanted is None or o.candidate.stage in wanted)
        ]

    def value(self, i: int) -> float:
        """Of an observation; that of nothing is the lowest."""
        value = self.history[i].value
        return -np.inf if value is None else value


@dataclass(frozen=True)
class Staged:
    """A search and its further stages, as one function of the record.

    Args:
        search: proposes the first stage, which sees nothing of the later ones.
        trials: of the search.
        stages: in an order in which each comes after those it takes up (`in_order`).
        metric: of behaviours.
        apart: behaviours further apart are different strategies, in the metric's unit.
    """

    search: Strategy | Given
    trials: int
    stages: tuple[Stage, ...]
    metric: Features
    apart: float

    def propose(
        self, history: Sequence[Observation], pending: Sequence[Candidate], count: int, rng: np.random.Generator
    ) -> list[Candidate]:
        """What to try next: see `Strategy.propose`. Fewer than `count`, or none, where a stage has to be waited for.

        Raises:
            SearchError: as the search's own strategy does; `BadHistory` for a candidate of an unknown stage.
        """
        seen = _Seen(history, pending)
        self._check(seen)
        found = self._of_search(seen, count, rng)
        over = set() if found or seen.pending_of(SEARCH) else {SEARCH}
        for stage in self.stages:
            if len(found) >= count or not over.issuperset(stage.after):
                continue
            more = self._of_stage(stage, seen)
            if not more and not seen.pending_of(stage.name):
                over.add(stage.name)
            found += more[: count - len(found)]
        return found

    def _check(self, seen: _Seen) -> None:
        known = {SEARCH, *(stage.name for stage in self.stages)}
        for candidate in (*(o.candidate for o in seen.history), *seen.pending):
            if candidate.stage not in known:
                raise BadHistory(f"expected a stage among {', '.join(sorted(known))}, found {candidate.stage!r}")

    def _of_search(self, seen: _Seen, count: int, rng: np.random.Generator) -> list[Candidate]:
        rows = seen.of(SEARCH)
        pending = seen.pending_of(SEARCH)
        room = self.trials - len(rows) - len(pending)
        if room <= 0:
            return []
        place = {row: at for at, row in enumerate(rows)}

        def told(candidate: Candidate) -> Candidate:
            parent = candidate.warm_start
            return candidate if parent is None else replace(candidate, warm_start=place[parent])

        history = [replace(seen.history[row], candidate=told(seen.history[row].candidate)) for row in rows]
        found = self.search.propose(history, [told(each) for each in pending], min(count, room), rng)
        return [each if each.warm_start is None else replace(each, warm_start=rows[each.warm_start]) for each in found]

    def _of_stage(self, stage: Stage, seen: _Seen) -> list[Candidate]:
        """All that a stage could propose now, in order."""
        rows = seen.complete(stage.after)
        clusters = distinct(
            [seen.history[i].features for i in rows], [seen.value(i) for i in rows], self.metric, self.apart
        )
        taken = [
            Cluster(rows[c.representative], tuple(rows[i] for i in c.members)) for c in clusters[: stage.strategies]
        ]
        if isinstance(stage, NoveltyStage):
            return self._novelty(stage, seen, taken)
        return self._polish(stage, seen, taken)

    def _novelty(self, stage: NoveltyStage, seen: _Seen, taken: Sequence[Cluster]) -> list[Candidate]:
        """Round by round: one training from every strategy, then the second, so that each knows the round before."""
        begun = [o.candidate for o in seen.history if o.candidate.stage == stage.name] + seen.pending_of(stage.name)
        done = [sum(candidate.warm_start in cluster.members for candidate in begun) for cluster in taken]
        archive = [seen.history[i].features for i in seen.complete()]
        values = [seen.value(i) for i in seen.complete()]

        def leading(worth: Sequence[float], apart: float) -> list[list[float]]:
            groups = distinct(archive, worth, self.metric, apart)
            return [[float(v) for v in archive[c.representative] or ()] for c in groups]

        # The reward keeps away from every policy; what counts as another strategy is told by those that stand for one.
        away = {"avoid": leading([0.0] * len(archive), 0.0), "strategies": leading(values, self.apart)}
        plan = sorted((k, place) for place in range(len(taken)) for k in range(done[place], stage.trainings))
        return [
            self._again(stage, seen, taken[place].representative, round=k + 1, threshold=stage.threshold, **away)
            for k, place in plan
        ]

    def _polish(self, stage: PolishStage, seen: _Seen, taken: Sequence[Cluster]) -> list[Candidate]:
        """The next training of each strategy that still rises and isn't being trained."""
        found = []
        origins = {i: seen.origin(seen.history[i].candidate) for i in seen.of(stage.name)}
        busy = {seen.origin(candidate) for candidate in seen.pending_of(stage.name)}
        for cluster in taken:
            if busy.intersection(cluster.members):
                continue
            line = [i for i, origin in origins.items() if origin in cluster.members]
            parent = cluster.representative
            if line:
                parent, before = line[-1], seen.history[line[-1]].candidate.warm_start
                rose = before is not None and seen.value(parent) > seen.value(before) + stage.rise
                if not rose or seen.history[parent].status != "complete" or len(line) >= stage.rounds:
                    continue
            found.append(self._again(stage, seen, parent, round=len(line) + 1))
        return found

    @staticmethod
    def _again(stage: Stage, seen: _Seen, parent: int, **info: object) -> Candidate:
        """A training that starts from an observation's policy."""
        mode = "novelty" if isinstance(stage, NoveltyStage) else "polish"
        origin = seen.history[parent].candidate
        return Candidate(dict(origin.params), origin.z, parent, {"mode": mode, **info}, stage.name)
