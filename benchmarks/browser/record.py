"""A study of many trials, without chance: what the pages are measured on."""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path

from services.artifacts.port import ArtifactStore
from services.states import TrialState
from services.store.port import AttemptRow, Driver, NewTrial, Result, Store, TrialRow

GOLDEN = 0.618033988749
COPIES = """
WITH RECURSIVE next(number) AS (SELECT 1 UNION ALL SELECT number + 1 FROM next WHERE number < :last)
INSERT INTO trials ({columns}) SELECT {values} FROM trials, next WHERE trials.study_id = :study AND trials.number = 0
"""


class Writer:
    """A driver of a study, with trials whose values and behaviours spread without chance.

    Args:
        store: the trial database.
        artifacts: where files go.
        name: of the study.
    """

    def __init__(self, store: Store, artifacts: ArtifactStore, name: str) -> None:
        self.store = store
        self.artifacts = artifacts
        self.name = name
        spec = {
            "name": name,
            "task": {"name": "high_jump", "settings": {}},
            "search": {"strategy": "bds", "trials": 10**6, "settings": {}, "cost": None},
            "space": {f"x{i}": {"type": "float", "low": 0.0, "high": 1.0, "log": False} for i in range(4)},
            "behaviour": {"kind": "circle", "names": ["facing"], "distinct": 0.5, "low": [], "high": [], "unit": "rad"},
            "units": {},
            "has_difficulty": False,
            "trains": True,
        }
        with store.transaction() as change:
            self.id = change.create_study(name, spec, seed=1, target_trials=10**6).id
            self.token = change.drive(name, Driver("benchmark", "here", os.getpid()))
        self.count = 0

    def begin(self, count: int) -> list[tuple[TrialRow, AttemptRow]]:
        """Propose and start so many, in one commit."""
        with self.store.transaction() as change:
            made = [
                NewTrial({f"x{i}": (self.count + k) * (i + 1) * GOLDEN % 1 for i in range(4)}, seed=self.count + k)
                for k in range(count)
            ]
            rows = change.propose(
                self.id, self.token, strategy="bds", history=0, pending=(), rng_key=(1,), seconds=0.1, trials=made
            )
            self.count += count
            return [(row, change.start(row.id, self.token, worker="w", host="here")) for row in rows]

    def end(self, begun: list[tuple[TrialRow, AttemptRow]], files: dict[str, bytes] | None = None) -> None:
        """Finish them, in one commit."""
        number = begun[0][0].number
        left = [
            self.artifacts.put(f"{self.id}-{self.name}", number, name, data) for name, data in (files or {}).items()
        ]
        with self.store.transaction() as change:
            for row, attempt in begun:
                facing = (row.number * 2.4 % 6.283) - 3.1415
                value = row.number * 0.381966 % 1
                result = Result(TrialState.COMPLETE, value, (facing,), samples=7000, seconds=30.0, artifacts=left)
                change.finish(attempt.id, attempt.token, result)

    def fill(self, count: int) -> None:
        """Bring the study to so many trials, each by its own transitions."""
        while self.count < count:
            self.end(self.begin(min(500, count - self.count)))


def multiply(database: Path, study: int, count: int) -> None:
    """Make so many trials out of a study's first one by one statement: 50,000 transitions would take minutes."""
    changed = {
        "number": "next.number",
        "position": "next.number",
        "value": f"(next.number * {GOLDEN}) - CAST(next.number * {GOLDEN} AS INTEGER)",
    }
    with sqlite3.connect(database) as connection:
        columns = [row[1] for row in connection.execute("PRAGMA table_info(trials)") if row[1] != "id"]
        values = [changed.get(column, f"trials.{column}") for column in columns]
        statement = COPIES.format(columns=", ".join(columns), values=", ".join(values))
        connection.execute(statement, {"last": count - 1, "study": study})
        connection.execute("UPDATE studies SET trial_count = ? WHERE id = ?", (count, study))
    connection.close()


def motion() -> bytes:
    """A second of recorded motion, untrained."""
    from workers.physics.world import World  # noqa: PLC0415  (physics, for this figure only)
    from workers.replay import Recorder  # noqa: PLC0415

    world = World()
    world.athlete.place([-0.8, 1.35, 0.0], [0.0, 0.0, 0.0, 1.0])
    world.athlete.push([2.6, 1.6, 0.0], [0.0, 1.0, -1.0])
    recorder = Recorder("right_ankle", {"name": "high_jump"})
    recorder.start(world)
    for _ in range(120):
        recorder.add(world, world.advance())
    world.close()
    return recorder.replay().to_bytes()
