"""Learning curves of several trials over each other."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from services.course import answers
from services.curves import metric_of, metrics_of
from services.figures.shown import Shown
from services.figures.style import (
    COLUMN,
    DASHES,
    SERIES,
    NotApplicable,
    counts,
    legend_above,
    new_figure,
    plain,
    signed,
    symbol,
    whole,
)
from services.store.port import MetricRow, TrialRow

BEST = 6
"""Trials that are shown: the best ones."""
AXIS_WORDS = {"samples": "samples (control steps)"}


def chosen(shown: Shown) -> list[TrialRow]:
    """The best trials that have a curve: answers first, then easier versions of the task."""
    told = [trial for trial in shown.valued if trial.iteration > 0]
    ranked = sorted(told, key=lambda trial: (not answers(trial), -(trial.value or 0.0), trial.number))
    return ranked[:BEST]


def draw_curves(shown: Shown) -> Figure:
    """One metric of the best trials against their samples, or their iterations where samples were not reported."""
    reported: list[tuple[TrialRow, Sequence[MetricRow]]] = [
        (trial, rows) for trial in chosen(shown) if (rows := shown.metrics(trial))
    ]
    metric = metric_of(metrics_of(row for _, rows in reported for row in rows))
    if metric is None:
        raise NotApplicable("no trial has a learning curve")
    curves = [(trial, [row for row in rows if metric in row.values]) for trial, rows in reported]
    if all(len(rows) < 2 for _, rows in curves):
        raise NotApplicable("no trial reported more than one iteration")
    by_samples = all("samples" in row.values for _, rows in curves for row in rows)
    figure = new_figure(COLUMN, 2.4)
    axes = figure.subplots()
    for place, (trial, rows) in enumerate(curves):
        x = [row.values["samples"] if by_samples else row.iteration for row in rows]
        value = f"{trial.value:.3g} {shown.value.unit}".rstrip()
        axes.plot(
            x, [row.values[metric] for row in rows], color=SERIES[place % len(SERIES)],
            ls=DASHES[place // len(SERIES) % len(DASHES)], marker="o" if len(rows) == 1 else None, ms=3,
            label=plain(signed(f"trial {trial.number} ({value})")),
        )  # fmt: skip
    axes.set_xlabel(AXIS_WORDS["samples"] if by_samples else "iteration")
    axes.set_ylabel(symbol(metric))
    if by_samples:
        counts(axes)
    else:
        whole(axes)
    legend_above(figure, axes)
    return figure
