"""The space of behaviours: every outcome where it belongs, the distinct strategies by number and name."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from numpy.typing import NDArray

from services.figures.shown import Shown
from services.figures.style import (
    ACCENT,
    COLUMN,
    INK,
    LINE,
    MARKS,
    SOFT,
    NotApplicable,
    crowded,
    new_figure,
    plain,
    signed,
    titled,
)
from services.report import feature_words, strategy_name
from services.states import TrialState
from services.store.port import TrialRow

if TYPE_CHECKING:
    from services.spec import Behaviour

Array = NDArray[np.float64]

TURN, TILT = 0.9, 0.38
"""Radians: from where the sphere is seen; the page's first view."""
POLES = {
    "over the bar": (1, 0, 0),
    "back": (-1, 0, 0),
    "up": (0, 1, 0),
    "down": (0, -1, 0),
    "right": (0, 0, 1),
    "left": (0, 0, -1),
}
"""Directions of the world, as the high jump has them."""
MOST_NAMED = 10
"""Strategies that are listed under the picture."""
HOLE = 0.25
"""Radius of the lowest value on a dial, as a share of the highest's: at the centre directions can't be told apart."""


def draw_behaviour(shown: Shown) -> Figure:
    """The space of behaviours, drawn as its metric asks: a circle, a dial, a plane, or a sphere of rotations."""
    behaviour = shown.behaviour
    if behaviour is None:
        raise NotApplicable("behaviour plays no part in this study")
    trials = [trial for trial in shown.history if trial.features is not None]
    if not trials:
        raise NotApplicable("no trial has a behaviour")
    listed = min(len(shown.found), MOST_NAMED)
    height = 3.1 + 0.145 * listed
    figure = new_figure(COLUMN, height)
    halves: Any = figure.subfigures(2, 1, height_ratios=[3.1, max(0.145 * listed, 0.01)])
    upper, lower = halves
    if behaviour.kind == "rotation":
        _sphere(upper.subplots(), shown, trials)
    elif behaviour.kind == "circle" or is_inclination(behaviour):
        _dial(upper.subplots(subplot_kw={"projection": "polar"}), shown, trials, behaviour)
    else:
        _plane(upper.subplots(), shown, trials, behaviour)
    axes = lower.subplots()
    axes.set_axis_off()
    for place, finding in enumerate(shown.found[:listed]):
        name = strategy_name(finding.trial) or feature_words(finding.trial.features, behaviour)
        value = "" if finding.trial.value is None else f", {finding.trial.value:.3g} {shown.value.unit}".rstrip()
        y = 1 - (place + 0.5) / listed
        axes.text(0.02, y, f"{place + 1}", weight="bold", color=ACCENT, va="center", fontsize=7)
        axes.text(0.08, y, plain(signed(f"{name}{value}")), va="center", fontsize=7, color=INK)
    return figure


def is_inclination(behaviour: Behaviour) -> bool:
    """Whether a behaviour is one angle between 0 and a half turn."""
    whole = len(behaviour.names) == 1 and behaviour.unit == "rad" and behaviour.low == (0.0,)
    return whole and len(behaviour.high) == 1 and abs(behaviour.high[0] - math.pi) < 1e-6


def _marks(
    axes: Axes, shown: Shown, trials: Sequence[TrialRow], x: Sequence[float], y: Sequence[float],
    hidden: Collection[int] = (),
) -> None:  # fmt: skip
    """All outcomes, and the strategies numbered over them; those at `hidden` places lie behind, and are fainter."""
    for (state, mark), behind in product(MARKS.items(), (False, True)):
        of = [place for place, trial in enumerate(trials) if trial.state is state and (place in hidden) is behind]
        if of:
            style: dict[str, Any] = {**mark, "alpha": 0.15 if behind else 0.45 if state is TrialState.COMPLETE else 1.0}
            style = crowded(style, len(of))
            axes.scatter([x[i] for i in of], [y[i] for i in of], zorder=3, clip_on=False, label=state.value, **style)
    places = {trial.number: place for place, trial in enumerate(trials)}
    for rank, finding in enumerate(shown.found, 1):
        at = places[finding.trial.number]
        fill, over = "#8fb0c6" if at in hidden else ACCENT, 5 - 0.001 * rank
        axes.scatter([x[at]], [y[at]], s=80, c=fill, edgecolors="white", linewidths=0.7, clip_on=False, zorder=over)
        axes.text(
            x[at], y[at], str(rank), color="white", weight="bold", ha="center", va="center_baseline", fontsize=6.5,
            zorder=over + 0.0005,
        )  # fmt: skip


