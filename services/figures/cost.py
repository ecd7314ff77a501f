"""Best value against cost."""

from __future__ import annotations

from matplotlib.figure import Figure

from services.course import answers, course
from services.figures.shown import Shown, values_of
from services.figures.style import COLUMN, INK, MARKS, NotApplicable, counts, legend_above, new_figure, symbol, titled
from services.states import TrialState


def draw_cost(shown: Shown) -> Figure:
    """Every outcome where it stood on the bill, and the best answer so far as a step line."""
    if not shown.valued:
        raise NotApplicable("no trial has a value")
    steps = course(shown.history)
    figure = new_figure(COLUMN, 2.4)
    axes = figure.subplots()
    bests = [step for step in steps if step.is_best]
    if bests:
        # A step holds its height until the next best; the last one until now.
        x = [step.samples for step in bests] + [steps[-1].samples]
        y = values_of([*(step.trial for step in bests), bests[-1].trial])
        axes.step(x, y, where="post", color=INK, lw=0.9, ls=(0, (2, 1.4)), label="best so far", zorder=3)
    easier = [step for step in steps if step.trial.value is not None and not answers(step.trial)]
    for state, mark in MARKS.items():
        of = [step for step in steps if step.trial.state is state and step.trial.value is not None]
        hard = [step for step in of if answers(step.trial)] if state is TrialState.COMPLETE else of
        if hard:
            axes.scatter(
                [s.samples for s in hard], values_of(s.trial for s in hard), label=state.value, zorder=2, **mark
            )
    soft = [step for step in easier if step.trial.state is TrialState.COMPLETE]
    if soft:
        axes.scatter(
            [step.samples for step in soft], values_of(step.trial for step in soft), label="easier version (z < 1)",
            marker="o", s=13, facecolors="none", edgecolors="#0b6fa4", linewidths=0.7, alpha=0.7, zorder=1,
        )  # fmt: skip
    # What ended without a value still cost something: a mark at the foot.
    for state, mark in MARKS.items():
        none = [step.samples for step in steps if step.trial.state is state and step.trial.value is None]
        if none:
            axes.scatter(
                none, [0.0] * len(none), transform=axes.get_xaxis_transform(), clip_on=False, zorder=4,
                label=f"{state.value}, no value", **mark,
            )  # fmt: skip
    axes.set_xlabel("samples spent (control steps)")
    axes.set_ylabel(titled(shown.value.name, shown.value.unit) if shown.value.name != "value" else symbol("value"))
    axes.set_xlim(left=0)
    axes.margins(x=0.03)
    counts(axes)
    legend_above(figure, axes)
    return figure
