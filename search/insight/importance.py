"""Which parameters matter, told in two ways that can contradict each other; and the setting to go on from.

*Length scales* (automatic relevance determination): a parameter whose length scale is short changes the output within
its range, one whose length scale is long doesn't. They know nothing of how *much* it changes.

*Permutation* (Breiman 2001, section 10; Fisher et al. 2019): how much worse the surrogate predicts observations it has
not seen when a parameter's values are drawn from those of other observations. It is in units of the output's variance:
0 for a parameter that says nothing, twice its total Sobol index where the surrogate is exact. The interval is a
bootstrap over the observations, so it is wide where few of them say so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from search.insight.surrogates import Subject, Surrogates, quietly
from search.space import Angle, Array, Categorical, Float, Int, Parameter, Space
from search.surrogate.gp import GaussianProcess
from search.surrogate.subset import farthest_first

ROWS = 300
"""Observations that importances are taken from, at most."""
FOLDS = 10
REPEATS = 10
"""How many other observations a value is replaced from."""
BOOTSTRAPS = 1000
FEWEST = 8
"""Observations below which nothing is said."""


@dataclass(frozen=True, slots=True)
class Importance:
    """How much one parameter matters.

    Args:
        name: of the parameter.
        length_scale: in ranges of the parameter.
        from_length_scales: its share of the inverse length scales of all parameters; they sum to 1.
        permutation: rise of the squared error when it is permuted, in variances of the output.
        interval: 95 % of the bootstraps of that.
    """

    name: str
    length_scale: float
    from_length_scales: float
    permutation: float
    interval: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Importances:
    """How much each parameter matters.

    Args:
        parameters: the most important by permutation first.
        agreement: Spearman's rank correlation of the two importances, in [-1, 1]; None with one parameter.
        explained: share of the output's variance that the surrogate predicts where it has not seen it; at most 1.
        observations: how many they were taken from.
    """

    parameters: tuple[Importance, ...]
    agreement: float | None
    explained: float
    observations: int


def importances(known: Surrogates, subject: Subject, rng: np.random.Generator) -> Importances | None:
    """How much each parameter matters to the value or to the behaviour; None where too little is known.

    Args:
        known: the study's surrogates.
        subject: the output.
        rng: for permutations and bootstraps.
    """
    if not (known.has_values if subject == "value" else known.has_behaviours):
        return None
    process = known.process(subject)
    if len(process.X) < FEWEST:
        return None
    space = known.space
    with quietly():
        rows = np.sort(farthest_first(process.X, ROWS))
        losses, baseline, variance = _losses(process, rows, space.owner, space.d, rng)
    if variance <= 0:
        return None
    rise = (losses - baseline[:, None]) / variance
    chosen = rng.integers(len(rows), size=(BOOTSTRAPS, len(rows)))
    boots = rise[chosen].mean(1)
    low, high = np.quantile(boots, [0.025, 0.975], axis=0)
    mean = rise.mean(0)
    lengths = known.lengths(subject)
    shares = (1 / lengths) / (1 / lengths).sum()
    found = [
        Importance(name, float(lengths[p]), float(shares[p]), float(mean[p]), (float(low[p]), float(high[p])))
        for p, name in enumerate(space.names)
    ]
    agreement = None
    if len(set(shares)) > 1 and len(set(mean)) > 1:
        agreement = float(spearmanr(shares, mean).statistic)
    found.sort(key=lambda each: (-each.permutation, each.name))
    return Importances(tuple(found), agreement, float(1 - baseline.mean() / variance), len(rows))


def _losses(
    process: GaussianProcess, rows: NDArray[np.int64], owner: Sequence[int], d: int, rng: np.random.Generator
) -> tuple[Array, Array, float]:
    """Squared errors of predictions by the other folds: ``n x d`` permuted, ``n`` as they are; and the variance."""
    X, Y, noise = process.X[rows], process.Y[rows], process.noise[rows]
    n = len(rows)
    fold = np.empty(n, dtype=int)
    fold[rng.permutation(n)] = np.arange(n) % min(FOLDS, n)
    donors = rng.integers(n, size=(REPEATS, n))
    columns = [np.flatnonzero(np.array(owner) == p) for p in range(d)]
    baseline, losses = np.empty(n), np.zeros((n, d))
    for f in range(fold.max() + 1):
        test, train = np.flatnonzero(fold == f), np.flatnonzero(fold != f)
        rest = process.given(X[train], Y[train], noise[train])
        baseline[test] = np.square(rest.posterior(X[test])[0] - Y[test]).sum(1)
        for p in range(d):
            S = np.tile(X[test], (REPEATS, 1))
            S[:, columns[p]] = X[donors[:, test].reshape(-1)][:, columns[p]]
            mean = rest.correlation(S) @ rest.alpha + rest.mean
            miss = np.square(mean.reshape(REPEATS, len(test), -1) - Y[test]).sum(2)
            losses[test, p] = miss.mean(0)
    return losses, baseline, float(np.square(Y - Y.mean(0)).sum(1).mean())


def narrowed(space: Space, best: Array, lengths: Array) -> dict[str, Parameter]:
    """The part of a space to go on in: half a length scale to each side of the best setting, at least 5 % of a range.

    Args:
        space: that was searched.
        best: ``d`` unit coordinates.
        lengths: ``d``, in ranges.

    Returns:
        Parameters by name, each inside what it was. A category is its best choice alone; where nothing else would be
        left to search, all choices stay.
    """
    found: dict[str, Parameter] = {}
    for p, (name, parameter) in enumerate(space.parameters.items()):
        half = max(0.05, float(lengths[p]) / 2)
        found[name] = _narrow(parameter, float(best[p]), half)
    if all(parameter.cells == 1 for parameter in found.values()):
        return dict(space.parameters)
    return found


def _narrow(parameter: Parameter, u: float, half: float) -> Parameter:
    low, high = max(0.0, u - half), min(1.0, u + half)
    if isinstance(parameter, Angle):
        # across the seam it stays a whole circle: study files have no arc
        if half >= 0.5 or u - half < 0 or u + half > 1:
            return parameter
        return Float(_rounded(parameter.from_unit(low), down=True), _rounded(parameter.from_unit(high), down=False))
    if isinstance(parameter, Categorical):
        return Categorical((parameter.from_unit(u),))
    if isinstance(parameter, Int):
        first, last = parameter.from_unit(low), parameter.from_unit(min(high, 1 - 1e-12))
        if first == last and parameter.low < parameter.high:
            first, last = max(parameter.low, first - 1), min(parameter.high, last + 1)
        return Int(first, last, parameter.log)
    a, b = _rounded(parameter.from_unit(low), down=True), _rounded(parameter.from_unit(high), down=False)
    return Float(max(a, parameter.low), min(b, parameter.high), parameter.log)


def _rounded(value: float, *, down: bool) -> float:
    """To three significant digits, outwards: a bound that people read."""
    if value == 0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(abs(value))) - 2)
    steps = math.floor(value / step) if down else math.ceil(value / step)
    return float(f"{steps * step:.12g}")
