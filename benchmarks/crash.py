"""What a killed driver costs: halma beside Ray Tune and Optuna, the same trainings, killed at the same random times.

    python benchmarks/crash.py [--kills 3] [--trials 24] [--seconds 0.5] [--seed 1] [--peers halma,optuna,tune]

A training is `ITERATIONS` steps of `seconds / ITERATIONS`, with a checkpoint after each where the library keeps one.
Two run at a time. The driver and all that it started are killed with SIGKILL, then the run is resumed as the library's
manual says, so many times, then left to end. Every step and every end is also noted by the training itself, in a file
that no library knows of; from it come

- lost: trainings that had come to their end before a kill and whose result the library doesn't have at the end;
- repeated: trainings that came to their end more often than once;
- vanished: trainings that began and that the library has no result of at the end, or fewer trials than were asked for;
- steps repeated: steps that were computed more often than once;
- ended by itself: how often the driver ended with an error that nobody had caused, and was started again.
"""

# ruff: noqa: PLC0415 - each library is imported only where it is driven
from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
ITERATIONS = 5
PARALLEL = 2


def note(kind: str, trial: object, step: int = 0) -> None:
    """One line for what really happened, in one write."""
    descriptor = os.open(os.environ["CRASH_WORK"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(descriptor, f"{kind} {trial} {step}\n".encode())
    os.close(descriptor)


def steps(trial: object, first: int, keep: Callable[[int], object]) -> None:
    """A training from its step `first` on; `keep(step)` is called after each."""
    for step in range(first, ITERATIONS + 1):
        note("step", trial, step)
        time.sleep(float(os.environ["CRASH_SECONDS"]) / ITERATIONS)
        keep(step)


# -- halma -----------------------------------------------------------------------------------------------------------

TASK = """
import os, sys, time
sys.path.append({benchmarks!r})
import numpy as np
from crash import ITERATIONS, note, steps
from workers.contracts import Checkpoint, Cost, Outcome, ParameterSpec, TaskInfo


class Training:
    def info(self, settings):
        space = {{"x": ParameterSpec("float", 0.0, 1.0)}}
        return TaskInfo("crash_task:Training", "steps", parameters=space, trains=False)

    def validate(self, settings, training, names):
        pass

    def run(self, job, context):
        found = context.load_checkpoint()

        def keep(step):
            context.report(step, {{"x": job.params["x"]}}, Cost(step, 0.0))
            context.save_checkpoint(Checkpoint(step, {{"x": np.zeros(1)}}, {{}}))

        steps(job.trial, found.iteration + 1 if found else 1, keep)
        note("end", job.trial)
        return Outcome("complete", job.params["x"], None, Cost(ITERATIONS, 0.0))
"""


def drive_halma(folder: Path, trials: int) -> int:
    """`halma run`, or `halma resume` where there is a study."""
    (folder / "crash_task.py").write_text(TASK.format(benchmarks=str(ROOT / "benchmarks")), encoding="utf-8")
    (folder / "study.yaml").write_text(
        f"name: crash\ntask: crash_task:Training\nsearch: {{strategy: random, trials: {trials}}}\n"
        f"resources: {{parallel: {PARALLEL}}}\nseed: 1\n",
        encoding="utf-8",
    )
    os.environ["HALMA_HOME"] = str(folder / "home")
    os.chdir(folder)
    sys.path.insert(0, str(folder))
    from services.cli import run_command

    return run_command(["run", "study.yaml", "--cores", str(PARALLEL)])


def results_halma(folder: Path) -> set[str]:
    """Trials with a result."""
    from services.store.open import open_store

    store = open_store(folder / "home" / "halma.db")
    rows = store.trials(store.study("crash").id)
    return {str(row.number) for row in rows if row.state.value == "complete"}


# -- Optuna ----------------------------------------------------------------------------------------------------------


def drive_optuna(folder: Path, trials: int) -> int:
    """`RDBStorage` with heartbeats and the retry callback of its manual."""
    import optuna
    from optuna.storages import RDBStorage, RetryHeartbeatStaleTrialCallback

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    warnings.filterwarnings("ignore", category=optuna.exceptions.ExperimentalWarning)
    storage = RDBStorage(
        f"sqlite:///{folder / 'optuna.db'}",
        # Shorter than usual, as the trainings are; still shorter, and a busy machine makes it give up living ones.
        heartbeat_interval=2,
        grace_period=15,
        heartbeat_stale_trial_callback=RetryHeartbeatStaleTrialCallback(),
        engine_kwargs={"connect_args": {"timeout": 30}},
    )
    study = optuna.create_study(
        study_name="crash", storage=storage, load_if_exists=True, sampler=optuna.samplers.RandomSampler()
    )

    def objective(trial: Any) -> float:
        x = trial.suggest_float("x", 0, 1)
        # A retried trial gets a new number; its first one is what we count by. It keeps no checkpoint by itself.
        name = first_number(study.trials[trial.number])
        steps(name, 1, lambda step: trial.report(x, step))
        note("end", name)
        return x

    complete = optuna.trial.TrialState.COMPLETE
    stop = optuna.study.MaxTrialsCallback(trials, states=(complete,))
    study.optimize(objective, n_jobs=PARALLEL, callbacks=[stop])
    return 0


def results_optuna(folder: Path) -> set[str]:
    """Trials with a result, by the number they first had."""
    import optuna

    study = optuna.load_study(study_name="crash", storage=f"sqlite:///{folder / 'optuna.db'}")
    return {str(first_number(trial)) for trial in study.trials if trial.state == optuna.trial.TrialState.COMPLETE}


def first_number(trial: Any) -> int:
    """The number under which a trial was first begun; a retry is a new trial that names it."""
    return trial.system_attrs.get("failed_trial", trial.number)


# -- Ray Tune --------------------------------------------------------------------------------------------------------


def tune_training(config: dict[str, float]) -> None:
    """With a checkpoint after each step, as Tune's manual shows."""
    from ray import tune

    trial = tune.get_context().get_trial_id()
    found = tune.get_checkpoint()
    first = 1
    if found is not None:
        with found.as_directory() as place:
            first = int(Path(place, "step").read_text(encoding="ascii")) + 1

    def keep(step: int) -> None:
        if step == ITERATIONS:
            note("end", trial)
        with tempfile.TemporaryDirectory() as place:
            Path(place, "step").write_text(str(step), encoding="ascii")
            tune.report({"x": config["x"], "step": step}, checkpoint=tune.Checkpoint.from_directory(place))

    steps(trial, first, keep)


def drive_tune(folder: Path, trials: int) -> int:
    """A new `Tuner`, or `Tuner.restore` where there is an experiment, resuming errored and unfinished trials."""
    import ray
    from ray import tune

    ray.init(num_cpus=PARALLEL, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    where = folder / "tune" / "crash"
    if tune.Tuner.can_restore(str(where)):
        tuner = tune.Tuner.restore(str(where), tune_training, resume_unfinished=True, resume_errored=True)
    else:
        tuner = tune.Tuner(
            tune_training,
            param_space={"x": tune.uniform(0, 1)},
            tune_config=tune.TuneConfig(num_samples=trials, max_concurrent_trials=PARALLEL),
            run_config=tune.RunConfig(
                name="crash", storage_path=str(folder / "tune"), verbose=0,
                failure_config=tune.FailureConfig(max_failures=-1),
            ),
        )  # fmt: skip
    found = tuner.fit()
    ended = [
        result.metrics["trial_id"] for result in found if result.metrics and result.metrics.get("step") == ITERATIONS
    ]
    (folder / "results.json").write_text(json.dumps(ended), encoding="utf-8")
    return 0


def results_tune(folder: Path) -> set[str]:
    """Trials whose last step the experiment knows."""
    return set(json.loads((folder / "results.json").read_text(encoding="utf-8")))


# -- the measurement -------------------------------------------------------------------------------------------------


def run_killed(peer: str, options: argparse.Namespace, folder: Path) -> dict[str, int]:
    """Run one library, kill it, resume it; the counts."""
    work = folder / "work"
    environment = {
        **os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'benchmarks'}", "CRASH_WORK": str(work),
        "CRASH_SECONDS": str(options.seconds), "RAY_USAGE_STATS_ENABLED": "0",
    }  # fmt: skip
    command = [sys.executable, "-P", __file__, "--drive", peer, str(folder), str(options.trials)]
    rng, ended_before, kills, began = random.Random(options.seed), set(), 0, time.monotonic()
    while True:
        with (folder / "output").open("ab") as output:
            process = subprocess.Popen(command, env=environment, stdout=output, stderr=output, start_new_session=True)
        if kills == options.kills:
            break
        had = lines(work)
        while len(lines(work)) == len(had) and process.poll() is None:
            time.sleep(0.05)
        time.sleep(rng.uniform(0.2, 1.0) * options.trials * options.seconds / PARALLEL / (options.kills + 1))
        if process.poll() is not None:
            break
        for pid in family(process.pid):
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        process.wait()
        kills += 1
        ended_before |= {trial for kind, trial, _ in lines(work) if kind == "end"}
    ended = 0
    while process.wait(timeout=1200) != 0:
        ended += 1
        if ended > 3:
            raise SystemExit(f"{peer} ends by itself:\n{(folder / 'output').read_text(errors='replace')[-3000:]}")
        with (folder / "output").open("ab") as output:
            process = subprocess.Popen(command, env=environment, stdout=output, stderr=output, start_new_session=True)
    known = RESULTS[peer](folder)
    begun = {trial for _, trial, _ in lines(work)}
    ends = Counter(trial for kind, trial, _ in lines(work) if kind == "end")
    done = Counter((trial, step) for kind, trial, step in lines(work) if kind == "step")
    return {
        "kills": kills,
        "ended by itself": ended,
        "results": len(known),
        "lost": len(ended_before - known),
        "repeated": sum(count - 1 for count in ends.values()),
        "vanished": max(len(begun - known), options.trials - len(known)),
        "steps repeated": sum(count - 1 for count in done.values()),
        "seconds": round(time.monotonic() - began),
    }


def lines(work: Path) -> list[tuple[str, ...]]:
    return [tuple(line.split()) for line in work.read_text(encoding="utf-8").splitlines()] if work.exists() else []


def family(pid: int) -> list[int]:
    """A process and all its descendants."""
    children = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(entry.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
        children.setdefault(parent, []).append(int(entry.parent.name))
    found, new = [], [pid]
    while new:
        found += new
        new = [child for parent in new for child in children.get(parent, [])]
    return found


DRIVES = {"halma": drive_halma, "optuna": drive_optuna, "tune": drive_tune}
RESULTS = {"halma": results_halma, "optuna": results_optuna, "tune": results_tune}


def main() -> None:
    if sys.argv[1:2] == ["--drive"]:
        peer, folder, trials = sys.argv[2:]
        sys.exit(DRIVES[peer](Path(folder), int(trials)))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=3)
    parser.add_argument("--trials", type=int, default=24)
    parser.add_argument("--seconds", type=float, default=0.5, help="of a training")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--peers", default="halma,optuna,tune")
    options = parser.parse_args()
    what = f"{options.trials} trainings of {options.seconds} s, {PARALLEL} at a time"
    print(f"{what}, {options.kills} kills, seed {options.seed}; load {os.getloadavg()[0]:.1f}", flush=True)
    rows = []
    for peer in options.peers.split(","):
        with tempfile.TemporaryDirectory(prefix=f"crash-{peer}-") as folder:
            rows.append((peer, run_killed(peer, options, Path(folder))))
        print(f"{peer}: {rows[-1][1]}", file=sys.stderr, flush=True)
        names = list(rows[0][1])
    print(f"| | {' | '.join(names)} |\n| --- |{' --- |' * len(names)}")
    for peer, row in rows:
        print(f"| {peer} | {' | '.join(str(row[name]) for name in names)} |")


if __name__ == "__main__":
    main()
