"""Studies without Ray, one trial at a time, killed at exact points. Each run is a forked process (`forks.py`).

Ray is not the subject here: the subject is every commit and every file that appears under its name, and for this the
coordinator and the worker may share a process. `ray_games.py` kills the real processes.
"""

from __future__ import annotations

import os
import signal
import time

from arena import NAME, Arena
from invariants import what_counts
from repetitions import Marks

PATIENCE = 60.0
"""Seconds in which a study that takes half a second must be through."""


class Game:
    """One study, and the faults that it went through.

    Args:
        forks: `forks.Forks`.
        arena: where.
        expected: what the undisturbed study comes to.
        rng: `numpy.random.Generator` of this game.
    """

    def __init__(self, forks, arena: Arena, expected, rng):
        self.forks, self.arena, self.expected, self.rng = forks, arena, expected, rng
        self.faults, self.marks = 0, Marks()

    def run_once(self, during=None):
        """Run or resume the study in a process; its exit status.

        Args:
            during: called with the process id while it runs.
        """
        self.marks.set("", self.arena.iterations_begun())
        exists = self.arena.look().study is not None
        arguments = ("resume", NAME) if exists and self.rng.random() < 0.5 else ("run", str(self.arena.file))
        pid = self.forks.start(*arguments, "--inline", output=self.arena.output, **self.arena.environment)
        if during is not None:
            during(pid)
        status = self.forks.wait(pid, PATIENCE)
        if status is None:
            os.kill(pid, signal.SIGKILL)
            self.forks.wait(pid)
        return status

    def at_point(self, point, when, do, place):
        """One fault at the `place`-th point of a new study, which then goes on undisturbed."""
        self.arena.intend(point=point, when=when, do=do, n=[place])
        self.run_once()
        self.faults = self.arena.spare()
        return self.to_the_end()

    def chain(self, point, when, do, reach):
        """Fault upon fault, each at one of the next `reach` points, until the study has come to its end."""
        for _ in range(400):
            # A process that was killed meets no second fault; one whose connection was cut goes on to the next.
            several = 1 if do == "kill" else 20
            self.arena.intend(point=point, when=when, do=do, n=self.rng.integers(1, reach + 1, several).tolist())
            status = self.run_once()
            self.faults = self.arena.spare()
            if status == 0 and self.over():
                break
        return self.to_the_end()

    def at_any_time(self, hit, longest):
        """`hit(pid)` after a random time of each run, until the study has come to its end."""

        def during(pid):
            time.sleep(float(self.rng.uniform(0, longest)))
            self.faults += hit(pid)

        for _ in range(100):
            if self.run_once(during) == 0 and self.over():
                break
            longest *= 1.1  # on a busy machine a run may not get anywhere in the time it had
        return self.to_the_end()

    def cost(self, kind):
        """What the faults, all of one kind, cost."""
        return dict.fromkeys([kind], self.marks.count(self.arena.iterations(), self.arena.record().processes())[""])

    def over(self):
        """Whether the study has come to its end."""
        study = self.arena.record().study
        return study is not None and study["state"] == "complete"

    def to_the_end(self):
        """Go on undisturbed, and judge."""
        for _ in range(3):
            if self.run_once() == 0:
                break
        verdict = self.arena.judge()
        self.marks.judge(self.arena.iterations(), verdict, self.arena.record().processes())
        verdict.expect(
            what_counts(self.arena.record()) == self.expected, "the study is not what it would have been undisturbed"
        )
        return verdict


def kill(pid):
    """SIGKILL; whether there was somebody to kill."""
    return _signal(pid, signal.SIGKILL)


def freeze(pid, seconds=0.2):
    """Stop a process for a while, and let it go on."""
    if not _signal(pid, signal.SIGSTOP):
        return False
    time.sleep(seconds)
    return _signal(pid, signal.SIGCONT)


def _signal(pid, number):
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return False
    return True
