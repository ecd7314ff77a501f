"""How good a setting a search finds for a given cost, on the synthetic multi-fidelity objectives.

    python -m benchmarks.search.quality --set report --seeds 10 --processes 2
    python -m benchmarks.search.quality --quick

The figure is the true value at z = 1 of the answer a strategy gives, as a fraction of the known optimum. For a strategy
whose answer may be an easier evaluation (boca, cmfbo as published) that is what its parameters would reach at z = 1, at
no further cost; raw results also keep what its best evaluation at z = 1 reaches (`at_top`). Raw results
go to `benchmarks/results/quality.jsonl`, one line a run; what is there is not run again.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import zlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.search.ablations import strategy_class
from benchmarks.search.diversity import RESULTS, interval, paired, whole_seeds
from benchmarks.search.objectives import OBJECTIVES, REPORT, TUNE, Objective
from search import Observation
from search.strategy import Strategy

CONFIGS: dict[str, tuple[str, dict[str, Any], int, bool]] = {
    "random": ("random", {}, 1, False),
    "sobol": ("sobol", {}, 1, False),
    "gp_ucb": ("gp_ucb", {}, 1, False),
    "cmaes": ("cmaes", {}, 1, False),
    "tpe": ("tpe", {}, 1, False),
    "gp": ("gp", {}, 1, False),
    "top_k": ("top_k", {}, 1, False),
    "top_k, transfer": ("top_k", {}, 1, True),
    "boca": ("boca", {}, 1, False),
    "tpe_hyperband": ("tpe_hyperband", {}, 1, False),
    "tpe_hyperband, transfer": ("tpe_hyperband", {}, 1, True),
    "cmfbo published": ("cmfbo", {"variant": "published"}, 1, False),
    "cmfbo": ("cmfbo", {}, 1, False),
    "cmfbo, transfer": ("cmfbo", {}, 1, True),
    "cmfbo, q = 8": ("cmfbo", {}, 8, False),
}
"""Name in tables -> strategy, settings, batch size, whether policies transfer."""

ABLATIONS: dict[str, tuple[str, dict[str, Any], int, bool]] = {
    "cmfbo - weighing": ("cmfbo", {"gate": False}, 1, False),
    "cmfbo - easy phase": ("cmfbo", {"easy": 0.0}, 1, False),
    "cmfbo - share at z = 1": ("cmfbo", {"share": 0.0}, 1, False),
    "cmfbo - margin": ("cmfbo", {"margin": 1.0}, 1, False),
    "cmfbo - trend": ("cmfbo without trend", {}, 1, False),
    "cmfbo - priors": ("cmfbo without priors", {}, 1, False),
    "cmfbo, published x": ("cmfbo with the published x", {}, 1, False),
    "cmfbo, published z": ("cmfbo with the published z", {}, 1, False),
    "cmfbo, published x, z": ("cmfbo with the published acquisition", {}, 1, False),
    "cmfbo - reserve": ("cmfbo without reserve", {}, 1, False),
    "cmfbo - learnt costs": ("cmfbo with prior costs", {}, 1, False),
    "cmfbo - answer at z = 1": ("cmfbo with any answer", {}, 1, False),
    "cmfbo, transfer, any parent": ("cmfbo with any parent", {}, 1, True),
    "cmfbo, z = 1 alone": ("cmfbo", {"easy": 0.0, "start_z": 1.0, "share": 1.0}, 1, False),
}
"""The default with one repair taken away; by a setting, or by a class of `benchmarks.search.ablations`."""
GRID = (5, 10, 15, 20, 25, 30)
BUDGET = 30.0


def run_one(
    config: str, strategy: str, settings: dict[str, Any], batch: int, transfer: bool, problem: str, seed: int
) -> dict[str, Any]:
    """One study on one objective until its cost is spent."""
    o = replace(OBJECTIVES[problem], instance=seed)
    space = o.space
    settings = dict(settings)
    kind = strategy_class(strategy)
    names = {s.name for s in kind.info().settings}
    if "seed" in names:
        settings["seed"] = seed
    if "cost_budget" in names:
        settings["cost_budget"] = BUDGET
    made = kind(space, settings=settings)
    key = zlib.crc32(problem.encode())
    history: list[Observation] = []
    paid, seconds, asks = 0.0, 0.0, 0
    curve: list[tuple[float, float]] = [(0.0, 0.0)]
    curve_top: list[tuple[float, float]] = [(0.0, 0.0)]
    reached = None
    while paid < BUDGET:
        started = time.perf_counter()
        candidates = made.propose(history, [], batch, np.random.default_rng((seed, key, len(history), 1)))
        seconds += time.perf_counter() - started
        asks += 1
        if not candidates:
            break
        for c in candidates:
            parent = None
            if transfer and c.warm_start is not None:
                from_ = history[c.warm_start].candidate
                parent = (from_.params, 1.0 if from_.z is None else from_.z)
            z = 1.0 if c.z is None else c.z
            value, cost = o.evaluate(c.params, z, parent, np.random.default_rng((seed, key, len(history), 2)))
            history.append(Observation(c, value=value, cost=cost))
            paid += cost
            true = _true(o, history, made.recommend(history))
            # what is paid for beyond the budget doesn't count
            if paid <= BUDGET + 1e-9:
                curve.append((paid, true))
                curve_top.append((paid, _true(o, history, Strategy.recommend(made, history))))
            if reached is None and true >= 0.8:
                reached = paid
    return {
        "config": config,
        "problem": problem,
        "seed": seed,
        "at": _on_grid(curve),
        "at_top": _on_grid(curve_top),
        "to80": reached,
        "n": len(history),
        "top": float(np.mean([o.candidate.z in {None, 1.0} for o in history])),
        "seconds": seconds / max(asks, 1),
    }


def _true(o: Objective, history: list[Observation], answer: int | None) -> float:
    """What the parameters of an answer reach at z = 1, without noise."""
    return 0.0 if answer is None else o.value(o.space.to_unit(history[answer].candidate.params), 1.0)


def _on_grid(curve: list[tuple[float, float]]) -> list[float]:
    costs, values = np.array(curve).T
    return [float(values[np.searchsorted(costs, g, side="right") - 1]) for g in GRID]


def _job(arguments: tuple[Any, ...]) -> dict[str, Any]:
    return run_one(*arguments)


def run_all(
    configs: dict[str, Any], problems: list[str], seeds: int, processes: int, path: Path, *, run: bool = True
) -> list[dict[str, Any]]:
    """All runs, those on disk included; those on disk alone where nothing shall run."""
    path.parent.mkdir(parents=True, exist_ok=True)
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    wanted = {(c, p, s) for c in configs for p in problems for s in range(seeds)}
    have = {(r["config"], r["problem"], r["seed"]): r for r in done}
    if not run:
        return whole_seeds([have[k] for k in sorted(wanted & set(have))], problems)
    todo = sorted(wanted - set(have), key=lambda k: (k[2], k[1], k[0]))  # seed by seed: what is done is balanced
    jobs = [(c, *configs[c], p, s) for (c, p, s) in todo]
    with path.open("a") as out, ProcessPoolExecutor(processes) as pool:
        for r in pool.map(_job, jobs, chunksize=2):
            have[r["config"], r["problem"], r["seed"]] = r
            out.write(json.dumps(r) + "\n")
            out.flush()
    return [have[k] for k in sorted(wanted)]


def table(results: list[dict[str, Any]], title: str) -> None:
    """Means over problems and seeds; intervals from resampling seeds."""
    print(f"\n{title}: fraction of the optimum [95 % interval over seeds]; median cost to 80 % (30+: not reached)")
    print(
        f"{'':28s}{'cost 10':>10s}{'cost 20':>22s}{'cost 30':>22s}{'to 80 %':>9s}"
        f"{'n':>6s}{'z = 1':>7s}{'s/ask':>7s}{'seeds':>7s}"
    )
    for c in dict.fromkeys(r["config"] for r in results):
        rows = [r for r in results if r["config"] == c]
        seeds = sorted({r["seed"] for r in rows})
        line = f"{c:28s}{np.mean([r['at'][1] for r in rows]):10.3f}"
        for at in (3, 5):
            per_seed = np.array([np.mean([r["at"][at] for r in rows if r["seed"] == s]) for s in seeds])
            mean, low, high = interval(per_seed, np.random.default_rng(0))
            line += f"{mean:8.3f} [{low:.3f}, {high:.3f}]"
        to80 = float(np.median([r["to80"] if r["to80"] is not None else 99 for r in rows]))
        line += f"{'30+' if to80 > 30 else f'{to80:.1f}':>9s}"
        line += f"{np.mean([r['n'] for r in rows]):6.0f}{np.mean([r['top'] for r in rows]):7.2f}"
        print(line + f"{np.mean([r['seconds'] for r in rows]):7.2f}{len(seeds):7d}")


def per_problem(results: list[dict[str, Any]], problems: list[str]) -> None:
    """The figure at the full budget for each objective."""
    configs = list(dict.fromkeys(r["config"] for r in results))
    print(f"\nat cost 30, by objective\n{'':24s}" + "".join(f"{c[:15]:>16s}" for c in configs))
    for p in problems:
        means = [np.mean([r["at"][-1] for r in results if r["config"] == c and r["problem"] == p]) for c in configs]
        print(f"{p:24s}" + "".join(f"{m:16.2f}" for m in means))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set", choices=("tune", "report"), default="report")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--configs", default="", help="names separated by semicolons; all where empty")
    parser.add_argument("--extra", default="", help="JSON: name -> [strategy, settings, batch, transfer]")
    parser.add_argument("--ablations", action="store_true")
    parser.add_argument("--print", action="store_true", help="run nothing, print what is on disk, seeds told by row")
    parser.add_argument("--quick", action="store_true", help="2 seeds, 3 objectives, without the slow baselines")
    parser.add_argument("--out", type=Path, default=RESULTS / "quality.jsonl")
    args = parser.parse_args()
    problems = [o.name for o in (TUNE if args.set == "tune" else REPORT)]
    extra = {k: tuple(v) for k, v in json.loads(args.extra or "{}").items()}
    everything = {**CONFIGS, **ABLATIONS, **extra}
    names = [n for n in args.configs.split(";") if n] or [*CONFIGS, *(ABLATIONS if args.ablations else ())]
    if args.quick:
        args.seeds, problems = 2, problems[:3]
        names = [n for n in names if n not in {"gp", "cmfbo published", "cmfbo published, transfer"}]
        args.out = RESULTS / "quality-quick.jsonl"
        args.out.unlink(missing_ok=True)
    names += [n for n in extra if n not in names]
    chosen = {n: everything[n] for n in names}
    results = run_all(chosen, problems, args.seeds, args.processes, args.out, run=not args.print)
    results.sort(key=lambda r: names.index(r["config"]))
    table(results, f"{args.set} objectives ({len(problems)}), {args.seeds} seeds")
    paired(results, list(CONFIGS), "cmfbo", lambda r: [r["at"][g] for g in (1, 3, 5)])
    per_problem(results, problems)


if __name__ == "__main__":
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"
    main()
