"""How much of the work was done again after each fault, from what the trainings themselves noted."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

MOST = 1
"""Iterations that one training may repeat after a fault: the one that it was in."""

TORN = 2
"""The same where the newest checkpoint itself is destroyed: the one before it is what is left."""


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
class Marks:
    """When which fault happened, counted in iterations that had begun."""

    _faults: list = field(default_factory=list)

    def set(self, kind, begun):
        """A fault is about to happen."""
        self._faults.append((kind, begun))

    def move(self, begun):
        """The last one happened only now."""
        self._faults[-1] = (self._faults[-1][0], begun)

    def take_back(self):
        """It did not happen."""
        self._faults.pop()

    def count(self, iterations):
        """`Repeated` by kind.

        Args:
            iterations: the trial and iteration of each that began, in order.
        """
        found = {}
        ends = [begun for _, begun in self._faults] + [len(iterations)]
        for (kind, begun), end in zip(self._faults, ends[1:], strict=True):
            row = found.setdefault(kind, Repeated())
            before, again, new = set(iterations[:begun]), Counter(), Counter()
            for step in iterations[begun:end]:
                if step in before:
                    before.discard(step)
                    again[step[0]] += 1
                else:
                    new[step] += 1
            row.iterations += sum(again.values())
            row.most = max(row.most, *again.values(), 0)
            row.beside += sum(count - 1 for count in new.values())
        return found

    def judge(self, iterations, verdict):
        """Note where a fault made a training repeat more than it may."""
        for kind, row in self.count(iterations).items():
            most = TORN if kind.startswith("checkpoint ") else MOST
            verdict.expect(row.most <= most, f"{kind}: a training repeated {row.most} iterations, {most} may be")
