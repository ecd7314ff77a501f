"""What foresight is worth on the maps: a searcher that knows which family of worlds it is in, beside random points.

    python -m benchmarks.search.ceiling

It is given what no search has: many other worlds drawn by the same recipe as the map (family, dimension, shares,
failures), and after each trial which strategy of that recipe was hit. It holds a posterior over those worlds (a world
that predicted another outcome loses a factor) and always asks the point that most probably shows a new strategy. The
truth is one world more, not among them. With finitely many worlds this is not an upper bound; it tells what is within
reach of a search whose prior is right, where a search for unknown maps must do with a prior that is vague.
"""

from __future__ import annotations

import argparse
import dataclasses
import json

import numpy as np

from benchmarks.search.map_sets import REPORT
from benchmarks.search.maps import StrategyMap, World

POINTS = 1024
"""Points that may be asked."""
MISS = 0.15
"""Factor of a world that predicted another outcome."""


def found_by(m: StrategyMap, worlds: int, truths: int, evaluations: int) -> tuple[float, float]:
    """Mean numbers of distinct strategies in held-out worlds: of the searcher, and of random points."""
    first = World(m, POINTS)
    labels = np.empty((worlds + truths, POINTS), dtype=np.int8)
    for i in range(len(labels)):
        labels[i] = World(dataclasses.replace(m, name=f"{m.name}-{i}"), POINTS, like=first).labels(first.sample)
    known, knowing, chance = labels[:worlds], [], []
    for t, truth in enumerate(labels[worlds:]):
        rng = np.random.default_rng(t)
        log_weight, seen = np.zeros(worlds), np.zeros(m.count + 1, dtype=bool)
        seen[-1] = True  # label -1, a failure, is nothing new
        new = known >= 0
        for _ in range(evaluations):
            weight = np.exp(log_weight - log_weight.max()).astype(np.float32)
            at = int(np.argmax(weight @ new + 1e-6 * rng.random(POINTS)))
            outcome = -1 if rng.random() < m.flaky else int(truth[at])
            if not seen[outcome]:
                seen[outcome] = True
                new &= known != outcome
            new[:, at] = False
            log_weight += np.where(known[:, at] == outcome, 0.0, np.log(MISS))
        knowing.append(seen[:-1].sum())
        drawn = truth[rng.integers(0, POINTS, (20, evaluations))]
        drawn = np.where(rng.random(drawn.shape) < m.flaky, -1, drawn)
        chance.append(np.mean([len(set(row[row >= 0].tolist())) for row in drawn]))
    return float(np.mean(knowing)), float(np.mean(chance))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=1500)
    parser.add_argument("--truths", type=int, default=100)
    parser.add_argument("--evaluations", type=int, default=10)
    args = parser.parse_args()
    rows = []
    for m in REPORT:
        rows.append(found_by(m, args.worlds, args.truths, args.evaluations))
        print(json.dumps({"map": m.name, "knowing": rows[-1][0], "random": rows[-1][1]}), flush=True)
    knowing, chance = np.mean(rows, axis=0)
    print(f"mean: knowing {knowing:.2f}, random {chance:.2f}, ratio {knowing / chance:.2f}")


if __name__ == "__main__":
    main()
