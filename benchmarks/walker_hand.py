"""Whether easy versions of the walker tell which bodies are good, by how strong the helping hand is.

    OMP_NUM_THREADS=1 python -m benchmarks.walker_hand --bodies 16

Sobol bodies, trained under the quick profile of `studies/walker_morphology.yaml`, with each hand: once at z = 0.1,
twice at z = 1 with other seeds. Printed are mean values, and Spearman's rank correlation of what a body comes to at
z = 0.1 with the mean of its two trainings at z = 1; beside it how well these two foretell each other, which cost five
times as much each.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from benchmarks.tuning import STUDIES
from search.designs import sobol_points
from services.spec import ResolvedSpec
from services.spec_check import load_study
from services.translate import search_space
from workers.contracts import Job, Scalar
from workers.local_context import LocalContext
from workers.run import run

HANDS = (40.0, 15.0, 4.0)
"""1/s^2."""
EASY = 0.1


def study(hand: float) -> ResolvedSpec:
    """The study in its quick profile, with another hand."""
    return load_study(STUDIES / "walker_morphology.yaml", ["profile=quick", f"task.settings.hand={hand}"])


def value(spec: ResolvedSpec, body: dict[str, Scalar], z: float, seed: int) -> float:
    """Of one training; one that diverged is worth nothing."""
    job = Job(spec.name, 0, spec.task.name, body, seed, spec.task.settings, spec.training, z)
    with tempfile.TemporaryDirectory() as folder:
        return run(job, LocalContext(Path(folder))).value or 0.0


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--bodies", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0, help="of the bodies, and the first of their trainings")
    options = parser.parse_args(arguments)
    space = search_space(study(HANDS[0]))
    bodies = [space.from_unit(u) for u in sobol_points(space, 0, options.bodies, options.seed)]
    print(f"{len(bodies)} bodies, seed {options.seed}; rank correlation with the mean of two trainings at z = 1")
    print(f"{'hand':>6s}{f'z = {EASY}':>10s}{'z = 1':>8s}{'easy tells':>12s}{'one tells the other':>21s}{'s':>6s}")
    for hand in HANDS:
        began, spec, seed = time.perf_counter(), study(hand), 10 * options.seed
        easy = [value(spec, body, EASY, seed) for body in bodies]
        one, two = ([value(spec, body, 1.0, seed + k) for body in bodies] for k in (1, 2))
        real = np.mean([one, two], axis=0)
        told, again = spearmanr(easy, real).statistic, spearmanr(one, two).statistic
        seconds = time.perf_counter() - began
        line = f"{hand:6g}{np.mean(easy):10.3f}{real.mean():8.3f}{told:12.2f}{again:21.2f}{seconds:6.0f}"
        print(line, flush=True)


if __name__ == "__main__":
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"
    main()