def _dial(axes: Any, shown: Shown, trials: Sequence[TrialRow], behaviour: Behaviour) -> None:
    """One angle: direction the behaviour, distance from the centre the value."""
    assert isinstance(axes, PolarAxes)  # noqa: S101 - what `projection` asked for; for mypy
    values = [trial.value for trial in trials if trial.value is not None]
    low, high = (min(values), max(values)) if values else (0.0, 1.0)
    span = (high - low) or 1.0
    origin = low - span * HOLE / (1 - HOLE)
    radii = [high if trial.value is None else trial.value for trial in trials]
    angles = [(trial.features or (0.0,))[0] for trial in trials]
    inclined = behaviour.kind != "circle"
    if inclined:
        axes.set_theta_zero_location("N")
        axes.set_theta_direction(-1)
        axes.set_thetamin(0)
        axes.set_thetamax(180)
    axes.set_rorigin(origin)
    axes.set_rlim(low, high)
    axes.set_rticks([low, (low + high) / 2, high], labels=[f"{v:.3g}" for v in (low, (low + high) / 2, high)])
    axes.set_thetagrids(
        range(0, 181, 30) if inclined else range(0, 360, 45),
        labels=None if inclined else [signed(f"{(turn + 179) % 360 - 179}°") for turn in range(0, 360, 45)],
    )  # fmt: skip
    axes.grid(color=LINE, lw=0.5)
    for spine in axes.spines.values():
        spine.set_color(LINE)
    axes.set_rlabel_position(0 if inclined else 22.5)
    if inclined and behaviour.names[0] == "facing":
        for words, place in (("face up", 0.0), ("face down", math.pi)):
            axes.text(place - 0.09 if place else -0.09, high + 0.12 * span, words, color=SOFT, fontsize=6.5, ha="right",
                      va="center")  # fmt: skip
    _marks(axes, shown, trials, angles, radii)
    unit = f" ({shown.value.unit})" if shown.value.unit else ""
    axes.set_title(
        f"direction: {plain(behaviour.names[0])} (°); from the centre: {plain(shown.value.name)}{unit}",
        color=SOFT, fontsize=7, pad=8,
    )  # fmt: skip


def _plane(axes: Axes, shown: Shown, trials: Sequence[TrialRow], behaviour: Behaviour) -> None:
    """A vector: its first two coordinates; a single one against the value."""
    points = [trial.features or () for trial in trials]
    single = len(behaviour.names) == 1
    kept = [i for i, trial in enumerate(trials) if not single or trial.value is not None]
    x = [points[i][0] for i in kept]
    y = [float(trials[i].value or 0.0) if single else points[i][1] for i in kept]
    axes.set_xlabel(titled(behaviour.names[0], behaviour.unit))
    axes.set_ylabel(
        titled(shown.value.name, shown.value.unit) if single else titled(behaviour.names[1], behaviour.unit)
    )
    if len(behaviour.names) > 2:
        axes.set_title(f"the first two of {len(behaviour.names)} features", color=SOFT, fontsize=7)
    _marks(axes, shown, [trials[i] for i in kept], x, y)
    if behaviour.low and behaviour.high:
        axes.set_xlim(behaviour.low[0], behaviour.high[0])
        if not single:
            axes.set_ylim(behaviour.low[1], behaviour.high[1])
    axes.margins(0.06)


def rotated(vector: Sequence[float], quaternions: Array) -> Array:
    """A vector turned by ``n x 4`` unit quaternions (x, y, z, w): ``n x 3``."""
    v = np.broadcast_to(np.asarray(vector, dtype=float), (len(quaternions), 3))
    axis, w = quaternions[:, :3], quaternions[:, 3:]
    # Rodrigues in quaternion form: v + 2 q x (q x v + w v)
    return np.asarray(v + 2 * np.cross(axis, np.cross(axis, v) + w * v))


def seen(points: Array) -> Array:
    """World (x over the bar, y up) to the picture: ``n x 3``, right, up, towards the eye."""
    x, y, z = points.T
    a, b = x * math.cos(TURN) - z * math.sin(TURN), x * math.sin(TURN) + z * math.cos(TURN)
    return np.stack([a, y * math.cos(TILT) - b * math.sin(TILT), y * math.sin(TILT) + b * math.cos(TILT)], axis=1)


def _sphere(axes: Axes, shown: Shown, trials: Sequence[TrialRow]) -> None:
    """Rotations: where the forward axis points, on a sphere; a stroke shows where the head is."""
    quaternions = np.array([trial.features for trial in trials], dtype=float)
    forward, head = seen(rotated((1, 0, 0), quaternions)), seen(rotated((0, 1, 0), quaternions))
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_xlim(-1.32, 1.32)
    axes.set_ylim(-1.2, 1.2)
    round_ = np.linspace(0, 2 * np.pi, 181)
    axes.fill(np.cos(round_), np.sin(round_), facecolor="#f6f5f2", edgecolor=LINE, lw=0.8, zorder=0)
    zero = np.zeros_like(round_)
    for circle in (
        (np.cos(round_), zero, np.sin(round_)),
        (np.cos(round_), np.sin(round_), zero),
        (zero, np.cos(round_), np.sin(round_)),
    ):
        points = seen(np.stack(circle, axis=1))
        for front in (True, False):
            line = np.where(((points[:, 2] >= 0) == front)[:, None], points[:, :2], np.nan)
            axes.plot(*line.T, color=LINE, lw=0.6, ls="-" if front else (0, (1, 2)), zorder=1)
    for words, pole in POLES.items():
        x, y, depth = seen(np.array([pole], dtype=float) * 1.12)[0]
        axes.text(x, y, words, color=SOFT if depth >= 0 else "#a4a9ae", ha="center", va="center", fontsize=6.5)
    numbers = {finding.trial.number for finding in shown.found}
    for trial, (x, y, depth), (dx, dy, _) in zip(trials, forward, head, strict=True):
        strong = trial.number in numbers
        axes.plot(
            [x, x + 0.17 * dx], [y, y + 0.17 * dy], color=ACCENT if strong else "#0b6fa4", lw=1.1 if strong else 0.8,
            alpha=(1.0 if strong else 0.6) * (1 if depth >= 0 else 0.35), solid_capstyle="round", zorder=2,
        )  # fmt: skip
    hidden = {place for place, depth in enumerate(forward[:, 2]) if depth < 0}
    _marks(axes, shown, trials, forward[:, 0].tolist(), forward[:, 1].tolist(), hidden)
    axes.set_title("where the forward axis points (unit sphere); strokes lead to the head", color=SOFT, fontsize=7)
