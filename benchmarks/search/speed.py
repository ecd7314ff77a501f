"""Seconds and memory of one proposal in a running study, by length of its history, on one core; Optuna's beside them.

    python -m benchmarks.search.speed                                   # the whole table, ten minutes
    python -m benchmarks.search.speed --sizes 1000 --proposals 20 --cases "bds, circle;cmfbo;Optuna TPE"

Each row is a process of its own, with numerics on one thread. It begins with a history of the given length and goes on
as a study does: every proposal's outcome is told, `PENDING` proposals later, so fits are kept and made anew as they
are in use. "memory" is how far the process's peak rose above what it held before the first proposal: what a search
needs on top of its history. Optuna's samplers run as they come, on a study in memory.
"CPU" is what the process used; on a machine with other work, wall seconds say how much of that there was.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from search import Angle, Candidate, Categorical, Features, Float, Int, Observation, Space, make_strategy

PENDING = 3
"""How many trials of the study are always running."""
SLOW = "Optuna GPSampler"
"""Its time grows with the cube of the history: it makes 10 proposals, and none beyond `SLOW_SIZE` unless told to."""
SLOW_SIZE = 1000
LARGE = 5000
"""Beyond so many observations a tenth of the proposals is made: such a row is there for its memory."""

PLAIN = Space({"alpha": Angle(), **{f"x{i}": Float(0, 1) for i in range(5)}})
MIXED = Space(
    {
        "rate": Float(1e-5, 1e-1, log=True),
        "layers": Int(1, 6),
        "width": Int(16, 512, log=True),
        "kind": Categorical(("relu", "tanh", "elu")),
        "clip": Float(0.02, 0.4),
        "epochs": Int(1, 12),
    }
)
TILT = np.random.default_rng(1).standard_normal((6, 4))

CASES: dict[str, tuple[str, Space, Features | None]] = {
    "bds, circle": ("bds", PLAIN, Features.circle()),
    "bds, rotation": ("bds", PLAIN, Features.rotation()),
    "cmfbo": ("cmfbo", PLAIN, None),
    "cmfbo, mixed": ("cmfbo", MIXED, None),
    "Optuna TPE": ("tpe", PLAIN, None),
    "Optuna GPSampler": ("gp", PLAIN, None),
}
"""Row -> strategy or sampler, space, behaviours."""


def outcome(space: Space, features: Features | None, c: Candidate, rng: np.random.Generator) -> Observation:
    """A smooth objective and behaviour with noise, a fifth of failures, cost by difficulty."""
    u, z = space.to_unit(c.params), 1.0 if c.z is None else c.z
    cost = 0.1 + 0.9 * z
    if rng.random() < 0.2:
        return Observation(c, status="failed", cost=cost)
    behaviour: list[float] | None = None
    if features is not None and features.kind == "circle":
        behaviour = [float(3 * np.sin(3 * u[0] + u[1:3].sum()))]
    elif features is not None:
        q = np.array([0, 0, 0, 1.0]) + np.sin(2 * (u - 0.5) @ TILT)
        behaviour = (q / np.linalg.norm(q)).tolist()
    value = -float(np.square(u - 0.4).sum()) * (2 - z) + 0.5 * (1 - z) + 0.02 * float(rng.standard_normal())
    return Observation(c, value, behaviour, cost)


def history(space: Space, features: Features | None, n: int, fidelity: bool) -> list[Observation]:
    """A study of `n` trials: without behaviours half of them near a good place; easy ones where asked for."""
    rng = np.random.default_rng(0)
    U = rng.random((n, space.d))
    near = rng.random(n) < (0.5 if features is None else 0.0)
    U = np.where(near[:, None], np.clip(0.4 + 0.1 * rng.standard_normal(U.shape), 0, 1), U)
    levels = rng.choice([0.1, 0.2, 0.5, 1.0], n)
    return [
        outcome(space, features, Candidate(space.from_unit(u), z=float(z) if fidelity else None), rng)
        for u, z in zip(U, levels, strict=True)
    ]


def drive_strategy(case: str, n: int) -> Callable[[int], None]:
    """One proposal of one of our strategies, its outcome told later."""
    name, space, features = CASES[case]
    told = history(space, features, n, name == "cmfbo")
    made = make_strategy(name, space, features=features)
    running: list[Candidate] = []
    outcomes = np.random.default_rng(1)

    def propose(i: int) -> None:
        if len(running) >= PENDING:
            told.append(outcome(space, features, running.pop(0), outcomes))
        running.extend(made.propose(told, running, 1, np.random.default_rng(i)))

    return propose


def drive_optuna(case: str, n: int) -> Callable[[int], None]:
    """One proposal of a sampler of Optuna's, its outcome told later."""
    import optuna  # noqa: PLC0415  # our own rows shall not pay for it

    from search.baselines.optuna import distributions  # noqa: PLC0415  # the same

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    name, space, _ = CASES[case]
    sampler = optuna.samplers.TPESampler(seed=0) if name == "tpe" else optuna.samplers.GPSampler(seed=0)
    study = optuna.create_study(direction="maximize", sampler=sampler)
    known = distributions(space)
    for o in history(space, None, n, fidelity=False):
        state = optuna.trial.TrialState.COMPLETE if o.status == "complete" else optuna.trial.TrialState.FAIL
        params = dict(o.candidate.params)
        study.add_trial(optuna.trial.create_trial(state=state, params=params, distributions=known, value=o.value))
    running: list[optuna.Trial] = []
    outcomes = np.random.default_rng(1)

    def propose(i: int) -> None:  # noqa: ARG001  # Optuna keeps its own randomness
        if len(running) >= PENDING:
            trial = running.pop(0)
            o = outcome(space, None, Candidate(trial.params), outcomes)
            study.tell(trial, o.value, state=None if o.value is not None else optuna.trial.TrialState.FAIL)
        running.append(study.ask(known))

    return propose


