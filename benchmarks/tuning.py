"""How good a setting each search finds on real trainings, at equal cost in simulation samples.

    python -m benchmarks.tuning gymnasium --seeds 3
    python -m benchmarks.tuning walker --seeds 3 --configs "cmfbo;random"
    python -m benchmarks.tuning walk --seeds 3-5 --configs "cmfbo;gp_ucb;boca;tpe_hyperband;gp;random"
    python -m benchmarks.tuning walk --print

The study is the one that `halma run` takes (`studies/`), in its quick profile, one trial at a time; `long-walk` is that
of the walk without profile: 20 s, more than an hour of a core for a search. The figure is the
best value at z = 1 that a search has seen by the time it has spent so many samples; values of easier tasks are no
answers. A search whose answer is an easier evaluation (boca) has its parameters trained at z = 1 in the end, at no
further cost. Only `cmfbo` proposes parents, so that `cmfbo, no transfer` is what the search alone is worth, and the
difference what policies handed on are. A warm-started policy has learnt from its parents' samples too: they are in the
cost, which is the whole study's.

A comparison takes many sittings. One search under one seed is a row, a JSON line, that is appended to `--results` when
it is over (`benchmarks/figures/tuning-NAME.jsonl`, which is tracked): its best value at z = 1 against cost, the
revision of the code, and a digest of what it was run on. What has a row for the same digest is not run again, and rows
of another digest are not in the table. A search that was interrupted goes on at the trial it was in: its trials are
lines in `benchmarks/results/tuning-NAME/`, beside their policies, which are not tracked.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.search.diversity import RESULTS, interval
from search import Candidate, Observation
from search.registry import strategy_class
from services.spec import ResolvedSpec
from services.spec_check import load_study
from services.translate import begin_with_points, make_strategy_of
from workers.contracts import Job
from workers.local_context import LocalContext
from workers.registry import load_task
from workers.run import run

STUDIES = Path(__file__).parent.parent / "studies"
FIGURES = Path(__file__).parent / "figures"
WHERE: Mapping[str, str] = {
    "gymnasium": "tune_gymnasium.yaml",
    "walker": "walker_morphology.yaml",
    "walk": "tune_walk.yaml",
    "long-walk": "tune_walk.yaml",
}
"""Name on the command line -> study."""

WHOLE = frozenset({"long-walk"})
"""Names whose study is run without profile, others in `quick`."""

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

PHYSICS = "the ground is a box"
"""Part of what a row was run on, decision 14: what was measured in another world is not compared."""

LATER = {"kl_check": "epoch", "sigma_child": "start"}
"""Settings of the learner that the first rows were made without, and the value that leaves all as it was."""

OF_CHILDREN = frozenset({"sigma_child"})
"""Settings of the learner that change nothing where no policies are handed on."""

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

    @property
    def digest(self) -> str:
        """Of what the search was run on; rows count where it is that of the study as it is now."""
        spec = self.spec
        space = {name: each.model_dump(mode="json") for name, each in (spec.space or {}).items()}
        # with defaults written out: a study that says what went without saying is no other
        info = load_task(spec.task.name).info(spec.task.settings)
        training: dict[str, Any] = {**info.training, **spec.training}
        for key, part in info.training.items():
            if isinstance(part, dict):
                training[key] = {**part, **spec.training.get(key, {})}
        ppo = training["ppo"]
        idle = frozenset() if CONFIGS[self.config][1] else OF_CHILDREN
        training["ppo"] = {
            key: value for key, value in ppo.items() if key not in idle and not (key in LATER and value == LATER[key])
        }
        first = [spec.search.first] if spec.search.first else []
        common = [PHYSICS, spec.task.name, info.settings, training, space, self.budget, *first]
        return hashlib.sha256(json.dumps(common, sort_keys=True).encode()).hexdigest()[:12]

    @property
    def trials(self) -> Path:
        """One line for each trial of a search that is not over."""
        return self.folder / "trials.jsonl"


def run_of(name: str, config: str, seed: int, overrides: Sequence[str], folder: Path) -> Run:
    strategy, _ = CONFIGS[config]
    profile = [] if name in WHOLE else ["profile=quick"]
    chosen = [*profile, f"search.strategy={strategy}", f"seed={seed}", *overrides]
    if any(setting.name == "seed" for setting in strategy_class(strategy).info().settings):
        chosen.append(f"search.settings.seed={seed}")  # of a design that would else be the same for all seeds
    spec = load_study(STUDIES / WHERE[name], chosen)
    made = Run(name, config, seed, spec, folder)
    return replace(made, folder=folder / f"{config.replace(', ', '-').replace(' ', '-')}-{seed}-{made.digest}")


def one_study(study: Run) -> list[Row]:
    """The study's trials until its cost is spent, those on disk included."""
    out = study.trials
    rows = read(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    strategy = begin_with_points(make_strategy_of(study.spec), study.spec)
    key = zlib.crc32(study.config.encode())
    while (paid := sum(row["cost"] for row in rows)) < study.budget:
        history = [_observation(row) for row in rows]
        began = time.perf_counter()
        proposed = strategy.propose(history, [], 1, np.random.default_rng((study.seed, key, len(rows))))
        asked = time.perf_counter() - began
        if not proposed:
            break
        rows.append({**_trained(study, proposed[0], len(rows), paid), "asked": asked})
        _write(out, rows[-1])
    if not any(row.get("answer") for row in rows):
        history = [_observation(row) for row in rows]
        answer = strategy.recommend(history)
        if answer is not None and history[answer].candidate.z not in {None, 1.0}:
            real = Candidate(history[answer].candidate.params, 1.0)
            rows.append({**_trained(study, real, len(rows), paid), "cost": 0, "spent": paid, "answer": True})
            _write(out, rows[-1])
    return rows


def _trained(study: Run, candidate: Candidate, number: int, paid: float) -> Row:
    """What came of one trial."""
    parent = candidate.warm_start if CONFIGS[study.config][1] else None
    folder = study.folder / str(number)
    shutil.rmtree(folder, ignore_errors=True)  # a trial that was interrupted begins anew
    job = Job(
        study.spec.name, number, study.spec.task.name, dict(candidate.params),
        int(np.random.SeedSequence((study.seed, number)).generate_state(1, np.uint64)[0]),
        study.spec.task.settings, study.spec.training, candidate.z, parent,
    )  # fmt: skip
    outcome = run(job, LocalContext(folder, parent=None if parent is None else study.folder / str(parent)))
    shutil.rmtree(folder / "checkpoints", ignore_errors=True)
    return {
        "name": study.name, "config": study.config, "seed": study.seed, "trial": number,
        "params": dict(candidate.params), "z": candidate.z, "warm_start": candidate.warm_start, "parent": parent,
        "status": outcome.status, "value": outcome.value, "cost": outcome.cost.samples,
        "spent": paid + outcome.cost.samples, "seconds": outcome.cost.seconds, "budget": study.budget,
    }  # fmt: skip


def summary(study: Run, rows: Sequence[Row], code: str) -> Row:
    """The row of a search that is over."""
    own = [row for row in rows if row["z"] in {None, 1.0}]
    curve: list[tuple[float, float]] = []
    for row in own:
        if row["status"] == "complete" and (not curve or row["value"] > curve[-1][1]):
            curve.append((row["spent"], row["value"]))
    values = [row["value"] for row in own if row["value"] is not None]
    best = max((row for row in own if row["status"] == "complete"), key=lambda row: float(row["value"]), default=None)
    return {
        "problem": study.name, "search": study.config, "seed": study.seed, "digest": study.digest, "revision": code,
        "budget": study.budget, "spent": sum(row["cost"] for row in rows), "trials": len(rows), "at_z1": len(own),
        "best": best and {key: best[key] for key in ("params", "value", "parent")},
        "curve": curve, "worst": min(values, default=None), "seconds": round(sum(row["seconds"] for row in rows), 1),
    }  # fmt: skip


def revision() -> str:
    """The commit that the code is of, with a + where files differ from it."""
    root = Path(__file__).parent.parent

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=root, check=True, capture_output=True, text=True).stdout.strip()

    # rows that are appended change nothing of the code
    changed = git("status", "--porcelain", "--untracked-files=no", "--", ".", ":(exclude)benchmarks/figures")
    return git("rev-parse", "--short=12", "HEAD") + ("+" if changed else "")


