"""Trial life cycles a second: the trial database beside Optuna's `RDBStorage`, both on SQLite, both fully durable.

A life cycle is propose, start, report, complete, each made durable before the next begins. Three ways of ours:

- `one by one`: one trial at a time, four commits each, as a driver with a single worker makes them;
- `grouped by 8`: eight trials at a time, each of the four steps of all eight in one commit, as a driver makes them
  that has eight workers and writes what arrived together;
- `all in one`: the four steps of a trial in one commit, which tells the statements' share from the commits'.

Optuna's cycle has the same content: create a trial, five parameters, one intermediate value, tell. Its commits are
made durable, too (`PRAGMA synchronous = FULL`), in its own rollback journal and in WAL mode. `a durable commit`
is the floor: one row into one table with the same settings. Nothing is random here, so there are no seeds.
On a machine that does other things at the same time, look at the CPU time: it changes less.

    python benchmarks/storage.py [--cycles 400] [--repeats 5] [--folder FOLDER]
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import sqlite3
import statistics
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import optuna
import sqlalchemy
from optuna.distributions import FloatDistribution
from optuna.storages import RDBStorage
from optuna.study import StudyDirection
from optuna.trial import TrialState as OptunaState

from services.states import TrialState
from services.store.open import open_store
from services.store.port import Driver, NewArtifact, NewTrial, Result, Store

PARAMETERS = {f"x{i}": 0.1 * i for i in range(5)}
DIGEST = "0" * 64
TARGET = 500.0
"""Life cycles a second that the project set out to reach."""


@dataclass
class Spent:
    """Seconds by the clock and of CPU, since it was made."""

    wall: float = field(default_factory=time.perf_counter)
    cpu: float = field(default_factory=time.process_time)

    def stop(self) -> Spent:
        """What was spent since."""
        return Spent(time.perf_counter() - self.wall, time.process_time() - self.cpu)


def propose(store: Store, study: int, token: int, count: int) -> list[int]:
    with store.transaction() as change:
        made = change.propose(
            study,
            token,
            strategy="random",
            history=0,
            pending=[],
            rng_key=[1, 2, 3],
            seconds=0.001,
            trials=[NewTrial(PARAMETERS, seed=i) for i in range(count)],
        )
    return [trial.id for trial in made]


RESULT = Result(
    TrialState.COMPLETE,
    value=0.5,
    features=(0.25, 0.75),
    samples=1000,
    seconds=1.5,
    artifacts=[NewArtifact("policy.safetensors", "1-bench/000001/policy.safetensors", DIGEST, 1000)],
)
METRICS = {"return": 0.25, "loss": 0.125}


def grouped(folder: Path, cycles: int, group: int) -> Spent:
    """What is spent on `cycles` life cycles, `group` of them at a time."""
    store = open_store(folder / "halma.db")
    with store.transaction() as change:
        study = change.create_study("bench", {}, seed=1).id
        token = change.drive("bench", Driver("bench", "here", 1))
    spent = Spent()
    for _ in range(cycles // group):
        trials = propose(store, study, token, group)
        with store.transaction() as change:
            attempts = [change.start(trial, token, worker="w") for trial in trials]
        with store.transaction() as change:
            for attempt in attempts:
                change.report(attempt.id, attempt.token, iteration=1, metrics=METRICS, samples=500, seconds=0.5)
        with store.transaction() as change:
            for attempt in attempts:
                change.finish(attempt.id, attempt.token, RESULT)
    spent = spent.stop()
    assert store.study("bench").counts == {"complete": cycles // group * group}
    store.close()
    return spent


def all_in_one(folder: Path, cycles: int) -> Spent:
    """What is spent on `cycles` life cycles of one commit each."""
    store = open_store(folder / "halma.db")
    with store.transaction() as change:
        study = change.create_study("bench", {}, seed=1).id
        token = change.drive("bench", Driver("bench", "here", 1))
    spent = Spent()
    for _ in range(cycles):
        with store.transaction() as change:
            (trial,) = change.propose(
                study,
                token,
                strategy="random",
                history=0,
                pending=[],
                rng_key=[1, 2, 3],
                seconds=0.001,
                trials=[NewTrial(PARAMETERS, seed=1)],
            )
            attempt = change.start(trial.id, token, worker="w")
            change.report(attempt.id, attempt.token, iteration=1, metrics=METRICS, samples=500, seconds=0.5)
            change.finish(attempt.id, attempt.token, RESULT)
    spent = spent.stop()
    store.close()
    return spent


def durable_commits(folder: Path, commits: int) -> Spent:
    """What is spent on `commits` durable commits of one small row each, without any layer between."""
    connection = sqlite3.connect(folder / "floor.db", isolation_level=None)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("CREATE TABLE t (id INTEGER PRIMARY KEY, text TEXT)")
    spent = Spent()
    for _ in range(commits):
        connection.execute("BEGIN IMMEDIATE")
        connection.execute("INSERT INTO t (text) VALUES (?)", ("x" * 100,))
        connection.execute("COMMIT")
    spent = spent.stop()
    connection.close()
    return spent


def optuna_storage(folder: Path, cycles: int, journal: str) -> Spent:
    """What is spent on `cycles` life cycles in Optuna's storage."""
    storage = RDBStorage(f"sqlite:///{folder / 'optuna.db'}", engine_kwargs={"connect_args": {"timeout": 30}})

    def prepare(connection: sqlite3.Connection, _record: object) -> None:
        connection.execute(f"PRAGMA journal_mode = {journal}")
        connection.execute("PRAGMA synchronous = FULL")

    sqlalchemy.event.listen(storage.engine, "connect", prepare)
    storage.engine.dispose()
    study = storage.create_new_study([StudyDirection.MAXIMIZE], "bench")
    spent = Spent()
    for _ in range(cycles):
        trial = storage.create_new_trial(study)
        for name, value in PARAMETERS.items():
            storage.set_trial_param(trial, name, value, FloatDistribution(0.0, 1.0))
        storage.set_trial_intermediate_value(trial, 1, 0.25)
        storage.set_trial_state_values(trial, OptunaState.COMPLETE, [0.5])
    spent = spent.stop()
    assert storage.get_n_trials(study) == cycles
    storage.engine.dispose()
    return spent


