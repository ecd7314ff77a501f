"""A search over difficulties: the values found at each, what each cost, and whose policy was handed on."""

from __future__ import annotations

from itertools import pairwise

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from services.fidelity import gathered
from services.figures.shown import Shown, levels_of, values_of
from services.figures.style import (
    MARKS,
    PAGE,
    SOFT,
    NotApplicable,
    counts,
    legend_above,
    new_figure,
    titled,
    whole,
)
from services.states import OBSERVED_TRIAL
from services.store.port import TrialRow

COMPLETE = "#0b6fa4"


def draw_ladder(shown: Shown) -> Figure:
    """Value against difficulty, cost by level, and the lineage of policies."""
    trials = [trial for trial in shown.trials if trial.z is not None]
    if not trials:
        raise NotApplicable("no trial has a difficulty")
    handed_on = any(trial.warm_start is not None for trial in trials)
    figure = new_figure(PAGE, 2.4)
    panels = figure.subplots(1, 3 if handed_on else 2)
    _values(figure, panels[0], shown, trials)
    _costs(panels[1], trials)
    if handed_on:
        _lineage(panels[2], trials)
    return figure


def _values(figure: Figure, axes: Axes, shown: Shown, trials: list[TrialRow]) -> None:
    for state, mark in MARKS.items():
        of = [trial for trial in trials if trial.state is state and trial.value is not None]
        if of:
            axes.scatter(levels_of(of), values_of(of), label=state.value, **mark)
    axes.set_xlabel("difficulty z")
    axes.set_ylabel(titled(shown.value.name, shown.value.unit))
    axes.set_xlim(-0.05, 1.05)
    legend_above(figure, axes)


def _costs(axes: Axes, trials: list[TrialRow]) -> None:
    levels = gathered(trials)
    places = [level["z"] for level in levels]
    gaps = [after - before for before, after in pairwise(places)]
    bars = axes.bar(places, [level["samples"] for level in levels], width=min([0.08, *(0.7 * gap for gap in gaps)]),
                    color=COMPLETE, alpha=0.85)  # fmt: skip
    axes.bar_label(bars, [str(level["trials"]) for level in levels], fontsize=6.5, color=SOFT, padding=1.5)
    axes.set_xlabel("difficulty z")
    axes.set_ylabel("samples (control steps)")
    axes.set_xlim(-0.05, 1.05)
    axes.margins(y=0.12)
    axes.grid(visible=False, axis="x")
    axes.set_title("number of trials above each bar", fontsize=7, color=SOFT, loc="left")
    counts(axes, "y")


def _lineage(axes: Axes, trials: list[TrialRow]) -> None:
    known = {trial.number: trial for trial in trials}
    for child in trials:
        parent = known.get(child.warm_start) if child.warm_start is not None else None
        if parent is None or parent.z is None or child.z is None:
            continue
        (x1, y1), (x2, y2) = (parent.number, parent.z), (child.number, child.z)
        # Between trials of one level a curve has to bow, or all would lie on one line.
        bow = (-0.22 if y1 > 0.5 else 0.22) * min(1.0, (x2 - x1) / 8) if abs(y1 - y2) < 0.04 else 0.0
        middle = (x1 + x2) / 2
        curve = Path(
            [(x1, y1), (middle, y1 + bow), (middle, y2 + bow), (x2, y2)],
            [Path.MOVETO, Path.CURVE4, Path.CURVE4, Path.CURVE4],
        )
        axes.add_patch(PathPatch(curve, facecolor="none", edgecolor=SOFT, lw=0.6, alpha=0.6, zorder=1))
    for state, mark in MARKS.items():
        of = [trial for trial in trials if trial.state is state]
        if of:
            axes.scatter([trial.number for trial in of], levels_of(of), zorder=2, **mark)
    still = [trial for trial in trials if trial.state not in OBSERVED_TRIAL]
    if still:
        axes.scatter([t.number for t in still], levels_of(still), marker="o", s=14, facecolors="none",
                     edgecolors=SOFT, linewidths=0.8, zorder=2)  # fmt: skip
    axes.set_xlabel("trial")
    axes.set_ylabel("difficulty z")
    axes.set_ylim(-0.05, 1.05)
    axes.margins(x=0.04)
    axes.set_title("curves: whose policy was handed on", fontsize=7, color=SOFT, loc="left")
    whole(axes)
