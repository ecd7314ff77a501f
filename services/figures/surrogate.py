"""What the search believes: a slice of its surrogate, mean and uncertainty, with what was tried there."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from services.figures.shown import Shown
from services.figures.style import (
    ACCENT,
    COLUMN,
    FIELD,
    MARKS,
    PAGE,
    SOFT,
    UNSURE,
    NotApplicable,
    legend_above,
    logarithmic,
    new_figure,
    plain,
    signed,
    symbol,
    titled,
)
from services.insight import next_proposal, open_json, slice_json, with_defaults
from services.states import TrialState

SIZE = 60
"""Grid points along each axis."""
NEXT, OVER = "#12b88c", "#f2641c"
"""The next proposal and failures: seen on every colour of both scales."""


def slice_told(shown: Shown) -> dict[str, Any]:
    """The slice that the page shows first: the parameters that matter most, the others at the best."""
    from search.insight.slices import Ask  # noqa: PLC0415 - scipy

    looked = shown.looked
    ask = with_defaults(looked, Ask(x="", y="", output="", at={}, z=1.0, size=SIZE))
    pending = [trial for trial in shown.trials if trial.state in {TrialState.QUEUED, TrialState.RUNNING}]
    proposal = next_proposal(looked, pending, len(shown.trials))
    return {**slice_json(looked, ask), **open_json(looked, ask, pending, proposal)}


def draw_slice(shown: Shown) -> Figure:
    """Mean and standard deviation over the two parameters that matter most; over one, a line with its band."""
    told = slice_told(shown)
    if not told["mean"]:
        raise NotApplicable(told["note"] or "the surrogate knows nothing yet")
    if told["y"] is None or told["x"]["scale"] == "category" or told["y"]["scale"] == "category":
        return _line(told)
    figure = new_figure(PAGE, 2.75)
    panels = figure.subplots(1, 2, sharey=True)
    deviation = {"label": "standard deviation", "unit": told["output"]["unit"]}
    fields = (
        (told["mean"], FIELD, labelled(told["output"])),
        (told["deviation"], UNSURE, labelled(deviation)),
    )
    for axes, (matrix, colours, words) in zip(panels, fields, strict=True):
        places = told["x"]["values"], told["y"]["values"]
        mesh = axes.pcolormesh(*places, np.array(matrix), cmap=colours, rasterized=True, shading="gouraud")
        bar = figure.colorbar(mesh, ax=axes, pad=0.02, aspect=24)
        bar.set_label("\n".join(wrap(words, 28)))
        bar.outline.set_visible(False)
        _tried(axes, told)
        for which in ("x", "y"):
            if told[which]["scale"] == "log":
                logarithmic(axes, which, told[which]["values"][0], told[which]["values"][-1])
        axes.set_xlabel(titled(told["x"]["name"], told["x"]["unit"]))
        axes.grid(visible=False)
    panels[0].set_ylabel(titled(told["y"]["name"], told["y"]["unit"]))
    legend_above(figure, panels[0])
    rest = ", ".join(_at(shown, name, value) for name, value in told["others"].items())
    if rest:
        figure.supxlabel("\n".join(wrap(f"at {rest}", 130)), fontsize=6.5, color=SOFT)
    return figure


def _at(shown: Shown, name: str, value: Any) -> str:
    """A parameter that stays: `ω = 1.64 rad`."""
    words = plain(value) if isinstance(value, str) else signed(f"{value:.3g}")
    return f"{symbol(name)} = {words} {plain(shown.unit(name))}".rstrip()


def labelled(output: Mapping[str, str]) -> str:
    """Label and unit of what a slice shows."""
    return plain(f"{output['label']} ({output['unit']})" if output["unit"] else output["label"])


def _tried(axes: Axes, told: dict[str, Any]) -> None:
    """Samples, the closer to the slice the stronger; what is open; what would be next."""
    for state, mark in MARKS.items():
        of = [sample for sample in told["samples"] if sample["state"] == state.value]
        if not of:
            continue
        strength = [0.25 + 0.75 * sample["near"] for sample in of]
        complete = state is TrialState.COMPLETE
        edges = [to_rgba("black" if complete else OVER, alpha) for alpha in strength]
        if complete:
            colours: dict[str, Any] = {
                "facecolors": [to_rgba("white", alpha) for alpha in strength],
                "edgecolors": edges,
            }
        elif state is TrialState.INFEASIBLE:
            colours = {"facecolors": ["none"] * len(of), "edgecolors": edges}
        else:
            colours = {"c": edges}
        axes.scatter([s["x"] for s in of], [s["y"] for s in of], marker=mark["marker"], s=15, label=state.value,
                     linewidths=0.5 if complete else 0.9, clip_on=False, zorder=3, **colours)  # fmt: skip
    if told["pending"]:
        axes.scatter([one["x"] for one in told["pending"]], [one["y"] for one in told["pending"]], marker="o", s=18,
                     facecolors="none", edgecolors=NEXT, linewidths=1.1, label="pending", clip_on=False)  # fmt: skip
    if told["next"] is not None:
        axes.scatter([told["next"]["x"]], [told["next"]["y"]], marker="*", s=70, c=NEXT, edgecolors="white",
                     linewidths=0.6, label="next proposal", clip_on=False, zorder=4)  # fmt: skip


def _line(told: dict[str, Any]) -> Figure:
    """One parameter: the mean with two standard deviations to either side. Choices stand side by side."""
    figure = new_figure(COLUMN, 2.4)
    axes = figure.subplots()
    x = told["x"]
    category = x["scale"] == "category"
    places = list(range(len(x["values"]))) if category else x["values"]
    row = len(told["mean"]) // 2
    mean, deviation = np.array(told["mean"][row]), np.array(told["deviation"][row])
    if category:
        axes.errorbar(places, mean, yerr=2 * deviation, fmt="o", color=ACCENT, ms=3, capsize=2, elinewidth=0.8,
                      label="mean ± 2 s.d.")  # fmt: skip
        axes.set_xticks(places, labels=[plain(str(choice)) for choice in x["values"]])
    else:
        axes.fill_between(places, mean - 2 * deviation, mean + 2 * deviation, color=ACCENT, alpha=0.18, lw=0,
                          label="mean ± 2 s.d.")  # fmt: skip
        axes.plot(places, mean, color=ACCENT)
    for state, mark in MARKS.items():
        of = [s for s in told["samples"] if s["state"] == state.value and s["value"] is not None]
        if of:
            axes.scatter([x["values"].index(s["x"]) if category else s["x"] for s in of], [s["value"] for s in of],
                         label=state.value, **mark)  # fmt: skip
    if told["next"] is not None and not category:
        axes.axvline(told["next"]["x"], color=NEXT, lw=1, ls=(0, (3, 2)), label="next proposal")
    if x["scale"] == "log":
        logarithmic(axes, "x", x["values"][0], x["values"][-1])
    axes.set_xlabel(titled(x["name"], x["unit"]))
    axes.set_ylabel(labelled(told["output"]))
    legend_above(figure, axes)
    return figure
