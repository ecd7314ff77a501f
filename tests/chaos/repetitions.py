"""How much of the work was done again after each fault, from what the trainings themselves noted.

A training that is interrupted begins again in a new *run*, from its newest intact checkpoint. What it repeats was
caused between the last iteration of the run before it and the first of its own, by one of the faults of that time: not
always the newest one. With two trainings at a time the other one works on, and more faults may follow, before the
interrupted one gets its turn.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import NamedTuple

MOST = 1
"""Iterations that one training may repeat after a fault: the one that it was in."""

TORN = 2
"""The same where its newest checkpoint itself is destroyed: the one before it is what is left."""


class Begun(NamedTuple):
    """An iteration that began: of which trial, which one, in which process."""

    trial: int
    iteration: int
    process: str


class Fault(NamedTuple):
    """What happened, when (counted in iterations that had begun), and the trial whose checkpoint it destroyed."""

    kind: str
    at: int
    torn: int | None = None


@dataclass
class Repeated:
    """What faults of one kind cost.

    Args:
        iterations: that had begun before the fault, and began again after it.
        most: the largest number of these of one training after one fault.
        beside: iterations that a training which had been given up did beside its successor, until it was ended.
    """

    iterations: int = 0
    most: int = 0
    beside: int = 0


@dataclass
class Run:
    """One go at a training: a process that takes iteration after iteration of it.

    Args:
        trial: of which trial.
        start: how many iterations had begun before its first.
        last: its newest iteration.
        again: for each iteration that it repeated, when that had begun before.
        beside: iterations that two runs did at the same time.
    """

    trial: int
    start: int
    last: int = 0
    again: list = field(default_factory=list)
    beside: int = 0


def runs(iterations, attempts=()):
    """All runs of all trainings, in order of their start.

    Args:
        iterations: `Begun` of each iteration, in order.
        attempts: by trial, the process of each attempt in order, None where it was never heard of.
    """
    found, at_it, newest, begun, attempts = [], {}, {}, defaultdict(list), dict(attempts)
    for place, (trial, iteration, process) in enumerate(iterations):
        run = at_it.get((trial, process))
        if run is None or iteration != run.last + 1:
            run = at_it[trial, process] = Run(trial, place)
            found.append(run)
            started = {who for what, who in at_it if what == trial and who != process}
            if not _comes_late(process, attempts.get(trial, []), started):
                newest[trial] = run
        run.last = iteration
        holder = newest.setdefault(trial, run)
        before = [when for when in begun[trial, iteration] if when < holder.start]
        if run is holder and before:
            run.again.append(before[-1])
        elif begun[trial, iteration]:
            holder.beside += 1
        begun[trial, iteration].append(place)
    return found


def _comes_late(process, attempts, started):
    """Whether a run belongs to an attempt that had been given up unheard, and whose successor has started before it.

    A host that was cut off gets word of a training when it is back, and works until somebody hears of it.
    """
    if process in attempts:
        return False
    unheard = [number for number, who in enumerate(attempts) if who is None]
    return any(who in started for number, who in enumerate(attempts) if unheard and number > unheard[0])


@dataclass
class Marks:
    """When which fault happened, counted in iterations that had begun."""

    _faults: list = field(default_factory=list)

    def set(self, kind, begun):
        """A fault is about to happen."""
        self._faults.append(Fault(kind, begun))

    def move(self, begun, torn=None):
        """The last one happened only now; it destroyed the newest checkpoint of the trial `torn`."""
        self._faults[-1] = self._faults[-1]._replace(at=begun, torn=torn)

    def take_back(self):
        """It did not happen."""
        self._faults.pop()

    def _cause(self, run):
        """The fault that a run's repetitions are put down to.

        That is the one that destroyed its checkpoint, if there is one, else the first since the last iteration of the
        run before it. A fault is marked when it is about to happen, so that the one before these may be it, too.
        """
        last = max(run.again) + 1 if run.again else run.start
        before = [fault for fault in self._faults if fault.at < last]
        since = [fault for fault in self._faults if last <= fault.at <= run.start]
        torn = [fault for fault in (*before[-1:], *since) if fault.torn == run.trial]
        return (torn or since or before[-1:] or [None])[0]

    def _costs(self, iterations, attempts):
        for run in runs(iterations, attempts):
            cause = self._cause(run)
            if cause is not None:
                yield cause, run

    def count(self, iterations, attempts=()):
        """`Repeated` by kind; see `runs` for what it is given."""
        found = {fault.kind: Repeated() for fault in self._faults}
        for cause, run in self._costs(iterations, attempts):
            row = found[cause.kind]
            row.iterations += len(run.again)
            row.most = max(row.most, len(run.again))
            row.beside += run.beside
        return found

    def judge(self, iterations, verdict, attempts=()):
        """Note where a fault made a training repeat more than it may, and what nobody's fault explains."""
        for run in runs(iterations, attempts):
            cause = self._cause(run)
            if not run.again:
                continue
            if cause is None:
                verdict.expect(False, f"trial {run.trial} repeated {len(run.again)} iterations without any fault")
                continue
            most = TORN if cause.torn == run.trial else MOST
            verdict.expect(
                len(run.again) <= most,
                f"{cause.kind}: trial {run.trial} repeated {len(run.again)} iterations, {most} may be",
            )
