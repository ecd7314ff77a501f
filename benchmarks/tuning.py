"""How good a setting each search finds on real trainings, at equal cost in simulation samples.

    python -m benchmarks.tuning gymnasium --seeds 3
    python -m benchmarks.tuning walker --seeds 3 --configs "cmfbo;random"
    python -m benchmarks.tuning gymnasium --report

The study is the one that `halma run` takes (`studies/`), in its quick profile, one trial at a time. The figure is the
best value at z = 1 that a search has seen by the time it has spent so many samples; values of easier tasks are no
answers. Only `cmfbo` proposes parents, so that `cmfbo, no transfer` is what the search alone is worth, and the
difference what policies handed on are. A warm-started policy has learnt from its parents' samples too: they are in the
cost, which is the whole study's.

Raw results go to `benchmarks/results/tuning-NAME.jsonl`, one line a trial: what is there is not run again, and an
interrupted study goes on where it was (its policies lie beside the file).
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.search.diversity import RESULTS, interval
from search import Candidate, Observation
from search.registry import strategy_class
from services.spec import ResolvedSpec
from services.spec_check import load_study
from services.translate import make_strategy_of
from workers.contracts import Job
from workers.local_context import LocalContext
from workers.run import run

STUDIES = Path(__file__).parent.parent / "studies"
WHERE: Mapping[str, str] = {
    "gymnasium": "tune_gymnasium.yaml",
    "walker": "walker_morphology.yaml",
    "walk": "tune_walk.yaml",
}
"""Name on the command line -> study."""

CONFIGS: Mapping[str, tuple[str, bool]] = {
    "cmfbo": ("cmfbo", True),
    "cmfbo, no transfer": ("cmfbo", False),
    "gp_ucb": ("gp_ucb", False),
    "boca": ("boca", False),
    "tpe_hyperband": ("tpe_hyperband", False),
    "gp": ("gp", False),
    "random": ("random", False),
}
"""Name in tables -> strategy, whether policies are handed on."""

SHARES = (0.25, 0.5, 0.75, 1.0)
"""Shares of the cost that the table has columns for."""

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Run:
    """One study of one strategy under one seed."""

    name: str
    config: str
    seed: int
    spec: ResolvedSpec
    folder: Path

    @property
    def budget(self) -> float:
        return float(self.spec.search.cost or 0.0)


def run_of(name: str, config: str, seed: int, overrides: Sequence[str], folder: Path) -> Run:
    strategy, _ = CONFIGS[config]
    chosen = ["profile=quick", f"search.strategy={strategy}", f"seed={seed}", *overrides]
    if any(setting.name == "seed" for setting in strategy_class(strategy).info().settings):
        chosen.append(f"search.settings.seed={seed}")  # of a design that would else be the same for all seeds
    spec = load_study(STUDIES / WHERE[name], chosen)
    return Run(name, config, seed, spec, folder / f"{name}-{config.replace(', ', '-').replace(' ', '-')}-{seed}")


def one_study(study: Run, done: Sequence[Row], out: Path) -> list[Row]:
    """The study's trials until its cost is spent, those on disk included."""
    rows = list(done) if (study.folder / f"{len(done) - 1}").exists() else []
    if done and not rows:
        raise SystemExit(f"{study.folder}: expected the policies of {len(done)} trials; delete {out} to begin anew")
    strategy = make_strategy_of(study.spec)
    transfers = CONFIGS[study.config][1]
    history = [_observation(row) for row in rows]
    key = zlib.crc32(study.config.encode())
    while (paid := sum(row["cost"] for row in rows)) < study.budget:
        began = time.perf_counter()
        rng = np.random.default_rng((study.seed, key, len(rows)))
        proposed = strategy.propose(history, [], 1, rng)
        asked = time.perf_counter() - began
        if not proposed:
            break
        (candidate,) = proposed
        parent = candidate.warm_start if transfers else None
        number = len(rows)
        folder = study.folder / str(number)
        shutil.rmtree(folder, ignore_errors=True)  # a trial that was interrupted begins anew
        job = Job(
            study.spec.name, number, study.spec.task.name, dict(candidate.params),
            int(np.random.SeedSequence((study.seed, number)).generate_state(1, np.uint64)[0]),
            study.spec.task.settings, study.spec.training, candidate.z, parent,
        )  # fmt: skip
        outcome = run(job, LocalContext(folder, parent=None if parent is None else study.folder / str(parent)))
        shutil.rmtree(folder / "checkpoints", ignore_errors=True)
        row: Row = {
            "name": study.name, "config": study.config, "seed": study.seed, "trial": number,
            "params": dict(candidate.params), "z": candidate.z, "warm_start": candidate.warm_start, "parent": parent,
            "status": outcome.status, "value": outcome.value, "cost": outcome.cost.samples,
            "spent": paid + outcome.cost.samples, "seconds": outcome.cost.seconds, "asked": asked,
            "budget": study.budget,
        }  # fmt: skip
        rows.append(row)
        history.append(Observation(candidate, row["value"], None, float(row["cost"]), outcome.status))
        with out.open("a") as file:
            file.write(json.dumps(row) + "\n")
    return rows


