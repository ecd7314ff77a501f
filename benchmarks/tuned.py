"""What a tuned setting is worth: after how many samples the athlete walks or runs for 20 s, beside the default setting.

    OMP_NUM_THREADS=1 python -m benchmarks.tuned --seeds 3 --searches "gp_ucb 0"
    OMP_NUM_THREADS=1 python -m benchmarks.tuned --clips run --samples 500000
    python -m benchmarks.tuned --print

A tuned setting is the best one at z = 1 that a search of `benchmarks.tuning long-walk` has on file (`--searches`, each
with its seed); the default is what `studies/tune_walk.yaml` trains with. All train from scratch, with other seeds than
the search's own trainings; the best of `cmfbo` had a policy handed on there.

Every 25,000 samples the policy, as it is, follows the clip without noise from ten times of it, the same ones for all.
It has learnt so many seconds once nine of the ten last that long (fewer than 20 % fail, as in the curriculum); then the
training ends. That play is not counted, neither as samples nor as minutes. `-`: not within `--samples`.

Settings alternate within each seed. A training is a row of `benchmarks/figures/tuned.jsonl`; what has one is not
trained again.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import statistics
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.tuning import FIGURES, PHYSICS, STUDIES, read, revision
from services.spec_check import load_study
from workers.contracts import Checkpoint, Interrupted, Job
from workers.learning.learner import Learner
from workers.learning.rollout import action_map, observation_size
from workers.learning.settings import TrainingSettings, with_searched
from workers.local_context import LocalContext
from workers.run import run
from workers.tasks.imitation.env import CONTROL
from workers.tasks.imitation.settings import LONGEST, TRAINING
from workers.tasks.imitation.task import problem_of

LENGTHS = (2.0, 5.0, 10.0, 20.0)
"""Seconds."""
EVERY = 25_000
"""Samples between checks."""
STARTS = 10
"""Times of the clip that a check begins at."""
MISSED = 1
"""How many of them may fail earlier."""
Row = dict[str, Any]


def tuned_setting(search: str, seed: int) -> dict[str, Any]:
    """Parameters of the best trial of a search on file."""
    found = [
        row
        for row in read(FIGURES / "tuning-long-walk.jsonl")
        if (row["search"], row["seed"]) == (search, seed) and row.get("best")
    ]
    if not found:
        raise SystemExit(
            f"no search on file: python -m benchmarks.tuning long-walk --configs '{search}' --seeds {seed}-{seed}"
        )
    return dict(found[-1]["best"]["params"])


class Watched(LocalContext):
    """A folder for one training whose policy is looked at now and then.

    Args:
        folder: as of `LocalContext`.
        job: what is trained.
    """

    def __init__(self, folder: Path, job: Job) -> None:
        super().__init__(folder, stop=self._learnt)
        self.problem = problem_of(job)
        settings = TrainingSettings.parse(with_searched(job.training, job.params), TRAINING)
        env = self.problem.make_env()
        self.learner = Learner(job, settings, observation_size(env), action_map(env))
        env.close()
        self.checks: list[tuple[int, list[float]]] = []
        """Samples, seconds followed from each start."""
        self.minutes = 0.0
        """CPU minutes that the checks took."""

    def save_checkpoint(self, checkpoint: Checkpoint) -> None:
        """Keep it, and look at its policy where it is time to."""
        super().save_checkpoint(checkpoint)
        samples = int(checkpoint.state["progress"]["samples"])
        if samples // EVERY == (self.checks[-1][0] // EVERY if self.checks else 0):
            return
        began = time.process_time()
        self.learner.load(checkpoint.tensors)
        policy = self.learner.policy()
        episodes = [self.problem.follow(policy, seed) for seed in range(STARTS)]
        self.checks.append((samples, [round(len(episode) * CONTROL, 2) for episode in episodes]))
        self.minutes += (time.process_time() - began) / 60

    def _learnt(self) -> bool:
        return bool(self.checks) and lasted(self.checks[-1][1]) >= self.problem.longest * CONTROL - CONTROL / 2


def lasted(followed: Sequence[float]) -> float:
    """Seconds that all starts but `MISSED` were followed for."""
    return sorted(followed)[MISSED]


def train(clip: str, params: Mapping[str, Any], seed: int, samples: int, overrides: Sequence[str]) -> Row:
    """One training, until 20 s are followed: what the checks saw."""
    spec = load_study(STUDIES / "tune_walk.yaml", [f"task.settings.clip={clip}", *overrides])
    settings = {**spec.task.settings, "longest": LONGEST}
    training = {**spec.training, "budget": {"samples": samples}}
    with tempfile.TemporaryDirectory() as folder:
        job = Job("tuned", 0, "imitation", dict(params), seed, settings, training)
        context = Watched(Path(folder), job)
        began = time.process_time()
        status = "learnt"
        with contextlib.suppress(Interrupted):  # by us, once it has
            status = str(run(job, context).status)
        minutes = (time.process_time() - began) / 60 - context.minutes
        return {"status": status, "minutes": round(minutes, 2), "checks": context.checks}


def samples_to(row: Row, seconds: float) -> int | None:
    """Samples at the first check in which all starts but `MISSED` were followed for so long."""
    return next((samples for samples, followed in row["checks"] if lasted(followed) >= seconds - CONTROL / 2), None)


def conditions(row: Row) -> str:
    """Under what a training was: rows are compared where it is the same."""
    return ", ".join([f"at most {row['samples_allowed']:,} samples", *row["set"]])


def report(rows: Sequence[Row]) -> None:
    heads = "".join(f"{f'{length:g} s':>14s}" for length in LENGTHS)
    print(f"\n{'clip':8s}{'setting':22s}{'seeds':>6s}{heads}{'CPU min':>9s}   medians (of how many)")
    for clip in dict.fromkeys(row["clip"] for row in rows):
        for setting in dict.fromkeys(row["setting"] for row in rows if row["clip"] == clip):
            own = [row for row in rows if (row["clip"], row["setting"]) == (clip, setting)]
            line = f"{clip:8s}{setting:22s}{len(own):6d}"
            for length in LENGTHS:
                came = [samples for row in own if (samples := samples_to(row, length)) is not None]
                line += f"{f'{statistics.median(came) / 1000:.0f}k ({len(came)})' if came else '-':>14s}"
            line += f"{statistics.median(row['minutes'] for row in own):9.1f}"
            print(f"{line}   20 s each: {', '.join(shown(row) for row in own)}")


def shown(row: Row) -> str:
    """Samples to 20 s in thousands, or what was followed in the end."""
    samples = samples_to(row, LENGTHS[-1])
    if samples is not None:
        return f"{samples / 1000:.0f}k"
    return f"- (mean {statistics.mean(row['checks'][-1][1]):.1f} s)" if row["checks"] else "-"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--clips", default="walk", help="names separated by commas")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--samples", type=int, default=1_500_000, help="at most so many a training")
    parser.add_argument("--set", action="append", default=[], help="overrides of the study, as `halma run --set`")
    parser.add_argument("--searches", default="", help="whose settings: NAME SEED, separated by semicolons")
    parser.add_argument("--results", type=Path, default=FIGURES / "tuned.jsonl")
    parser.add_argument("--print", action="store_true", help="only what is on file")
    options = parser.parse_args()
    if options.print:
        every = read(options.results)
        for words in dict.fromkeys(map(conditions, every)):
            print(f"\n{words}", end="")
            report([row for row in every if conditions(row) == words])
        return
    settings = {"default": dict[str, Any]()}
    for words in filter(None, options.searches.split(";")):
        search, _, seed = words.strip().rpartition(" ")
        if not seed.isdecimal():
            parser.error(f"--searches: expected a search and its seed, as in 'cmfbo 0', found {words.strip()!r}")
        settings[words.strip()] = tuned_setting(search, int(seed))
        print(f"{words.strip()}: {settings[words.strip()]}")
    code = revision()
    for seed in range(1, options.seeds + 1):
        for clip in options.clips.split(","):
            for setting, params in settings.items():
                asked = {
                    "clip": clip, "setting": setting, "params": params, "seed": seed,
                    "samples_allowed": options.samples, "set": options.set, "physics": PHYSICS,
                }  # fmt: skip
                if any(asked.items() <= row.items() for row in read(options.results)):
                    continue  # or somebody else did it meanwhile, on another core
                row = {**asked, "revision": code, **train(clip, params, seed, options.samples, options.set)}
                with options.results.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                print(f"{clip}, {setting}, seed {seed}: {shown(row)}, {row['minutes']:.1f} min", flush=True)
    here = {"samples_allowed": options.samples, "set": options.set}
    report([row for row in read(options.results) if here.items() <= row.items()])


if __name__ == "__main__":
    main()
