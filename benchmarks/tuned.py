"""What a tuned setting is worth: how soon the athlete learns to walk for long, and to run, beside the default setting.

    OMP_NUM_THREADS=1 python -m benchmarks.tuned --seeds 3 --samples 150000 --searches "cmfbo 0;gp_ucb 0"
    OMP_NUM_THREADS=1 python -m benchmarks.tuned --clips walk --samples 600000      # half an hour of a core each
    python -m benchmarks.tuned --print

A tuned setting is the best one at z = 1 that a search of `benchmarks.tuning walk` has on file (`--searches`, each with
its seed); the default is what `studies/tune_walk.yaml` trains with (`--profile`: in which profile). All train from
scratch, while the best of `cmfbo` had a policy handed on. Settings were found for 2 s of walking in the quick profile;
here episodes get longer for as long as they are followed, up to 20 s, and a setting is used for another clip as well.

Figures: samples after which episodes got that long, because 80 % of an iteration's had been followed to their end
(they begin with 1 s, and grow by 0.5 s), `-` where they didn't within `--samples`; and how long the policy follows in
the end without noise. Settings alternate within each seed. A training is a row of `benchmarks/figures/tuned.jsonl`;
what has one is not trained again.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.tuning import FIGURES, PHYSICS, STUDIES, read, revision
from services.spec_check import load_study
from workers.contracts import Job
from workers.local_context import LocalContext
from workers.run import run
from workers.tasks.imitation.settings import TRAINING

LENGTHS = (1.5, 2.0, 3.0, 5.0, 10.0, 20.0)
"""Seconds."""
Row = dict[str, Any]


def tuned_setting(search: str, seed: int) -> dict[str, Any]:
    """Parameters of the best trial of a search on file."""
    found = [
        row
        for row in read(FIGURES / "tuning-walk.jsonl")
        if (row["search"], row["seed"]) == (search, seed) and row.get("best")
    ]
    if not found:
        raise SystemExit(
            f"no search on file: python -m benchmarks.tuning walk --configs '{search}' --seeds {seed}-{seed}"
        )
    return dict(found[-1]["best"]["params"])


def train(clip: str, params: Mapping[str, Any], seed: int, samples: int, profile: str, overrides: Sequence[str]) -> Row:
    """One training: when episodes had got how long."""
    chosen = [f"profile={profile}"] if profile else []
    spec = load_study(STUDIES / "tune_walk.yaml", [*chosen, f"task.settings.clip={clip}", *overrides])
    settings = {**spec.task.settings, "longest": 600, "budget": 1.0}
    ppo = {"samples": TRAINING.ppo.samples, **dict(spec.training.get("ppo", {}))}
    # exploration ends with the budget, as it does in the searches
    training = {
        **spec.training,
        "budget": {"samples": samples},
        "ppo": ppo | {"sigma_iterations": samples // ppo["samples"]},
    }
    with tempfile.TemporaryDirectory() as folder:
        context = LocalContext(Path(folder))
        start = time.process_time()
        outcome = run(Job("tuned", 0, "imitation", dict(params), seed, settings, training), context)
        curve = [(int(r["metrics"]["samples"]), float(r["metrics"]["episode_seconds"])) for r in context.reports()]
        return {
            "minutes": (time.process_time() - start) / 60, "samples": outcome.cost.samples, "curve": changes(curve),
            "status": outcome.status, "learnt": outcome.details.get("learnt"),
            "per_step": outcome.details.get("return_per_step"), "followed": outcome.details.get("seconds_followed"),
        }  # fmt: skip


def conditions(row: Row) -> str:
    """Under what a training was: rows are compared where it is the same."""
    profile = f"profile {row['profile']}" if row["profile"] else "no profile"
    return ", ".join([f"{row['samples_allowed']:,} samples", profile, *row["set"]])


def changes(curve: Sequence[tuple[int, float]]) -> list[tuple[int, float]]:
    """The points at which the length has changed."""
    return [point for i, point in enumerate(curve) if i == 0 or point[1] != curve[i - 1][1]]


def samples_to(row: Row, seconds: float) -> float | None:
    """Samples after which episodes were that long, since 80 % of shorter ones had been followed to their end."""
    return next((float(samples) for samples, length in row["curve"] if length >= seconds), None)


def report(rows: Sequence[Row]) -> None:
    heads = "".join(f"{f'{length:g} s':>10s}" for length in LENGTHS)
    print(f"\n{'clip':10s}{'setting':18s}{'seeds':>6s}{heads}{'followed':>10s}{'CPU min':>9s}   medians (of how many)")
    for clip in dict.fromkeys(row["clip"] for row in rows):
        for setting in dict.fromkeys(row["setting"] for row in rows if row["clip"] == clip):
            own = [row for row in rows if (row["clip"], row["setting"]) == (clip, setting)]
            line = f"{clip:10s}{setting:18s}{len(own):6d}"
            for length in LENGTHS:
                came = [samples for row in own if (samples := samples_to(row, length)) is not None]
                line += f"{f'{statistics.median(came) / 1000:.0f}k ({len(came)})' if came else '-':>10s}"
            followed = [row["followed"] for row in own if row["followed"] is not None]
            line += f"{f'{statistics.median(followed):.2f} s' if followed else '-':>10s}"
            print(line + f"{statistics.median(row['minutes'] for row in own):9.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--clips", default="walk,run")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--samples", type=int, default=150_000)
    parser.add_argument(
        "--profile", default="", help="of the study; without one its own learner, larger than that of quick"
    )
    parser.add_argument("--set", action="append", default=[], help="overrides of the study, as `halma run --set`")
    parser.add_argument("--searches", default="cmfbo 0", help="whose settings: NAME SEED, separated by semicolons")
    parser.add_argument("--results", type=Path, default=FIGURES / "tuned.jsonl")
    parser.add_argument("--print", action="store_true", help="only what is on file")
    options = parser.parse_args()
    every = read(options.results)
    if options.print:
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
                    "samples_allowed": options.samples, "profile": options.profile, "set": options.set,
                    "physics": PHYSICS,
                }  # fmt: skip
                if any(asked.items() <= row.items() for row in every):
                    continue
                row = {
                    **asked,
                    "revision": code,
                    **train(clip, params, seed, options.samples, options.profile, options.set),
                }
                every.append(row)
                with options.results.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                print(f"{clip}, {setting}, seed {seed}: {row['curve'][-1]}, {row['minutes']:.1f} min", flush=True)
    here = {"samples_allowed": options.samples, "profile": options.profile, "set": options.set}
    report([row for row in every if here.items() <= row.items()])


if __name__ == "__main__":
    main()
