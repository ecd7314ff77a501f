"""Seconds and memory of one proposal, by length of the history, on one core.

python -m benchmarks.search.speed
python -m benchmarks.search.speed --sizes 1000 --repeats 100 --strategies bds,cmfbo,gp,tpe
"""

from __future__ import annotations

import argparse
import os
import resource
import time

import numpy as np

from search import Angle, Candidate, Features, Float, Observation, Space, make_strategy


def history(space: Space, n: int, metric: Features, fidelity: bool) -> list[Observation]:
    """Random points of a smooth objective with failures and, where asked for, difficulties."""
    rng = np.random.default_rng(0)
    out = []
    for u in rng.random((n, space.d)):
        z = float(rng.choice([0.2, 0.5, 1.0])) if fidelity else None
        c = Candidate(space.from_unit(u), z=z)
        if rng.random() < 0.2:
            out.append(Observation(c, status="failed", cost=0.5))
            continue
        y = np.sin(3 * u[0] + u[1:3].sum())
        features = [float(3 * y)] if metric.kind == "circle" else None
        value = float(-np.square(u - 0.4).sum() + 0.05 * rng.standard_normal())
        out.append(Observation(c, value, features, cost=1.0))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", default="100,1000,5000")
    parser.add_argument("--strategies", default="bds,cmfbo")
    parser.add_argument("--repeats", type=int, default=20)
    args = parser.parse_args()
    space = Space({"alpha": Angle(), **{f"x{i}": Float(0, 1) for i in range(5)}})
    metric = Features.circle()
    print(
        f"6 parameters, CPU seconds a proposal (wall seconds), {args.repeats} proposals each after one observation more"
    )
    for name in args.strategies.split(","):
        for n in map(int, args.sizes.split(",")):
            whole = history(space, n + args.repeats, metric, name == "cmfbo")
            made = make_strategy(name, space, features=metric)
            cpu, wall = [], []
            for i in range(args.repeats):
                c0, w0 = time.process_time(), time.perf_counter()
                made.propose(whole[: n + i], [], 1, np.random.default_rng(i))
                cpu.append(time.process_time() - c0)
                wall.append(time.perf_counter() - w0)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(
                f"{name:8s} n = {n:5d}  median {np.median(cpu):.3f} ({np.median(wall):.3f})  "
                f"p99 {np.quantile(cpu, 0.99):.3f} ({np.quantile(wall, 0.99):.3f})  peak memory so far {peak:.0f} MiB",
                flush=True,
            )


if __name__ == "__main__":
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"
    main()
