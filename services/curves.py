"""Which of a trial's metrics people look at first."""

from __future__ import annotations

from collections.abc import Iterable

from services.store.port import MetricRow

FIRST = ("return", "bar", "level", "success", "height", "reward", "value")
"""What such a metric has in its name; the first that is found wins."""

STEPS = "samples"
"""The metric that counts simulation samples so far: an axis rather than a curve."""


def metrics_of(rows: Iterable[MetricRow]) -> list[str]:
    """Names of all metrics that were reported, but the count of samples."""
    return sorted({name for row in rows for name in row.values} - {STEPS})


def metric_of(names: Iterable[str]) -> str | None:
    """The metric to show among those reported, the same choice as the page's; None where there is none."""
    ranks = {name: next((i for i, word in enumerate(FIRST) if word in name), len(FIRST)) for name in names}
    return min(ranks, key=lambda name: (ranks[name], name), default=None)
