"""Parameters against the value: a small picture each, and all of them side by side as parallel coordinates."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from services.figures.shown import Shown, values_of
from services.figures.style import (
    FIELD,
    INK,
    MARKS,
    PAGE,
    SOFT,
    NotApplicable,
    crowded,
    logarithmic,
    new_figure,
    plain,
    signed,
    titled,
)
from services.spec import Parameter
from services.store.port import TrialRow

MOST_LINES, BEST_LINES = 400, 50
"""Parallel lines at most, and how many of them are the best."""
ACROSS = 4
"""Small pictures in a row."""


def draw_parameters(shown: Shown) -> Figure:
    """The value against each parameter alone, with the range that was searched as the axis."""
    if not shown.compared:
        raise NotApplicable("no trial has a value")
    names = list(shown.space)
    rows = math.ceil(len(names) / ACROSS)
    across = min(len(names), ACROSS)
    figure = new_figure(PAGE * across / ACROSS if across < ACROSS else PAGE, 1.75 * rows + 0.1)
    panels = figure.subplots(rows, across, sharey=True, squeeze=False)
    for name, axes in zip(names, panels.flat, strict=False):
        parameter = shown.space[name]
        for state, mark in MARKS.items():
            of = [trial for trial in shown.compared if trial.state is state]
            if of:
                axes.scatter([place_of(parameter, trial.params[name]) for trial in of], values_of(of),
                             clip_on=False, zorder=3, **crowded(mark, len(of)))  # fmt: skip
        axes.set_xlabel(titled(name, shown.unit(name)))
        if parameter.type == "categorical":
            axes.set_xticks(range(len(parameter.choices)), labels=[plain(choice) for choice in parameter.choices])
            axes.set_xlim(-0.5, len(parameter.choices) - 0.5)
        else:
            if is_log(parameter):
                logarithmic(axes, "x", *bounds_of(parameter))
            axes.set_xlim(*bounds_of(parameter))
    for axes in panels[:, 0]:
        axes.set_ylabel(titled(shown.value.name, shown.value.unit))
    for axes in list(panels.flat)[len(names) :]:
        axes.set_axis_off()
    return figure


def bounds_of(parameter: Parameter) -> tuple[float, float]:
    """The range that is searched, natural units; places of the first and last choice of a categorical."""
    if parameter.type == "angle":
        return -math.pi, math.pi
    if parameter.type == "categorical":
        return 0.0, float(len(parameter.choices) - 1)
    return float(parameter.low), float(parameter.high)


def is_log(parameter: Parameter) -> bool:
    """Whether it is searched on a logarithmic scale."""
    return parameter.type in {"float", "int"} and bool(getattr(parameter, "log", False))


def place_of(parameter: Parameter, value: Any) -> float:
    """Where a value stands on its axis: a choice at its index."""
    return float(parameter.choices.index(value)) if parameter.type == "categorical" else float(value)


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One axis of the parallel coordinates.

    Args:
        title: with its unit.
        low, high: what stands at its foot and head.
        log: whether it is logarithmic.
        words: names of places, for choices.
        read: reads it from a trial; None where the trial has none.
    """

    title: str
    low: float
    high: float
    log: bool
    words: tuple[str, ...]
    read: Callable[[TrialRow], float | None]

    def share(self, value: float) -> float:
        """Height of a value in [0, 1]."""
        if self.high == self.low:
            return 0.5
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


def coordinates(shown: Shown) -> list[Coordinate]:
    """The axes: parameters over the range searched, features and the value over what was found."""

    def parameter(name: str) -> Coordinate:
        one = shown.space[name]
        words = one.choices if one.type == "categorical" else ()
        return Coordinate(titled(name, shown.unit(name)), *bounds_of(one), is_log(one), words,
                          lambda trial: place_of(one, trial.params[name]))  # fmt: skip

    def observed(title: str, read: Callable[[TrialRow], float | None]) -> Coordinate:
        values = [value for value in map(read, shown.compared) if value is not None]
        return Coordinate(title, min(values), max(values), log=False, words=(), read=read)

    def feature(index: int) -> Callable[[TrialRow], float | None]:
        return lambda trial: trial.features[index] if trial.features else None

    found = [parameter(name) for name in shown.space]
    behaviour = shown.behaviour
    if behaviour is not None and behaviour.kind != "rotation":  # single coordinates of a quaternion say nothing
        found += [
            observed(titled(name, behaviour.unit), feature(index))
            for index, name in enumerate(behaviour.names)
            if any(trial.features for trial in shown.compared)
        ]
    return [*found, observed(titled(shown.value.name, shown.value.unit), lambda trial: trial.value)]


