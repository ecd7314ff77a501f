"""How long a study with many finished trials takes to its first dispatch when it is resumed.

    python -m benchmarks.resume [--trials 10000] [--strategies random,bds,cmfbo] [--limit 5]

Such a study is written into a new database as drivers write it, then resumed by the command (`halma resume`, with Ray).
Ray's own start does not count: the time runs from the event with which the driver takes the study (`driven`) to the
one with which it starts the next trial (`started`), and to the training's own first line, which also has its worker's
start in it. In between, the record is read, a strategy process is started and told it, and it proposes.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from services.proposing import trial_seed
from services.spec_check import check
from services.spec_file import read_draft
from services.states import StudyState, TrialState
from services.store.open import open_store
from services.store.port import Driver, NewTrial, Result

ROOT = Path(__file__).resolve().parents[1]
START = "import sys; sys.argv[0] = 'halma'; from services.cli import main; main()"
NAME, BATCH = "resumed", 500
TASK = """
import os, time
from pathlib import Path
from workers.contracts import Cost, FeatureSpec, Outcome, ParameterSpec, TaskInfo


class Training:
    def info(self, settings):
        space = {name: ParameterSpec("float", 0.0, 1.0) for name in ("x", "y", "v", "w")}
        behaviour = FeatureSpec("euclidean", ("a", "b"), 0.1, (0.0, 0.0), (1.0, 1.0))
        return TaskInfo(
            "resume_task:Training", "nothing", parameters=space, features=behaviour, has_difficulty=True, trains=False
        )

    def validate(self, settings, training, names):
        pass

    def run(self, job, context):
        with Path(os.environ["RESUME_NOTES"]).open("a") as notes:
            notes.write(f"{time.time()}\\n")
        return Outcome("complete", job.params["x"], (job.params["x"], job.params["y"]), Cost(100, 0.0))
"""


def command(folder: Path, *words: str) -> subprocess.Popen[str]:
    """The command `halma` in a folder."""
    environment = {
        **os.environ, "PYTHONPATH": str(ROOT), "HALMA_HOME": str(folder / "home"), "RAY_USAGE_STATS_ENABLED": "0",
        "RESUME_NOTES": str(folder / "notes"),
    }  # fmt: skip
    environment.pop("HALMA_DB", None)
    return subprocess.Popen(
        [sys.executable, "-c", START, *words],
        cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip


def fill(folder: Path, strategy: str, trials: int) -> None:
    """A study with so many finished trials, released, which wants ten more."""
    (folder / "resume_task.py").write_text(TASK, encoding="utf-8")
    file = folder / "study.yaml"
    budget = f"cost: {100 * (trials + 10)}" if strategy == "cmfbo" else f"trials: {trials + 10}"
    file.write_text(
        f"name: {NAME}\ntask: resume_task:Training\nsearch: {{strategy: {strategy}, {budget}}}\n"
        "resources: {parallel: 1}\nseed: 1\n",
        encoding="utf-8",
    )
    sys.path.insert(0, str(folder))
    spec = check(read_draft(file, []))
    sys.path.remove(str(folder))
    (folder / "home").mkdir()
    store, rng = open_store(folder / "home" / "halma.db"), np.random.default_rng(1)
    budgets = {"target_cost": spec.search.cost} if spec.search.cost else {"target_trials": spec.search.trials}
    with store.transaction() as change:
        study = change.create_study(NAME, spec.to_json(), seed=1, **budgets).id
        token = change.drive(NAME, Driver("bench", "here", 1))
    for first in range(0, trials, BATCH):
        count = min(BATCH, trials - first)
        points = rng.random((count, 4)).tolist()
        new = [
            NewTrial(dict(zip(("x", "y", "v", "w"), point, strict=True)), seed=trial_seed(1, first + i), z=1.0)
            for i, point in enumerate(points)
        ]
        with store.transaction() as change:
            rows = change.propose(
                study, token, strategy=strategy, history=first, pending=[], rng_key=[1, first], seconds=0.0, trials=new
            )
            for row, (x, y, v, w) in zip(rows, points, strict=True):
                attempt = change.start(row.id, token, worker="default")
                value = x * (1 - x) + np.sin(3 * y) + v * w
                result = Result(TrialState.COMPLETE, value=float(value), features=(x, y), samples=100, seconds=0.1)
                change.finish(attempt.id, attempt.token, result)
    with store.transaction() as change:
        change.release_drive(study, token, StudyState.PAUSED, "interrupted")
    store.close()


def resume(folder: Path, patience: float) -> dict[str, float]:
    """Seconds from taking the study to each event on the way."""
    store = open_store(folder / "home" / "halma.db")
    last = store.last_event()
    process = command(folder, "resume", NAME)
    moments: dict[str, float] = {}
    end = time.monotonic() + patience
    while "started" not in moments or not (folder / "notes").exists():
        if process.poll() is not None or time.monotonic() > end:
            process.kill()
            raise SystemExit(f"no trial was started within {patience:g} s:\n{process.communicate()[0][-3000:]}")
        for event in store.events(after=last, limit=1000):
            last = event.id
            if event.kind in {"driven", "proposed", "started"}:
                moments.setdefault(event.kind, event.at.timestamp())
        time.sleep(0.02)
    moments["training"] = float((folder / "notes").read_text(encoding="ascii").split()[0])
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=120)
    store.close()
    return {kind: at - moments["driven"] for kind, at in moments.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=10_000)
    parser.add_argument("--strategies", default="random,bds,cmfbo")
    parser.add_argument("--limit", type=float, default=5.0, help="seconds to the first dispatch")
    given = parser.parse_args()
    print(f"{given.trials} finished trials; {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}", flush=True)
    for strategy in given.strategies.split(","):
        with tempfile.TemporaryDirectory(prefix="halma-resume-") as place:
            fill(Path(place), strategy, given.trials)
            found = resume(Path(place), 600)
        reached = "reached" if found["started"] < given.limit else "NOT reached"
        print(
            f"{strategy}: proposed after {found['proposed']:.2f} s, dispatched after {found['started']:.2f} s "
            f"(target {given.limit:g}: {reached}), its training began after {found['training']:.2f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
