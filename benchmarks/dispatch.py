"""What halma costs between trainings: dispatch latency, the share of worker time in trainings, trivial trials a second.

    python -m benchmarks.dispatch [--trials 400] [--slots 8] [--sleeping 24] [--seconds 60] [--parts latency,share,rate]

- latency: trivial trainings on so many slots. From the moment at which a result is written into the record (the time
  of its event, a little before the commit that holds it) to the start of the next training in a worker process: the
  k-th result frees the slot that the (k + slots)-th training takes. Counted from when every worker has had a turn:
  until then worker processes are starting, which on few cores is what everything else waits for.
- share: trainings that sleep. The part of the slots' time, from the first start to the last start, that they are in a
  training; sleeping costs no core, so two cores do for eight slots.
- rate: trivial trials a second, from the first start to the last end, beside Ray Tune on as many slots in the same run.

The trainings note their own starts and ends, in a file that neither library knows of.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from services.store.open import open_store

ROOT = Path(__file__).resolve().parents[1]
LATENCY_TARGET, SHARE_TARGET, RATE_TARGET = 0.050, 0.99, 5.0
START = "import sys; sys.argv[0] = 'halma'; from services.cli import main; main()"
TASK = """
import os, time
from workers.contracts import Cost, Outcome, ParameterSpec, TaskInfo


