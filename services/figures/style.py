"""How figures look: two column widths, 8-point text, one palette that colour-blind readers can tell apart.

Colours and shapes are those of the pages (`dashboards/static/style.css`, Okabe and Ito for series, cividis for fields):
a state is told by its shape as well as by its colour, so that a figure survives a grey print.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from services.states import TrialState

COLUMN = 3.4
"""Inches: one column of a two-column paper (86 mm)."""
PAGE = 7.0
"""Inches: both columns (178 mm)."""

INK, SOFT, LINE, ACCENT, PAPER = "#1c2126", "#56606a", "#d9d6d0", "#0b5f8e", "#ffffff"
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Okabe and Ito's palette, in an order whose neighbours differ in lightness too."""
DASHES: Sequence[Any] = ("-", (0, (5, 2)), (0, (1, 1.5)))
FIELD = "cividis"
UNSURE = LinearSegmentedColormap.from_list("unsure", ["#f7f4ee", "#d8c9e3", "#9a79b8", "#4b2466"])

MANY = 2000
"""Marks or lines of one kind from which they are written as pixels: viewers choke on more, and nobody edits them."""

MARKS: Mapping[TrialState, dict[str, Any]] = {
    TrialState.COMPLETE: {"marker": "o", "s": 16, "c": "#0b6fa4", "alpha": 0.75, "linewidths": 0},
    TrialState.INFEASIBLE: {"marker": "D", "s": 15, "facecolors": "none", "edgecolors": "#806000", "linewidths": 0.9},
    TrialState.DIVERGED: {"marker": (6, 2, 0), "s": 26, "c": "#9a3b80", "linewidths": 0.9},
    TrialState.FAILED: {"marker": "x", "s": 20, "c": "#b03a0a", "linewidths": 1.0},
}
"""One shape for each state in which a trial is an observation."""

RC: Mapping[str, Any] = {
    "font.size": 8,
    "font.family": "DejaVu Sans",
    "mathtext.fontset": "dejavusans",
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "axes.labelcolor": INK,
    "axes.edgecolor": SOFT,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "grid.color": "#e9e6e1",
    "grid.linewidth": 0.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.minor.size": 1.5,
    "ytick.minor.size": 1.5,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "legend.handletextpad": 0.4,
    "legend.columnspacing": 1.2,
    "lines.linewidth": 1.2,
    "figure.facecolor": PAPER,
    "savefig.facecolor": PAPER,
    "savefig.dpi": 300,
    # Type 3 fonts are refused by publishers' checks; an SVG's text as shapes looks the same without our fonts.
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
    # The same study gives the same bytes.
    "svg.hashsalt": "halma",
}

GREEK = frozenset({"alpha", "beta", "gamma", "delta", "epsilon", "theta", "lambda", "mu", "omega", "phi", "psi", "rho",
                   "sigma", "tau", "kappa", "eta", "zeta", "xi", "nu", "chi"})  # fmt: skip
SYMBOL = re.compile(r"([A-Za-z]+)(?:_([A-Za-z0-9]{1,3}))?")


class NotApplicable(Exception):
    """A figure that says nothing about this study; the message says why."""


@contextmanager
def style() -> Iterator[None]:
    """The house's settings, for the length of a block."""
    settings: Any = dict(RC)  # the stubs want each key as a literal
    with mpl.rc_context(settings):
        yield


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, inches."""
    return Figure(figsize=(width, height), layout="constrained")


def symbol(name: str) -> str:
    """A name for people: `omega_x` as ω with an index, other names in words."""
    found = SYMBOL.fullmatch(name)
    if found and (found[1] in GREEK or (len(found[1]) == 1 and found[2])):
        letter = f"\\{found[1]}" if found[1] in GREEK else found[1]
        return f"${letter}_{{{found[2]}}}$" if found[2] else f"${letter}$"
    return plain(name.replace("_", " "))


def signed(text: str) -> str:
    """Numbers in text with the minus sign that the axes have."""
    return re.sub(r"(?<![\w.)])-(?=\d)", "−", text)


def plain(text: str) -> str:
    """Text that is not taken for mathematics."""
    return text.replace("$", r"\$")


def titled(name: str, unit: str) -> str:
    """A name with its unit."""
    return f"{symbol(name)} ({plain(unit)})" if unit else symbol(name)


def counts(axes: Axes, axis: str = "x") -> None:
    """An axis of large counts: 10k, 2M."""
    which = axes.xaxis if axis == "x" else axes.yaxis
    which.set_major_formatter(EngFormatter(sep=""))
    which.set_major_locator(MaxNLocator(5))


def logarithmic(axes: Axes, axis: str, low: float, high: float) -> None:
    """A logarithmic axis between two bounds whose labels don't crowd: decades, or 1, 2, 5 where there are few."""
    which = axes.xaxis if axis == "x" else axes.yaxis
    (axes.set_xscale if axis == "x" else axes.set_yscale)("log")
    if math.log10(high / low) < 2:
        which.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        which.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    which.set_minor_formatter(NullFormatter())


def whole(axes: Axes) -> None:
    """An x axis on which only whole numbers mean something."""
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))


def legend_above(figure: Figure, axes: Axes) -> None:
    """A legend over the plot, where it hides nothing, in as many columns as fit; none where there is one kind only."""
    handles, labels = axes.get_legend_handles_labels()
    if len(handles) < 2:
        return
    columns = next(n for n in range(len(labels), 0, -1) if n == 1 or _width(labels, n) <= figure.get_figwidth())
    figure.legend(handles, labels, loc="outside upper left", ncols=columns, borderaxespad=0.2)


def _width(labels: Sequence[str], columns: int) -> float:
    """Inches that a legend takes, roughly: 7-point letters are 0.062 wide, a handle takes as much as eight."""
    rows = -(-len(labels) // columns)
    parts = [labels[at : at + rows] for at in range(0, len(labels), rows)]
    return sum(max(map(len, part)) + 8 for part in parts) * 0.062


def encode(figure: Figure, form: str, dpi: int = 300) -> bytes:
    """A figure as the bytes of an SVG, PDF or PNG file, the same for the same figure; `dpi` is that of its pixels."""
    parts: Any = figure.findobj(Collection)  # the stubs know neither what is found nor that offsets have a length
    for part in parts:
        if max(len(part.get_offsets()), len(part.get_paths())) > MANY:
            part.set_rasterized(True)
    out = io.BytesIO()
    metadata: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(form, {})
    with style():
        figure.savefig(out, format=form, metadata=metadata, dpi=dpi, bbox_inches=None)
    return out.getvalue()
