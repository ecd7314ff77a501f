"""Curves of the raw results: distinct strategies by evaluations, fraction of the optimum by cost.

python -m benchmarks.search.draw            # writes diversity.png and quality.png beside the raw results
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt  # the backend is chosen first: there may be no display

from benchmarks.search import diversity, map_sets, objectives, quality
from benchmarks.search.diversity import RESULTS


def complete(rows: list[dict[str, Any]], wanted: Sequence[str], problems: Sequence[str]) -> dict[str, list[Any]]:
    """Runs by configuration: of the seeds for which it has every problem, their number told where others have more."""
    by = {(r["config"], r["problem"], r["seed"]): r for r in rows}
    seeds = {c: sorted({s for d, _, s in by if d == c and all((c, p, s) in by for p in problems)}) for c in wanted}
    most = max(map(len, seeds.values()))
    return {
        c if len(whole) == most else f"{c} ({len(whole)} seeds)": [by[c, p, s] for s in whole for p in problems]
        for c, whole in seeds.items()
        if whole
    }


def draw(
    path: Path,
    x: np.ndarray | None,
    key: str,
    labels: tuple[str, str],
    configs: Sequence[str],
    problems: Sequence[str],
) -> None:
    """One figure: means, with the standard error over problems and seeds as a band."""
    if not path.exists():
        print(f"nothing at {path}: no figure")
        return
    runs = complete([json.loads(line) for line in path.read_text().splitlines()], configs, problems)
    figure, axes = plt.subplots(figsize=(9, 5))
    curves = {config: np.array([r[key] for r in rows], dtype=float) for config, rows in runs.items()}
    # in the order in which they end, as the legend beside them; ten colours, then the same with dashes
    for i, (config, Y) in enumerate(sorted(curves.items(), key=lambda each: -each[1][:, -1].mean())):
        at = np.arange(1, Y.shape[1] + 1) if x is None else x
        mean, error = Y.mean(0), Y.std(0) / np.sqrt(len(Y))
        (line,) = axes.plot(at, mean, label=config, color=f"C{i % 10}", linestyle="-" if i < 10 else "--")
        axes.fill_between(at, mean - error, mean + error, color=line.get_color(), alpha=0.15)
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    figure.tight_layout()
    figure.savefig(path.with_suffix(".png"), dpi=120)
    print(path.with_suffix(".png"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=Path, default=RESULTS)
    args = parser.parse_args()
    draw(
        args.results / "diversity.jsonl",
        None,
        "curve",
        ("evaluations", "distinct strategies"),
        list(diversity.CONFIGS),
        [m.name for m in map_sets.REPORT],
    )
    draw(
        args.results / "quality.jsonl",
        np.array(quality.GRID),
        "at",
        ("cost, full evaluations", "fraction of the optimum"),
        list(quality.CONFIGS),
        [o.name for o in objectives.REPORT],
    )


if __name__ == "__main__":
    main()