def _write(out: Path, row: Row) -> None:
    with out.open("a") as file:
        file.write(json.dumps(row) + "\n")


def _observation(row: Row) -> Observation:
    candidate = Candidate(row["params"], row["z"], row["warm_start"])
    return Observation(candidate, row["value"], None, float(row["cost"]), row["status"])


def best_at(row: Row, cost: float) -> float | None:
    """Best value of the task itself among what was paid for with `cost`; a trial counts when it is over."""
    return max((value for spent, value in row["curve"] if spent <= cost + 1e-9), default=None)


def cost_to(row: Row, value: float) -> float:
    """Samples spent when the task itself first reached `value`, infinite where it never did."""
    return min((spent for spent, found in row["curve"] if found >= value), default=float("inf"))


def report(name: str, rows: Sequence[Row]) -> None:
    """Best value at z = 1 against cost, with intervals over seeds, and the cost to what `random` ends with."""
    if not rows:
        raise SystemExit(f"no finished search of {name} on file for what the study is now")
    budget = rows[0]["budget"]
    # The last trial of a study may end beyond its cost: it was begun within it, and counts at its end for all alike.
    whole = max(row["spent"] for row in rows)
    # A search that has no answer yet is as good as its first full training would be: the worst one seen.
    worst = min((row["worst"] for row in rows if row["worst"] is not None), default=float("nan"))
    at = {share: share * budget if share < 1 else whole for share in SHARES}

    def best(row: Row, cost: float) -> float:
        found = best_at(row, cost)
        return worst if found is None else found

    randoms = [best(row, whole) for row in rows if row["search"] == "random"]
    goal = float(np.mean(randoms)) if randoms else None
    print(f"{name}: best value at z = 1, mean over seeds [95 % bootstrap interval]; cost {budget:,.0f} samples")
    head = "".join(f"{f'{100 * share:.0f} %':>30s}" for share in SHARES)
    tail = "" if goal is None else f"{'to random':>12s}"
    print(f"{'':20s}{'seeds':>12s}{head}{'trials':>8s}{'z = 1':>7s}{tail}")
    for config in CONFIGS:
        mine = sorted((row for row in rows if row["search"] == config), key=lambda row: int(row["seed"]))
        if not mine:
            continue
        line = f"{config:20s}{','.join(str(row['seed']) for row in mine):>12s}"
        for cost in at.values():
            values = np.array([best(row, cost) for row in mine])
            mean, low, high = interval(values, np.random.default_rng(0))
            line += f"{f'{mean:.3g} [{low:.3g}, {high:.3g}]':>30s}"
        share = sum(row["at_z1"] for row in mine) / sum(row["trials"] for row in mine)
        line += f"{np.mean([row['trials'] for row in mine]):8.1f}{share:7.2f}"
        if goal is not None:
            middle = float(np.median([cost_to(row, goal) for row in mine]))
            line += f"{'never' if middle == float('inf') else f'{middle / budget:.2f}':>12s}"
        print(line)
    if goal is not None:
        print(f"to random: median share of the cost after which a search has what random ends with ({goal:.4g})")
    print(f"revisions: {', '.join(sorted({row['revision'] for row in rows}))}")