def note(kind, trial):
    descriptor = os.open(os.environ["DISPATCH_NOTES"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(descriptor, f"{kind} {trial} {time.time()} {os.getpid()}\\n".encode())
    os.close(descriptor)


class Training:
    def info(self, settings):
        space = {"x": ParameterSpec("float", 0.0, 1.0)}
        return TaskInfo("dispatch_task:Training", "nothing, for a while", parameters=space, trains=False)

    def validate(self, settings, training, names):
        pass

    def run(self, job, context):
        note("start", job.trial)
        time.sleep(float(os.environ["DISPATCH_SECONDS"]))
        note("end", job.trial)
        return Outcome("complete", job.params["x"], None, Cost(1, 0.0))
"""
TUNE = """
import os, sys
sys.path.insert(0, os.getcwd())
import ray
from ray import tune
from dispatch_task import note
slots, trials = int(sys.argv[1]), int(sys.argv[2])


def training(config):
    trial = tune.get_context().get_trial_id()
    note("start", trial)
    note("end", trial)
    tune.report({"x": config["x"]})


ray.init(num_cpus=slots, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
found = tune.Tuner(
    training,
    param_space={"x": tune.uniform(0, 1)},
    tune_config=tune.TuneConfig(num_samples=trials, max_concurrent_trials=slots),
    run_config=tune.RunConfig(name="rate", storage_path=os.getcwd() + "/tune", verbose=0),
).fit()
assert len(found) == trials and not found.errors
"""


def run(folder: Path, seconds: float, command: list[str]) -> None:
    """Run a command in a folder whose trainings take so long."""
    environment = {
        **os.environ, "PYTHONPATH": str(ROOT), "HALMA_HOME": str(folder / "home"), "DISPATCH_SECONDS": str(seconds),
        "DISPATCH_NOTES": str(folder / "notes"), "RAY_USAGE_STATS_ENABLED": "0", "OMP_NUM_THREADS": "1",
    }  # fmt: skip
    environment.pop("HALMA_DB", None)
    done = subprocess.run(
        [sys.executable, "-c", *command],
        cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip
    if done.returncode != 0:
        raise SystemExit(f"it ended with {done.returncode}:\n{done.stdout[-3000:]}")


def halma(folder: Path, trials: int, slots: int, seconds: float) -> None:
    """A study of `random` over so many trainings."""
    (folder / "dispatch_task.py").write_text(TASK, encoding="utf-8")
    (folder / "study.yaml").write_text(
        f"name: dispatch\ntask: dispatch_task:Training\nsearch: {{strategy: random, trials: {trials}}}\n"
        f"resources: {{parallel: {slots}}}\nseed: 1\n",
        encoding="utf-8",
    )
    run(folder, seconds, [START, "run", "study.yaml", "--cores", str(slots)])


def tune(folder: Path, trials: int, slots: int) -> None:
    """The same trainings under Ray Tune."""
    (folder / "dispatch_task.py").write_text(TASK, encoding="utf-8")
    run(folder, 0.0, [TUNE, str(slots), str(trials)])


def noted(folder: Path) -> tuple[list[float], list[float]]:
    """Starts and ends of the trainings, in order of time."""
    lines = [line.split() for line in (folder / "notes").read_text(encoding="ascii").splitlines()]
    return tuple(sorted(float(at) for kind, _, at, _ in lines if kind == which) for which in ("start", "end"))  # type: ignore[return-value]


def all_at_work(folder: Path, slots: int) -> float:
    """When the last of so many worker processes began its first training."""
    lines = [line.split() for line in (folder / "notes").read_text(encoding="ascii").splitlines()]
    first: dict[str, float] = {}
    for kind, _, at, worker in lines:
        if kind == "start":
            first.setdefault(worker, float(at))
    if len(first) < slots:
        raise SystemExit(f"expected {slots} workers, found {len(first)}: more trials are needed (--trials)")
    return sorted(first.values())[slots - 1]


def results(folder: Path) -> list[float]:
    """When results were written, in order."""
    store = open_store(folder / "home" / "halma.db")
    found, after = [], 0
    while events := store.events(after=after, limit=1000):
        found += [event for event in events if event.kind == "finished"]
        after = events[-1].id
    store.close()
    return sorted(event.at.timestamp() for event in found)


def rate(starts: list[float], ends: list[float]) -> float:
    return len(ends) / (ends[-1] - starts[0])


def verdict(reached: bool) -> str:
    return "reached" if reached else "NOT reached"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=1000, help="trivial ones")
    parser.add_argument("--slots", type=int, default=8)
    parser.add_argument("--sleeping", type=int, default=24, help="trainings that sleep")
    parser.add_argument("--seconds", type=float, default=60.0, help="that each of them sleeps")
    parser.add_argument("--parts", default="latency,share,rate")
    given = parser.parse_args()
    parts, slots = given.parts.split(","), given.slots
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; {slots} slots", flush=True)
    with tempfile.TemporaryDirectory(prefix="halma-dispatch-") as place:
        folders = {part: Path(place, part) for part in ("trivial", "sleeping", "tune")}
        for folder in folders.values():
            folder.mkdir()
        if {"latency", "rate"} & set(parts):
            halma(folders["trivial"], given.trials, slots, 0.0)
            starts, ends = noted(folders["trivial"])
            ours = rate(starts, ends)
        if "latency" in parts:
            written = results(folders["trivial"])
            begun = all_at_work(folders["trivial"], slots)
            skip = slots + sum(at < begun for at in written)
            waits = [start - at for at, start in zip(written[skip:], starts[skip + slots :], strict=False)]
            centiles = statistics.quantiles(waits, n=100)
            reached = verdict(centiles[98] < LATENCY_TARGET)
            print(
                f"latency, {len(waits)} dispatches: "
                f"median {1e3 * centiles[49]:.1f} ms, p99 {1e3 * centiles[98]:.1f} ms "
                f"(target {1e3 * LATENCY_TARGET:.0f}: {reached})",
                flush=True,
            )
        if "share" in parts:
            began = time.monotonic()
            halma(folders["sleeping"], given.sleeping, slots, given.seconds)
            first, last = noted(folders["sleeping"])
            # Until the last start every slot has work to get; from there on they end one by one.
            span = first[-1] - first[0]
            busy = sum(min(end, first[-1]) - start for start, end in zip(first, last, strict=True) if start < first[-1])
            share = busy / (span * slots)
            print(
                f"share of the slots' time in trainings of {given.seconds:g} s: {100 * share:.2f} % "
                f"(target {100 * SHARE_TARGET:.0f}: {verdict(share >= SHARE_TARGET)}; "
                f"{time.monotonic() - began:.0f} s in all)",
                flush=True,
            )
        if "rate" in parts:
            tune(folders["tune"], given.trials, slots)
            theirs = rate(*noted(folders["tune"]))
            print(
                f"trivial trials a second: halma {ours:.1f}, Ray Tune {theirs:.1f}: {ours / theirs:.1f} times "
                f"(target {RATE_TARGET:g}: {verdict(ours / theirs >= RATE_TARGET)})"
            )


if __name__ == "__main__":
    main()
