"""The strategy maps of the benchmarks: those to tune on, to choose a default by, and to report on.

The name of a map is the seed of its world.
"""

from __future__ import annotations

from benchmarks.search.maps import StrategyMap


def shares(count: int, ratio: float = 0.7) -> tuple[float, ...]:
    """Shares of the volume in geometric progression: a few large flat regions, several rare ones."""
    raw = [ratio**i for i in range(count)]
    return tuple(r / sum(raw) for r in raw)


TUNE = (
    StrategyMap("regions-3d-circle", 3, "circle", "regions", shares(8), fails=0.2, angles=1),
    StrategyMap("regions-4d-circle-interior", 4, "circle", "regions", shares(8), interior=5, fails=0.2),
    StrategyMap("folds-4d-circle", 4, "circle", "folds", shares(8), fails=0.25, angles=1),
    StrategyMap("regions-4d-rotation", 4, "rotation", "regions", shares(9), interior=2, fails=0.3, angles=1),
    StrategyMap("folds-5d-circle-noisy", 5, "circle", "folds", shares(8), interior=1, noise=0.08, flaky=0.05),
    StrategyMap("regions-6d-plane", 6, "plane", "regions", shares(9), interior=3, fails=0.25, relevant=4),
    StrategyMap("regions-8d-circle", 8, "circle", "regions", shares(9), fails=0.3, relevant=5, angles=1),
    StrategyMap("folds-3d-circle-failing", 3, "circle", "folds", shares(7), fails=0.5),
)
"""Maps to tune on."""

REPORT = (
    StrategyMap("take-off-3d", 3, "circle", "folds", shares(8), fails=0.3, angles=1),
    StrategyMap("take-off-4d", 4, "circle", "regions", shares(9), fails=0.35, angles=1),
    StrategyMap("hidden-4d", 4, "circle", "regions", shares(8), interior=6, fails=0.1),
    StrategyMap("hidden-3d-vector", 3, "plane", "regions", shares(8), interior=5, fails=0.15),
    StrategyMap("twist-4d", 4, "rotation", "regions", shares(10), interior=3, fails=0.3),
    StrategyMap("twist-5d-noisy", 5, "rotation", "regions", shares(9), fails=0.2, noise=0.08, flaky=0.05),
    StrategyMap("plateaus-5d", 5, "plane", "folds", shares(9), interior=1, fails=0.2),
    StrategyMap("mixed-6d", 6, "circle", "regions", shares(8), fails=0.3, mixed=True, angles=1),
    StrategyMap("wide-8d", 8, "circle", "folds", shares(8), interior=1, fails=0.3, relevant=4),
    StrategyMap("smooth-4d", 4, "circle", "folds", shares(10), noise=0.05),
)
"""Maps that figures are reported on; nothing was tuned on them."""

FLIGHTS = (
    StrategyMap("flight-3d", 3, "circle", "flights", shares(8), fails=0.25, angles=1),
    StrategyMap("flight-4d", 4, "circle", "flights", shares(8), fails=0.2, noise=0.05),
    StrategyMap("flight-4d-rotation", 4, "rotation", "flights", shares(9), fails=0.25, angles=1),
)
"""Maps of the third family, reported apart: other worlds of this family were seen in tuning."""

INTERIOR = ("hidden-4d", "hidden-3d-vector")
"""Reported maps all of whose rare strategies lie in the interior."""

VALIDATE = (
    StrategyMap("valid-3d-circle", 3, "circle", "regions", shares(7, 0.75), fails=0.25, angles=1),
    StrategyMap("valid-3d-folds", 3, "circle", "folds", shares(9, 0.75), fails=0.2),
    StrategyMap("valid-3d-rotation", 3, "rotation", "regions", shares(8, 0.65), interior=3, fails=0.2, angles=1),
    StrategyMap("valid-4d-plane", 4, "plane", "regions", shares(10, 0.75), interior=4, fails=0.1),
    StrategyMap("valid-4d-edges", 4, "circle", "regions", shares(8, 0.65), fails=0.4, angles=1),
    StrategyMap("valid-4d-folds", 4, "circle", "folds", shares(7, 0.65), interior=2, fails=0.35, noise=0.05),
    StrategyMap("valid-4d-flight", 4, "rotation", "flights", shares(8), fails=0.3, angles=1),
    StrategyMap("valid-5d-interior", 5, "circle", "regions", shares(9), interior=7, fails=0.15, flaky=0.05),
    StrategyMap("valid-5d-flight", 5, "circle", "flights", shares(7), fails=0.2, noise=0.05, angles=1),
    StrategyMap("valid-5d-folds", 5, "plane", "folds", shares(8, 0.75), fails=0.25, relevant=4),
    StrategyMap("valid-6d-mixed", 6, "circle", "regions", shares(8), interior=2, fails=0.25, mixed=True),
    StrategyMap("valid-7d-rotation", 7, "rotation", "regions", shares(9), fails=0.3, relevant=5, noise=0.05),
)
"""Maps that a default is chosen by, once, where the maps to tune on leave it open; with recipes of their own."""

WIDE = (
    StrategyMap("wide-8d-regions", 8, "circle", "regions", shares(8), fails=0.25, relevant=5, angles=1),
    StrategyMap("wide-8d-folds", 8, "circle", "folds", shares(8), interior=2, fails=0.25, relevant=5),
    StrategyMap("wide-16d-regions", 16, "circle", "regions", shares(8), interior=3, fails=0.25, relevant=6, angles=1),
    StrategyMap("wide-16d-folds", 16, "plane", "folds", shares(8), fails=0.25, relevant=8),
)
"""Maps of eight and sixteen parameters, reported apart; nothing was tuned on them."""

MAPS = {m.name: m for m in (*TUNE, *REPORT, *FLIGHTS, *VALIDATE, *WIDE)}