def read(path: Path) -> list[Row]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def seeds_of(text: str) -> list[int]:
    """`3`: the first three, 0 to 2; `3-5`: those."""
    first, _, last = text.partition("-")
    if not first.isdecimal() or not (last.isdecimal() or last == text[len(first) :] == ""):
        raise argparse.ArgumentTypeError(f"expected how many, or the first and the last as 3-5, found {text!r}")
    return list(range(int(first), int(last) + 1)) if last else list(range(int(first)))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("name", choices=sorted(WHERE))
    parser.add_argument("--seeds", type=seeds_of, default=[0, 1, 2], help="how many, or 3-5; --print has all")
    parser.add_argument("--configs", default="", help="names separated by semicolons; all where empty")
    parser.add_argument("--set", action="append", default=[], help="overrides of the study, as `halma run --set`")
    parser.add_argument("--results", type=Path, default=None, help="the file of finished searches")
    parser.add_argument("--work", type=Path, default=None, help="the folder of searches that are not over")
    parser.add_argument("--print", action="store_true", help="only the table of what is on file")
    options = parser.parse_args(arguments)
    results: Path = options.results or FIGURES / f"tuning-{options.name}.jsonl"
    work: Path = options.work or RESULTS / f"tuning-{options.name}"
    results.parent.mkdir(parents=True, exist_ok=True)
    names = [each for each in options.configs.split(";") if each] or list(CONFIGS)
    for name in names:
        if name not in CONFIGS:
            parser.error(f"--configs: expected some of {'; '.join(CONFIGS)}, found {name!r}")
    digests = {config: run_of(options.name, config, 0, options.set, work).digest for config in names}
    code = revision()  # as the code was when it was loaded
    for seed in [] if options.print else options.seeds:  # seed by seed: what is done is balanced
        for config in names:
            study = run_of(options.name, config, seed, options.set, work)
            key = (config, seed, study.digest)
            if any((row["search"], row["seed"], row["digest"]) == key for row in read(results)):
                continue
            began = time.perf_counter()
            row = summary(study, one_study(study), code)
            _write(results, row)
            shutil.rmtree(study.folder)
            best = best_at(row, float("inf"))
            shown = "none" if best is None else f"{best:.4g}"
            print(
                f"{config}, seed {seed}: {row['trials']} trials, best {shown}, {time.perf_counter() - began:.0f} s",
                flush=True,
            )
    rows = [row for row in read(results) if row["search"] in names]
    report(options.name, [row for row in rows if row["digest"] == digests[row["search"]]])
    if others := sum(row["digest"] != digests[row["search"]] for row in rows):
        print(f"{others} rows are of another version of the study, and not in the table")


if __name__ == "__main__":
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"
    main()