def rates(measure: Callable[[Path], Spent], count: int, repeats: int, parent: Path) -> tuple[list[float], float]:
    """What is done a second, each time in an empty folder, and the CPU time that one takes, in microseconds."""
    found, cpu = [], []
    for _ in range(repeats):
        folder = Path(tempfile.mkdtemp(dir=parent))
        spent = measure(folder)
        found.append(count / spent.wall)
        cpu.append(spent.cpu / count * 1e6)
        shutil.rmtree(folder)
    return found, statistics.median(cpu)


def show(name: str, measured: tuple[list[float], float], note: str = "") -> None:
    found, cpu = measured
    print(f"{name:<34}{statistics.median(found):>9.0f}{min(found):>9.0f}{max(found):>9.0f}{cpu:>9.0f}  {note}")


def machine() -> str:
    model = next(
        (line.split(":")[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line),
        platform.processor(),
    )
    return (
        f"{os.cpu_count()} x {model}, load {os.getloadavg()[0]:.1f}; Python {platform.python_version()}, "
        f"SQLite {sqlite3.sqlite_version}, SQLAlchemy {sqlalchemy.__version__}, Optuna {optuna.__version__}"
    )


def main() -> None:
    arguments = argparse.ArgumentParser(description="Trial life cycles a second.")
    arguments.add_argument("--cycles", type=int, default=400, help="life cycles in each measurement")
    arguments.add_argument("--repeats", type=int, default=5)
    arguments.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()), help="where the databases lie")
    given = arguments.parse_args()
    cycles, repeats = given.cycles, given.repeats
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    warnings.filterwarnings("ignore", category=optuna.exceptions.ExperimentalWarning)

    print(machine())
    print(f"{cycles} life cycles a measurement, {repeats} measurements, synchronous = FULL everywhere\n")
    print(f"{'a second':<34}{'median':>9}{'lowest':>9}{'highest':>9}{'us CPU':>9}")
    with tempfile.TemporaryDirectory(prefix="halma-bench-", dir=given.folder) as name:
        parent = Path(name)
        show(
            "a durable commit (SQLite alone)",
            rates(lambda f: durable_commits(f, 4 * cycles), 4 * cycles, repeats, parent),
        )
        eight = rates(lambda f: grouped(f, cycles, 8), cycles // 8 * 8, repeats, parent)
        show("halma, grouped by 8", eight, "4 commits for 8 trials")
        one = rates(lambda f: grouped(f, cycles, 1), cycles, repeats, parent)
        show("halma, one by one", one, "4 commits a trial")
        show("halma, all in one", rates(lambda f: all_in_one(f, cycles), cycles, repeats, parent), "1 commit a trial")
        few = max(10, cycles // 10)
        peers = {}
        for journal in ("DELETE", "WAL"):
            peers[journal] = rates(lambda f, j=journal: optuna_storage(f, few, j), few, repeats, parent)  # type: ignore[misc]
            show(f"Optuna RDBStorage, {journal}", peers[journal], f"{few} cycles")
    ours, theirs = statistics.median(eight[0]), max(statistics.median(found) for found, _ in peers.values())
    verdict = "reached" if ours >= TARGET else "NOT reached"
    print(
        f"\ngrouped by 8: {ours:.0f} life cycles a second, target {TARGET:.0f}: {verdict}; Optuna at best {theirs:.0f}"
    )


if __name__ == "__main__":
    main()
