"""Studies as people run them, with Ray and all their processes, disturbed while they run.

One start of Ray serves many faults: worker, strategy and coordinator processes are replaced by the product itself;
after faults that take the driver or Ray along, the study is resumed in a new process, as a person would.
"""

from __future__ import annotations

import signal
from collections import Counter

from arena import NAME, Arena, wait_until
from invariants import what_counts
from processes import alive, family
from ray_faults import KINDS, PATIENCE, Stuck, command_line, send
from repetitions import Marks


class RayGame:
    """One study, and the faults that it goes through.

    Args:
        arena: where; with leases a tenth as long as usual.
        rng: `numpy.random.Generator` of this game.
        expected: what the undisturbed study comes to, where one trial runs at a time.
        say: told each fault.
    """

    def __init__(self, arena: Arena, rng, expected=None, say=lambda _: None):
        self.arena, self.rng, self.expected, self.say = arena, rng, expected, say
        self.process = None
        self.faults, self.marks, self.starts = Counter(), Marks(), 0
        self._left = set()

    # -- running ---------------------------------------------------------------------------------------------------

    def play(self, kinds, enough, had=()):
        """Disturb the study by these kinds until `enough` faults have been or it has ended; judge.

        Args:
            kinds: of faults, names of `KINDS` or functions of one's own by name.
            enough: how many faults.
            had: how often each kind was tried before; the rarest comes next, ties by lot.
        """
        kinds = kinds if isinstance(kinds, dict) else {kind: KINDS[kind] for kind in kinds}
        tried = Counter(had)
        try:
            while sum(self.faults.values()) < enough and not self.over():
                self._running()
                if self.wait_for_work(1 + int(self.rng.integers(0, 3))):
                    kind = min(kinds, key=lambda kind: (tried[kind], self.rng.random()))
                    tried[kind] += 1
                    self._one(kind, kinds[kind])
            return self.to_the_end()
        finally:
            self.clear_away()

    def _one(self, kind, fault):
        self.arena.look()
        self.marks.set(kind, self.arena.iterations_begun())
        if not fault(self):
            self.marks.take_back()
            return
        self.faults[kind] += 1
        self.say(f"{kind} ({sum(self.faults.values())})")
        if not self.over():
            self._running()
            if not self.wait_for_work(2) and not self.over():
                raise Stuck(f"no iteration began within {PATIENCE:g} s of: {kind}\n{self.arena.said()[-3000:]}")

    def to_the_end(self):
        """Let the study come to its end, and judge it."""
        for _ in range(6):
            if self.over():
                break
            self._running()
            if wait_until(lambda: self.process.poll() is not None, 240) is None:
                raise Stuck(f"the study did not end\n{self.arena.said()[-3000:]}")
        wait_until(lambda: self.process is None or self.process.poll() is not None, 60)
        verdict = self.arena.judge()
        self.marks.judge(self.arena.iterations(), verdict, self.arena.record().processes())
        if self.expected is not None:
            same = what_counts(self.arena.record()) == self.expected
            verdict.expect(same, "the study is not what it would have been undisturbed")
        return verdict

    def over(self):
        """Whether the study has come to its end."""
        study = self.arena.record().study
        return study is not None and study["state"] == "complete"

    def _running(self):
        """See to it that somebody drives the study."""
        if self.process is not None and self.process.poll() is None:
            return
        if self.over():
            return
        self.clear_away()
        exists = self.arena.record().study is not None
        self.process = self.start_command(*(("resume", NAME) if exists else ("run", str(self.arena.file))))
        self.starts += 1

    def start_command(self, *words):
        """The command that drives the study."""
        return self.arena.command(*words)

    def wait_for_work(self, more):
        """Whether so many more iterations have begun, before the patience or the study was at its end."""
        had = self.arena.iterations_begun()

        def moved():
            if self.process.poll() is not None and not self.over():
                self._running()
            return self.arena.iterations_begun() >= had + more or self.over()

        return bool(wait_until(moved, PATIENCE)) and not self.over()

    def clear_away(self):
        """End what a killed command has left; a machine that lost its driver would be restarted."""
        if self.process is not None:
            self._left |= set(family(self.process.pid))
            self.process.poll()
        for pid in alive(self._left):
            send(pid, signal.SIGKILL)
        wait_until(lambda: not alive(self._left), 20)
        self._left = set()
        if self.process is not None:
            self.process.wait(timeout=20)

    # -- whom it hits ----------------------------------------------------------------------------------------------

    def processes(self, title):
        """Process ids of this study's processes by (a part of) their command line."""
        self._left |= set(family(self.process.pid))
        return [pid for pid in family(self.process.pid) if title in command_line(pid)]

    def one_of(self, title):
        """One of them, or None."""
        found = self.processes(title)
        return None if not found else int(self.rng.choice(found))