def even(ranked: Sequence[TrialRow]) -> list[TrialRow]:
    """The best and an even sample of the others, worst first: more lines would cover each other."""
    if len(ranked) <= MOST_LINES:
        return list(ranked)
    others = ranked[:-BEST_LINES]
    step = len(others) / (MOST_LINES - BEST_LINES)
    return [*(others[int(place * step)] for place in range(MOST_LINES - BEST_LINES)), *ranked[-BEST_LINES:]]


def draw_parallel(shown: Shown) -> Figure:
    """Parallel coordinates: a line for each trial, the best ones on top."""
    if not shown.compared:
        raise NotApplicable("no trial has a value")
    axes_of = coordinates(shown)
    ranked = even(sorted(shown.compared, key=lambda trial: trial.value or 0.0))
    values = [trial.value or 0.0 for trial in ranked]
    span = Normalize(values[0], values[-1] if values[-1] > values[0] else values[0] + 1)
    colours = mpl.colormaps[FIELD]
    lines, hues, widths = [], [], []
    for place, trial in enumerate(ranked):
        points = [
            (index, axis.share(value)) for index, axis in enumerate(axes_of) if (value := axis.read(trial)) is not None
        ]
        lines.append(points)
        best = place / max(1, len(ranked) - 1)
        # cividis ends in a yellow that white paper swallows
        hues.append((*colours(0.92 * span(trial.value or 0.0))[:3], 0.35 + 0.6 * best**2))
        widths.append(0.6 + 0.7 * best**3)
    figure = new_figure(PAGE, 2.5)
    axes = figure.subplots()
    axes.add_collection(LineCollection(lines, colors=hues, linewidths=widths, capstyle="round", joinstyle="round"))
    axes.set_xlim(-0.3, len(axes_of) - 0.7)
    if len(ranked) < len(shown.compared):
        figure.supxlabel(
            f"the best {BEST_LINES} of {len(shown.compared):,} trials, "
            f"and {MOST_LINES - BEST_LINES} evenly among the others",
            fontsize=6.5, color=SOFT,
        )  # fmt: skip
    axes.set_ylim(-0.02, 1.02)
    for side in axes.spines.values():
        side.set_visible(False)
    axes.grid(visible=False)
    axes.set_yticks([])
    axes.set_xticks([])
    many = len(axes_of) > 9
    for index, axis in enumerate(axes_of):
        axes.plot([index, index], [0, 1], color=SOFT, lw=0.8, zorder=3)
        lift = 0.10 if many and index % 2 else 0.0
        axes.text(index, 1.115 + lift, axis.title, ha="center", va="bottom", color=INK, fontsize=7 if many else 8)
        ticks = [(axis.share(i), word) for i, word in enumerate(axis.words)] or [
            (0.0, f"{axis.low:.3g}"), (1.0, f"{axis.high:.3g}"),
        ]  # fmt: skip
        for height, words in ticks:
            if axis.words:
                axes.text(index + 0.03, height, plain(words), va="center", color=INK, fontsize=6.5, zorder=4)
            else:
                axes.text(index, height + (0.03 if height else -0.03), signed(words), ha="center",
                          va="bottom" if height else "top", color=SOFT, fontsize=6.5)  # fmt: skip
    bar = figure.colorbar(ScalarMappable(span, mpl.colors.ListedColormap(colours(np.linspace(0, 0.92, 256)))), ax=axes,
                          pad=0.01, aspect=30)  # fmt: skip
    bar.set_label(titled(shown.value.name, shown.value.unit))
    bar.outline.set_visible(False)
    return figure
