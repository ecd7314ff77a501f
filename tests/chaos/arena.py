"""Where a study is disturbed: a home and a database of its own, the command on both, and what was seen on the way."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from invariants import Record, Verdict, check, what_counts
from places import FalseClock
from repetitions import Begun

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
START = "import sys; sys.argv[0] = 'halma'; from services.cli import main; main()"
STUDY = """\
name: {name}
task: {{name: "walk:Walk", settings: {{iterations: {iterations}, seconds: {seconds}}}}}
search: {{strategy: {strategy}, trials: {trials}}}
resources: {{parallel: {parallel}}}
retries: {{limit: 100, backoff_seconds: 0}}
seed: {seed}
"""
NAME = "walked"
_numbers = itertools.count(1)


@dataclass(frozen=True)
class Shape:
    """The study that is disturbed."""

    strategy: str = "tpe"
    trials: int = 5
    iterations: int = 4
    seconds: float = 0.0
    parallel: int = 1
    seed: int = 5

    def text(self):
        """As a study file."""
        return STUDY.format(name=NAME, **self.__dict__)


@dataclass
class Arena:
    """One study, its places, and what is on record of it.

    Args:
        folder: for everything.
        shape: the study.
        postgres: a `postgres.Server`, or None for SQLite.
        artifacts: folder of the artifacts, where it isn't the default.
        database: path of the SQLite file, likewise.
        leases: how much shorter than usual leases are.
        notes: folder for what the processes tell the harness; default: the arena's own.
        path: where processes find modules.
        prefix: what the command is run by.
    """

    folder: Path
    shape: Shape
    postgres: object = None
    artifacts: Path | None = None
    database: str | None = None
    leases: float = 1.0
    notes: Path | None = None
    path: tuple = (HERE / "hooks", HERE, ROOT)
    prefix: tuple = ()
    seen: list = field(default_factory=list)

    def __post_init__(self):
        self.folder.mkdir(parents=True, exist_ok=True)
        if self.postgres is not None:
            self.database = self.postgres.new_database(f"chaos{os.getpid()}x{next(_numbers)}")
        elif self.database is None:
            self.database = str(self.folder / "halma.db")
        if self.artifacts is None:
            self.artifacts = self.folder / "walk.artifacts"
        self.file = self.folder / "study.yaml"
        self.file.write_text(self.shape.text(), encoding="utf-8")
        self.output = self.folder / "output"
        self.work, self.plan = ((self.notes or self.folder) / name for name in ("work", "plan.json"))
        self.environment = {
            "HALMA_HOME": str(self.folder / "home"),
            "HALMA_DB": self.database,
            "HALMA_ARTIFACTS": str(self.artifacts),
            "HALMA_CHAOS_PLAN": str(self.plan),
            "HALMA_CHAOS_WORK": str(self.work),
            "HALMA_CHAOS_LEASES": str(self.leases),
            "COLUMNS": "200",
        }

    def false_clock(self):
        """Let every process of this arena see a wall clock that can be made to jump."""
        self.clock = FalseClock(self.folder)
        self.environment |= self.clock.environment

    def intend(self, **plan):
        """Have a fault happen at an exact point; see `hooks/sitecustomize.py`."""
        fresh = self.plan.with_suffix(".new")
        fresh.write_text(json.dumps(plan), encoding="utf-8")
        fresh.replace(self.plan)

    def spare(self):
        """Take back what was intended and has not happened. Returns how many intended faults have happened by now."""
        self.plan.unlink(missing_ok=True)
        with contextlib.suppress(FileNotFoundError):
            return Path(f"{self.plan}.faults").read_bytes().count(b"\n")
        return 0

    def command(self, *arguments, **environment):
        """The command as a process of its own; its output goes to the arena's file."""
        with self.output.open("ab") as output:
            return subprocess.Popen(
                [*self.prefix, sys.executable, "-c", START, *arguments],
                env={**os.environ, **self.environment, "PYTHONPATH": self.python_path(), **environment},
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )

    def python_path(self):
        """Where the command and its workers find modules."""
        return os.pathsep.join(map(str, self.path))

    def record(self):
        """The study as it is on record now; its `study` is None where there is none yet."""
        if "://" not in self.database and not Path(self.database).exists():
            return _nothing()
        try:
            return Record(self.database, NAME)
        except Exception as error:
            if "no such table" in str(error) or "does not exist" in str(error):
                return _nothing()  # killed before the tables were there
            raise

    def look(self):
        """Remember what has finished: it may never change. Returns the record."""
        record = self.record()
        if record.study is not None:
            self.seen.append(record.finished())
        return record

    def judge(self):
        """Check the study, which has come to its end."""
        record = self.record()
        if record.study is None:
            return Verdict(stuck=1, broken=["there is no study"])
        return check(record, self.artifacts, seen=self.seen, work=self.work, samples_each=10)

    def said(self):
        """What the command said so far."""
        return self.output.read_text(encoding="utf-8", errors="replace") if self.output.exists() else ""

    def iterations_begun(self):
        """How many iterations have begun by now, repeated ones included."""
        return len(self.iterations())

    def iterations(self):
        """`Begun` of each iteration, in order."""
        with contextlib.suppress(FileNotFoundError):
            lines = self.work.read_text(encoding="utf-8").splitlines()
            return [Begun(int(trial), int(number), who) for _, trial, number, who in map(str.split, lines)]
        return []


def _nothing():
    record = Record.__new__(Record)
    record.study = None
    return record


def wait_until(condition, seconds, every=0.05):
    """What the condition gives as soon as it gives something; None where it doesn't in time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(every)
    return None


class Undisturbed:
    """What studies come to that nobody disturbs; each shape is run once."""

    def __init__(self, forks, folder):
        self._forks, self._folder, self._known = forks, folder, {}

    def of(self, shape):
        """`what_counts` of the shape, one trial at a time, and the points that its commands pass."""
        key = (shape.strategy, shape.trials, shape.iterations, shape.seed)
        if key not in self._known:
            arena = Arena(self._folder / "-".join(map(str, key)), Shape(*key[:3], seed=key[3]))
            arena.intend(do="count", into=str(arena.folder / "points"))
            pid = self._forks.start("run", str(arena.file), "--inline", output=arena.output, **arena.environment)
            status = self._forks.wait(pid)
            assert status == 0, (status, arena.said())
            points = (arena.folder / "points").read_text(encoding="utf-8").split()
            self._known[key] = (what_counts(arena.record()), points)
        return self._known[key]
