"""How many distinct strategies a diversity search finds on the synthetic maps; every figure beside its controls.

    python -m benchmarks.search.diversity --set report --seeds 20 --processes 2
    python -m benchmarks.search.diversity --quick

Raw results go to `benchmarks/results/diversity.jsonl`, one line a run; what is there is not run again.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.search.ablations import strategy_class
from benchmarks.search.map_sets import FLIGHTS, INTERIOR, MAPS, REPORT, TUNE, VALIDATE, WIDE
from search import Observation

RESULTS = Path(__file__).parent.parent / "results"

CONFIGS: dict[str, tuple[str, dict[str, Any], int]] = {
    "random": ("random", {}, 1),
    "sobol": ("sobol", {}, 1),
    "edge": ("edge", {}, 1),
    "bds published": ("bds", {"variant": "published"}, 1),
    "bds": ("bds", {}, 1),
    "bds, batches of 8": ("bds", {}, 8),
    "map_elites": ("map_elites", {}, 1),
    "cma_me": ("cma_me", {}, 1),
}
"""Name in tables -> strategy, settings, batch size."""

ABLATIONS: dict[str, tuple[str, dict[str, Any], int]] = {
    "bds - feasibility": ("bds", {"feasibility": False}, 1),
    "bds - interior": ("bds", {"interior": False}, 1),
    "bds - longer start": ("bds", {"start": 2}, 1),
    "bds - spacing": ("bds", {"radius": 0.0}, 1),
    "bds - Sobol start": ("bds", {"start": 0}, 1),
    "bds - priors": ("bds without priors", {}, 1),
    "bds - noise": ("bds without noise", {}, 1),
    "bds - geometry": ("bds with plain geometry", {}, 1),
    "bds - one acquisition": ("bds alternating", {}, 1),
    "bds, batches of 8 - belief": ("bds without belief", {}, 8),
}
"""The default with one repair taken away; by a setting, or by a class of `benchmarks.search.ablations`."""


SETS = {"tune": TUNE, "validate": VALIDATE, "report": REPORT, "flights": FLIGHTS, "wide": WIDE}
"""What `--set` means."""


def run_one(
    config: str, strategy: str, settings: dict[str, Any], batch: int, problem: str, seed: int, evaluations: int
) -> dict[str, Any]:
    """One study on one map: strategies found after each evaluation, failures, near-duplicates, coordinates on faces."""
    m = MAPS[problem]
    space = m.space
    settings = dict(settings)
    kind = strategy_class(strategy)
    if "seed" in {f.name for f in kind.info().settings}:
        settings["seed"] = seed
    made = kind(space, m.features, settings)
    key = zlib.crc32(problem.encode())
    history: list[Observation] = []
    found: set[int] = set()
    curve, failures, seconds = [], 0, 0.0
    while len(history) < evaluations:
        started = time.perf_counter()
        candidates = made.propose(history, [], batch, np.random.default_rng((seed, key, len(history), 1)))
        seconds += time.perf_counter() - started
        for c in candidates:
            label, features = m.evaluate(c.params, np.random.default_rng((seed, key, len(history), 2)))
            if label < 0:
                failures += 1
                history.append(Observation(c, status="infeasible", cost=1.0))
            else:
                found.add(label)
                history.append(Observation(c, value=1.0, features=features, cost=1.0))
            curve.append(len(found))
    U = np.array([space.to_unit(o.candidate.params) for o in history[:evaluations]])
    E = space.encode(U)
    gaps = np.linalg.norm(E[:, None] - E[None], axis=2) + np.eye(len(E)) * 9
    straight = ~(space.is_periodic() | space.is_categorical())
    return {
        "config": config,
        "problem": problem,
        "seed": seed,
        "evaluations": evaluations,
        "curve": curve[:evaluations],
        "failures": failures,
        "duplicates": float(np.mean([gaps[i, :i].min() < 0.05 for i in range(1, len(E))])),
        "faces": float(np.mean((U[:, straight] < 1e-3) | (U[:, straight] > 1 - 1e-3))) if straight.any() else 0.0,
        "seconds": seconds / evaluations * batch,
    }


def _job(arguments: tuple[Any, ...]) -> dict[str, Any]:
    return run_one(*arguments)


def run_all(
    configs: dict[str, Any],
    problems: list[str],
    seeds: int,
    evaluations: int,
    processes: int,
    path: Path,
    *,
    run: bool = True,
) -> list[dict[str, Any]]:
    """All runs, those on disk included; those on disk alone where nothing shall run."""
    path.parent.mkdir(parents=True, exist_ok=True)
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    wanted = {(c, p, s) for c in configs for p in problems for s in range(seeds)}
    have = {(r["config"], r["problem"], r["seed"]): r for r in done if r["evaluations"] >= evaluations}
    if not run:
        return whole_seeds([have[k] for k in sorted(wanted & set(have))], problems)
    todo = sorted(wanted - set(have), key=lambda k: (k[2], k[1], k[0]))  # seed by seed: what is done is balanced
    jobs = [(c, *configs[c], p, s, evaluations) for (c, p, s) in todo]
    with path.open("a") as out, ProcessPoolExecutor(processes) as pool:
        for r in pool.map(_job, jobs, chunksize=2):
            have[r["config"], r["problem"], r["seed"]] = r
            out.write(json.dumps(r) + "\n")
            out.flush()
    return [have[k] for k in sorted(wanted)]


def interval(values: np.ndarray, rng: np.random.Generator) -> tuple[float, float, float]:
    """Mean and a 95 % bootstrap interval."""
    means = rng.choice(values, (2000, len(values))).mean(1)
    return float(values.mean()), float(np.quantile(means, 0.025)), float(np.quantile(means, 0.975))


def whole_seeds(results: list[dict[str, Any]], problems: list[str]) -> list[dict[str, Any]]:
    """The runs of those seeds for which a configuration has every problem: a study that was cut short is no mean."""
    have: dict[tuple[str, int], set[str]] = {}
    for r in results:
        have.setdefault((r["config"], r["seed"]), set()).add(r["problem"])
    return [r for r in results if r["problem"] in problems and have[r["config"], r["seed"]] >= set(problems)]


def base_of(config: str, configs: Sequence[str], first: str) -> str:
    """What a configuration is compared with: an ablation with what it was taken from, all others with `first`."""
    return first if config in configs else max((c for c in configs if config.startswith(c)), key=len, default=first)


def paired(
    results: list[dict[str, Any]], configs: Sequence[str], first: str, figure: Callable[[dict[str, Any]], list[float]]
) -> None:
    """Differences to what each configuration is compared with, on the seeds that both have."""
    print(f"\n{'':28s}paired by seed: mean difference (standard error)")
    per: dict[str, dict[int, np.ndarray]] = {}
    for c in dict.fromkeys(r["config"] for r in results):
        seeds = sorted({r["seed"] for r in results if r["config"] == c})
        per[c] = {
            s: np.mean([figure(r) for r in results if r["config"] == c and r["seed"] == s], axis=0) for s in seeds
        }
    for c, mine in per.items():
        base = base_of(c, configs, first)
        shared = [s for s in mine if s in per.get(base, {})]
        if base == c or len(shared) < 2:
            continue
        gaps = np.array([mine[s] - per[base][s] for s in shared])
        errors = gaps.std(0, ddof=1) / np.sqrt(len(gaps))
        told = "".join(f"{m:10.3f} ({e:.3f})" for m, e in zip(gaps.mean(0), errors, strict=True))
        print(f"{c:28s}{told}   to {base}, {len(shared)} seeds")


def table(results: list[dict[str, Any]], problems: list[str], at: tuple[int, ...], title: str) -> None:
    """Means over problems and seeds; intervals from resampling seeds (each seed's mean over problems)."""
    configs = list(dict.fromkeys(r["config"] for r in results))
    print(f"\n{title}: distinct strategies, mean over {len(problems)} maps [95 % interval over seeds]")
    print(
        f"{'':28s}"
        + "".join(f"{f'after {n}':>24s}" for n in at)
        + f"{'x random':>10s}{'failed':>8s}{'dup':>6s}{'faces':>7s}{'s/ask':>7s}{'seeds':>6s}"
    )
    base = None
    order = sorted(configs, key=lambda c: (c != "random", c))
    for c in order:
        rows = [r for r in results if r["config"] == c and r["problem"] in problems]
        line = f"{c:28s}"
        for n in at:
            seeds = sorted({r["seed"] for r in rows})
            per_seed = np.array([np.mean([r["curve"][n - 1] for r in rows if r["seed"] == s]) for s in seeds])
            mean, low, high = interval(per_seed, np.random.default_rng(0))
            line += f"{mean:10.2f} [{low:.2f}, {high:.2f}]"
            if n == at[0]:
                base = mean if base is None else base
                ratio = mean / base
        line += (
            f"{ratio:10.2f}{np.mean([r['failures'] for r in rows]):8.1f}{np.mean([r['duplicates'] for r in rows]):6.2f}"
        )
        line += f"{np.mean([r['faces'] for r in rows]):7.2f}{np.mean([r['seconds'] for r in rows]):7.2f}"
        print(f"{line}{len(seeds):6d}")


def per_problem(results: list[dict[str, Any]], problems: list[str], n: int) -> None:
    """The same for each map."""
    configs = sorted({r["config"] for r in results})
    print(f"\nafter {n}, by map\n{'':28s}" + "".join(f"{c[:17]:>18s}" for c in configs))
    for p in problems:
        means = [
            np.mean([r["curve"][n - 1] for r in results if r["config"] == c and r["problem"] == p]) for c in configs
        ]
        print(f"{p:28s}" + "".join(f"{m:18.2f}" for m in means))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set", choices=tuple(SETS), default="report")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--evaluations", type=int, default=30)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--configs", default="", help="comma-separated names; all where empty")
    parser.add_argument(
        "--extra", default="", help="JSON: name -> [strategy, settings, batch], tried beside the others"
    )
    parser.add_argument("--ablations", action="store_true")
    parser.add_argument("--print", action="store_true", help="run nothing, print what is on disk, seeds told by row")
    parser.add_argument("--quick", action="store_true", help="3 seeds, 10 evaluations, 4 maps")
    parser.add_argument("--out", type=Path, default=RESULTS / "diversity.jsonl")
    args = parser.parse_args()
    problems = [m.name for m in SETS[args.set]]
    if args.quick:
        args.seeds, args.evaluations, problems = 3, 10, problems[:4]
        args.out = RESULTS / "diversity-quick.jsonl"
        args.out.unlink(missing_ok=True)
    everything = {**CONFIGS, **ABLATIONS, **{k: tuple(v) for k, v in json.loads(args.extra or "{}").items()}}
    names = [n for n in args.configs.split(";") if n] or [*CONFIGS, *(ABLATIONS if args.ablations else ())]
    names += [n for n in json.loads(args.extra or "{}") if n not in names]
    results = run_all(
        {n: everything[n] for n in names},
        problems,
        args.seeds,
        args.evaluations,
        args.processes,
        args.out,
        run=not args.print,
    )
    at = tuple(n for n in (10, 20, 30) if n <= args.evaluations)
    table(results, problems, at, f"{args.set} maps, {args.seeds} seeds")
    paired(results, list(CONFIGS), "bds", lambda r: [r["curve"][n - 1] for n in at])
    inside = [p for p in problems if p in INTERIOR or p.endswith("interior")]
    if inside:
        table(results, inside, at, "maps with interior strategies only")
    per_problem(results, problems, at[0])


if __name__ == "__main__":
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"
    main()