def memory(field: str) -> float:
    """A memory figure of this process in MiB: `VmRSS` now, `VmHWM` at its peak."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field):
            return float(line.split()[1]) / 1024
    raise OSError(f"expected {field} in /proc/self/status, found none")


def measure(case: str, n: int, proposals: int) -> dict[str, Any]:
    """One row, measured in this process. A first proposal warms up and is not counted: it loads libraries."""
    propose = drive_optuna(case, n) if case.startswith("Optuna") else drive_strategy(case, n)
    if case == SLOW:
        proposals = min(proposals, 10) if n <= SLOW_SIZE else 0
    if n > LARGE:
        proposals = -(-proposals // 10)
    before = memory("VmRSS")
    cpu: list[float] = []
    wall: list[float] = []
    for i in range(proposals + 1):
        c0, w0 = time.process_time(), time.perf_counter()
        propose(i)
        cpu.append(time.process_time() - c0)
        wall.append(time.perf_counter() - w0)
    counted = slice(1, None) if len(cpu) > 1 else slice(None)
    return {
        "case": case,
        "n": n,
        "first": cpu[0],
        "cpu": cpu[counted],
        "wall": wall[counted],
        "memory": memory("VmHWM") - before,
    }


def line(row: dict[str, Any]) -> str:
    """A row of the table."""
    cpu, wall = np.array(row["cpu"]), np.array(row["wall"])
    return (
        f"{row['case']:18s}{row['n']:7d}{len(cpu):6d}"
        f"{np.median(cpu):10.3f}{np.quantile(cpu, 0.99):8.3f}{cpu.max():8.3f}"
        f"{np.median(wall):10.3f}{np.quantile(wall, 0.99):8.3f}{row['first']:9.3f}{row['memory']:9.0f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", default="1000,5000,10000")
    parser.add_argument("--cases", default=";".join(CASES), help="rows, separated by semicolons")
    parser.add_argument("--proposals", type=int, default=100)
    parser.add_argument("--patient", action="store_true", help=f"{SLOW} beyond {SLOW_SIZE} observations, too")
    parser.add_argument("--quick", action="store_true", help="10 proposals, two sizes, without the slowest")
    parser.add_argument("--row", nargs=2, metavar=("CASE", "N"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.row:
        print(json.dumps(measure(args.row[0], int(args.row[1]), args.proposals)))
        return
    if args.quick:
        args.sizes, args.proposals, args.cases = "100,1000", 10, ";".join(c for c in CASES if c != SLOW)
    print(f"{'':25s}{'':6s}{'CPU seconds a proposal':>26s}{'wall seconds':>18s}{'CPU':>9s}{'MiB':>9s}")
    head = ("", "n", "of", "median", "p99", "max", "median", "p99", "first", "memory")
    print("".join(f"{h:>{w}s}" for h, w in zip(head, (18, 7, 6, 10, 8, 8, 10, 8, 9, 9), strict=True)), flush=True)
    for case in args.cases.split(";"):
        for n in map(int, args.sizes.split(",")):
            command = [sys.executable, "-m", "benchmarks.search.speed", "--proposals", str(args.proposals)]
            if case == SLOW and n > SLOW_SIZE and not args.patient:
                continue
            told = subprocess.run([*command, "--row", case, str(n)], stdout=subprocess.PIPE, text=True, check=True)
            print(line(json.loads(told.stdout)), flush=True)


if __name__ == "__main__":
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"
    main()