def _observation(row: Row) -> Observation:
    candidate = Candidate(row["params"], row["z"], row["warm_start"])
    return Observation(candidate, row["value"], None, float(row["cost"]), row["status"])


def best_at(rows: Sequence[Row], cost: float) -> float | None:
    """Best value of the task itself among what was paid for with `cost`; a trial counts when it is over."""
    values = [
        row["value"]
        for row in rows
        if row["z"] in {None, 1.0} and row["status"] == "complete" and row["spent"] <= cost + 1e-9
    ]
    return max(values, default=None)


def cost_to(rows: Sequence[Row], value: float) -> float | None:
    """Samples spent when the task itself first reached `value`."""
    for row in rows:
        if row["z"] in {None, 1.0} and row["status"] == "complete" and row["value"] >= value:
            return float(row["spent"])
    return None


def report(name: str, rows: Sequence[Row]) -> None:
    """Best value at z = 1 against cost, with intervals over seeds, and the cost to what `random` ends with."""
    runs: dict[tuple[str, int], list[Row]] = {}
    for row in rows:
        runs.setdefault((row["config"], row["seed"]), []).append(row)
    if not runs:
        raise SystemExit(f"no trials of {name} yet")
    budget = rows[0]["budget"]
    # The last trial of a study may end beyond its cost: it was begun within it, and counts at its end for all alike.
    whole = max(sum(row["cost"] for row in each) for each in runs.values())
    # A search that has no answer yet is as good as its first full training would be: the worst one seen.
    worst = min(row["value"] for row in rows if row["z"] in {None, 1.0} and row["value"] is not None)
    at = {share: share * budget if share < 1 else whole for share in SHARES}
    randoms = [found for (config, _), each in runs.items() if config == "random" if (found := best_at(each, whole))]
    goal = float(np.mean(randoms)) if randoms else None
    print(f"{name}: best value at z = 1, mean over seeds [95 % bootstrap interval]; cost {budget:,.0f} samples")
    head = "".join(f"{f'{100 * share:.0f} %':>28s}" for share in SHARES)
    print(f"{'':20s}{'seeds':>6s}{head}{'trials':>8s}{'z = 1':>7s}" + (f"{'to random':>12s}" if goal else ""))
    for config in (each for each in CONFIGS if any(key[0] == each for key in runs)):
        mine = [each for (found, _), each in runs.items() if found == config]
        line = f"{config:20s}{len(mine):6d}"
        for cost in at.values():
            best = [best_at(each, cost) for each in mine]
            mean, low, high = interval(np.array([worst if b is None else b for b in best]), np.random.default_rng(0))
            line += f"{f'{mean:.4g} [{low:.4g}, {high:.4g}]':>28s}"
        top = np.mean([row["z"] in {None, 1.0} for each in mine for row in each])
        line += f"{np.mean([len(each) for each in mine]):8.1f}{top:7.2f}"
        if goal is not None:
            costs = [found if (found := cost_to(each, goal)) is not None else float("inf") for each in mine]
            middle = float(np.median(costs))
            line += f"{'never' if middle == float('inf') else f'{middle / budget:.2f}':>12s}"
        print(line)
    if goal is not None:
        print(f"to random: median share of the cost after which a search has what random ends with ({goal:.4g})")


def read(path: Path) -> list[Row]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name", choices=sorted(WHERE))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--configs", default="", help="names separated by semicolons; all where empty")
    parser.add_argument("--set", action="append", default=[], help="overrides of the study, as `halma run --set`")
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument("--report", action="store_true", help="only the table of what is there")
    options = parser.parse_args()
    out: Path = options.out or RESULTS / f"tuning-{options.name}.jsonl"
    out.parent.mkdir(parents=True, exist_ok=True)
    names = [each for each in options.configs.split(";") if each] or list(CONFIGS)
    for name in names:
        if name not in CONFIGS:
            parser.error(f"--configs: expected some of {'; '.join(CONFIGS)}, found {name!r}")
    for seed in range(0 if options.report else options.seeds):  # seed by seed: what is done is balanced
        for config in names:
            study = run_of(options.name, config, seed, options.set, out.with_suffix(""))
            done = [row for row in read(out) if (row["config"], row["seed"]) == (config, seed)]
            began = time.perf_counter()
            rows = one_study(study, done, out)
            best = best_at(rows, float("inf"))
            shown = "none" if best is None else f"{best:.4g}"
            print(
                f"{config}, seed {seed}: {len(rows)} trials, best {shown}, {time.perf_counter() - began:.0f} s",
                flush=True,
            )
    report(options.name, [row for row in read(out) if row["config"] in names])


if __name__ == "__main__":
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"
    main()
