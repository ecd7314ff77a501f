"""Which parameters matter."""

from __future__ import annotations

from matplotlib.figure import Figure

from services.figures.shown import Shown
from services.figures.style import ACCENT, COLUMN, INK, NotApplicable, legend_above, new_figure, symbol
from services.insight import importance_json


def draw_importance(shown: Shown) -> Figure:
    """Importance by permutation with its 95 % interval, and the share of the inverse length scales beside it."""
    told = importance_json(shown.looked)
    parameters = sorted(told["parameters"], key=lambda one: one["permutation"])
    if not parameters:
        raise NotApplicable(told["note"])
    places = range(len(parameters))
    figure = new_figure(COLUMN, 0.95 + 0.27 * len(parameters))
    axes = figure.subplots()
    axes.barh(places, [one["permutation"] for one in parameters], height=0.55, color=ACCENT, alpha=0.85,
              label="by permutation, 95 % interval")  # fmt: skip
    for place, one in zip(places, parameters, strict=True):
        axes.errorbar(
            [sum(one["interval"]) / 2], [place], xerr=[(one["interval"][1] - one["interval"][0]) / 2], fmt="none",
            ecolor=INK, elinewidth=0.8, capsize=2, capthick=0.8,
        )  # fmt: skip
    axes.scatter(
        [one["from_length_scales"] for one in parameters], list(places), marker="D", s=18, c="#d55e00",
        edgecolors="white", linewidths=0.5, zorder=4, label="by length scale",
    )  # fmt: skip
    axes.set_yticks(list(places), labels=[symbol(one["name"]) for one in parameters])
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(f"share of the {told['of']}'s variance; of all lengths")
    legend_above(figure, axes)
    return figure
