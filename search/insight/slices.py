"""A slice through a surrogate: two parameters vary, the others stay.

Glossary: ``nx`` and ``ny`` numbers of grid points; arrays are ``ny x nx``, one row for each value of y.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.special import ndtr

from search.errors import BadParams
from search.insight.surrogates import EVEN, Subject, Surrogates, quietly
from search.quality.acquisition import log_expected_improvement
from search.quality.cmfbo import to_beat
from search.quality.model import imputed
from search.space import Angle, Array, Categorical, Int, Scalar, Space
from search.surrogate.gp import matern52

LARGEST_GRID = 10_000
"""Points of a slice at most."""
MOST_SAMPLES = 1000
"""Observations shown with a slice at most: those nearest to it."""
CHUNK = 256
"""Grid points whose draws are held at a time."""
DRAWS = 64
"""Draws from a posterior that has no closed form."""

Scale = Literal["linear", "log", "angle", "category"]


@dataclass(frozen=True, slots=True)
class Axis:
    """One side of a slice.

    Args:
        name: of the parameter.
        scale: how it is searched.
        values: natural units, ascending; categories in their order.
        unit: the same in unit coordinates.
    """

    name: str
    scale: Scale
    values: tuple[Scalar, ...]
    unit: Array


@dataclass(frozen=True, slots=True)
class Shown:
    """An observation beside a slice.

    Args:
        index: in the record.
        value: the output that is shown, as observed; NaN where it wasn't.
        near: prior correlation of the observation with its foot on the slice, in [0, 1]; 1 lies on it.
    """

    index: int
    value: float
    near: float


@dataclass(frozen=True, slots=True)
class Slice:
    """What a surrogate says on a grid.

    Args:
        x, y: the axes; y is None in a space of one parameter, then arrays have one row.
        mean: ``ny x nx``, natural units of the output.
        deviation: ``ny x nx``, standard deviation of the latent output, the same unit.
        acquisition: ``ny x nx``, what the study's strategy maximises, where it uses this surrogate; or None.
        acquisition_name: what that is.
        others: the parameters that stay, natural units.
        samples: the nearest observations.
        notes: sentences about what is shown.
    """

    x: Axis
    y: Axis | None
    mean: Array
    deviation: Array
    acquisition: Array | None
    acquisition_name: str
    others: Mapping[str, Scalar]
    samples: tuple[Shown, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Ask:
    """What is to be shown.

    Args:
        x, y: parameters of the axes; y is None for a line.
        output: `value`, `novelty`, `feasible`, or `feature:K` with K from 0.
        at: values of other parameters; what is not given is that of the best observation.
        z: difficulty at which the value is shown.
        size: grid points along each axis; discrete parameters have as many as they have values.
    """

    x: str
    y: str | None
    output: str = "value"
    at: Mapping[str, object] = field(default_factory=dict)
    z: float = 1.0
    size: int = 40


def axis(space: Space, name: str, size: int) -> Axis:
    """The grid of one parameter.

    Raises:
        BadParams: there is none of that name.
    """
    if name not in space.parameters:
        raise BadParams(f"expected a parameter among {', '.join(space.names)}, found {name!r}")
    parameter = space.parameters[name]
    if parameter.cells is not None:
        unit = (np.arange(parameter.cells) + 0.5) / parameter.cells
        if parameter.cells > size:
            unit = np.linspace(0, 1, size)
        found = list(dict.fromkeys(parameter.from_unit(float(u)) for u in unit))
        unit = np.array([parameter.to_unit(value) for value in found])
    else:
        # the last point of a circle is its first once more: a picture should reach both edges
        unit = np.linspace(0, 1, size)
        found = [parameter.from_unit(float(u)) for u in unit]
        if isinstance(parameter, Angle):
            found[-1] = math.pi
    scale: Scale = "linear"
    if isinstance(parameter, Angle):
        scale = "angle"
    elif isinstance(parameter, Categorical):
        scale = "category"
    elif parameter.log:
        scale = "log"
    return Axis(name, scale, tuple(found), unit)


def centre(known: Surrogates) -> Array:
    """Where a slice goes through if nothing else is said, ``d``: the best observation of the hardest difficulty."""
    record = known.record
    rows = np.flatnonzero(record.complete)
    if not len(rows):
        return np.asarray(known.space.snap(np.full((1, known.space.d), 0.5))[0])
    value = np.where(np.isnan(record.value[rows]), -np.inf, record.value[rows])
    best: Array = record.X[rows[np.lexsort((rows, -value, -np.round(record.z[rows], 2)))[0]]]
    return best


def slice_of(known: Surrogates, ask: Ask, names: tuple[str, ...] = ()) -> Slice:
    """A slice.

    Args:
        known: the study's surrogates.
        ask: what is to be shown.
        names: of the behaviour's coordinates, for messages.

    Raises:
        BadParams: an unknown parameter or output, x and y the same, a value out of range, nothing known yet.
    """
    space = known.space
    x, y = axis(space, ask.x, ask.size), None if ask.y is None else axis(space, ask.y, ask.size)
    if ask.x == ask.y:
        raise BadParams(f"expected two different parameters, found {ask.x!r} twice")
    if len(x.values) * (1 if y is None else len(y.values)) > LARGEST_GRID:
        raise BadParams(f"expected at most {LARGEST_GRID} grid points, found {len(x.values)} x {ask.size}")
    subject, feature = _subject(known, ask.output, names)
    _known_enough(known, subject)
    base = centre(known).copy()
    for name, value in ask.at.items():
        if name not in space.parameters:
            raise BadParams(f"at: expected parameters among {', '.join(space.names)}, found {name!r}")
        try:
            base[space.names.index(name)] = space.parameters[name].to_unit(value)
        except BadParams as error:
            raise BadParams(f"at: parameter {name!r}: {error}") from None
    U = _grid(space, base, x, y)
    with quietly():
        if subject == "value":
            mean, deviation, acquisition, called = _value(known, U, ask.z)
        else:
            mean, deviation, acquisition, called = _behaviour(known, U, ask.output, feature)
        samples = _nearest(known, subject, x, y, base, ask.z, _observed(known, ask.output, feature))
    shape = (1 if y is None else len(y.values), len(x.values))
    axes = {ask.x, ask.y}
    others = {name: value for name, value in space.from_unit(base).items() if name not in axes}
    return Slice(
        x,
        y,
        mean.reshape(shape),
        deviation.reshape(shape),
        None if acquisition is None else acquisition.reshape(shape),
        called,
        others,
        samples,
        _notes(known, subject, ask.z),
    )


def _subject(known: Surrogates, output: str, names: tuple[str, ...]) -> tuple[Subject, int]:
    """Which surrogate an output needs, and the number of its coordinate."""
    features = known.strategy.features
    d = 0 if features is None else features.d
    outputs = ["value", *(["novelty", *(f"feature:{k}" for k in range(d)), "feasible"] if d else [])]
    if output not in outputs:
        said = f" ({', '.join(names)})" if names else ""
        raise BadParams(f"output: expected one of {', '.join(outputs)}{said}, found {output!r}")
    if output == "value":
        return "value", 0
    return "behaviour", int(output.partition(":")[2] or 0)


def _known_enough(known: Surrogates, subject: Subject) -> None:
    if not (known.has_values if subject == "value" else known.has_behaviours):
        raise NothingYet("no trial is complete yet, so there is nothing to fit a surrogate to")


class NothingYet(BadParams):
    """There is nothing to show before the first complete trial."""


def _grid(space: Space, base: Array, x: Axis, y: Axis | None) -> Array:
    """``(ny nx) x d`` unit coordinates."""
    rows = 1 if y is None else len(y.values)
    U = np.tile(base, (rows * len(x.values), 1))
    U[:, space.names.index(x.name)] = np.tile(x.unit, rows)
    if y is not None:
        U[:, space.names.index(y.name)] = np.repeat(y.unit, len(x.values))
    return U


def _value(known: Surrogates, U: Array, z: float) -> tuple[Array, Array, Array | None, str]:
    """Mean, deviation and acquisition of the value in its own unit, ``m`` each."""
    model = known.value_at(z)
    scale = model.scale
    mean, sigma = model.posterior(U, z)
    natural = (mean + scale.trend * (z - 1)) * scale.spread + scale.middle
    acquisition, called = None, ""
    if known.is_own("value"):
        top = known.value_at(1.0)
        scale_top = top.scale
        at_top, deviation = (mean, sigma) if z == 1 else top.posterior(U, 1.0)
        if known.strategy.name == "cmfbo":
            best = to_beat(top, known.record.asked, 1.0)
            acquisition = np.exp(log_expected_improvement(at_top, deviation, best)) * scale_top.spread
            called = "expected improvement at z = 1"
        else:
            t = len(known.record.asked) + 1
            root = math.sqrt(known.strategy.settings.beta * known.space.d * math.log(2 * t + 1))
            acquisition = (at_top + root * deviation) * scale_top.spread + scale_top.middle
            called = "upper confidence bound at z = 1"
    return natural, sigma * scale.spread, acquisition, called


def _behaviour(known: Surrogates, U: Array, output: str, feature: int) -> tuple[Array, Array, Array | None, str]:
    """Mean and deviation of what is asked of the behaviour, and expected novelty times feasibility, ``m`` each."""
    model = known.behaviour
    E = known.space.encode(U)
    feasible = model.probability_feasible(E)
    if output == "feasible":
        return feasible, _feasible_deviation(known, E), None, ""
    rng = np.random.default_rng(0)
    normals = rng.standard_normal((DRAWS, model.embedding.k))
    if output == "novelty":
        parts = [_novelty(known, E[i : i + CHUNK], normals) for i in range(0, len(E), CHUNK)]
        mean, deviation = (np.concatenate(side) for side in zip(*parts, strict=True))
        if known.is_own("behaviour"):
            if not getattr(known.strategy.settings, "feasibility", True):
                return mean, deviation, mean, "expected novelty"
            return mean, deviation, mean * feasible, "expected novelty x probability to be feasible"
        return mean, deviation, None, ""
    posterior, variance = model.behaviour.posterior(E)
    predicted = model.embedding.unembed(posterior)
    sigma = float(model.behaviour.amplitude[0]) * np.sqrt(variance)
    metric = model.embedding.metric
    if metric.kind == "euclidean":
        return predicted[:, feature], sigma * model.embedding.half[feature], None, ""
    spread = np.empty(len(E))
    for i in range(0, len(E), CHUNK):
        part = slice(i, i + CHUNK)
        draws = posterior[part, None, :] + sigma[part, None, None] * normals
        around = model.embedding.unembed(draws.reshape(-1, model.embedding.k)).reshape(*draws.shape[:2], metric.d)
        spread[part] = np.sqrt(np.square(metric.distance(around, predicted[part, None, :])).mean(1))
    return predicted[:, feature], spread, None, ""


def _novelty(known: Surrogates, E: Array, normals: Array) -> tuple[Array, Array]:
    """Distance to the nearest known behaviour: its expectation and deviation under the posterior, ``m`` each."""
    model = known.behaviour
    mean, variance = model.behaviour.posterior(E)
    sigma = model.behaviour.amplitude * np.sqrt(variance)[:, None]
    if not len(model.archive):
        return sigma[:, 0], np.zeros(len(E))
    draws = mean[:, None, :] + sigma[:, None, :] * normals
    distance = model.embedding.nearest(draws, model.archive)
    return distance.mean(1), distance.std(1)


def _feasible_deviation(known: Surrogates, E: Array) -> Array:
    """Deviation of the probability that a trial completes, from its latent score."""
    process = known.behaviour.feasible
    if process is None:
        return np.zeros(len(E))
    mean, variance = process.posterior(E)
    sigma = process.amplitude[0] * np.sqrt(variance)
    normals = np.random.default_rng(0).standard_normal(DRAWS)
    return np.asarray(ndtr((mean + sigma[:, None] * normals) / math.sqrt(0.1)).std(1))


def _observed(known: Surrogates, output: str, feature: int) -> Array:
    """What each observation showed of the output, ``n``; NaN where nothing."""
    record = known.record
    if output == "value":
        return np.where(record.complete, record.value, np.nan)
    if output == "feasible":
        return record.complete.astype(float)
    if output == "novelty":
        return np.full(record.n, np.nan)
    return record.features[:, feature]


def _nearest(
    known: Surrogates, subject: Subject, x: Axis, y: Axis | None, base: Array, z: float, observed: Array
) -> tuple[Shown, ...]:
    """The observations nearest to a slice, as its surrogate measures nearness, in the order of the record."""
    space, record = known.space, known.record
    foot = np.tile(base, (record.n, 1))
    for side in (x, y):
        if side is not None:
            i = space.names.index(side.name)
            foot[:, i] = record.X[:, i]
    w = known.process(subject, z).w
    gap = (space.encode(record.X) - space.encode(foot)) * w[: space.e]
    square = np.square(gap).sum(1)
    if subject == "value":
        square = square + np.square((record.z - z) * w[-1])
    near = matern52(np.sqrt(square))
    chosen = np.sort(np.argsort(-near, kind="stable")[:MOST_SAMPLES])
    return tuple(Shown(int(i), float(observed[i]), float(near[i])) for i in chosen)


def _notes(known: Surrogates, subject: Subject, z: float) -> tuple[str, ...]:
    notes = [_whose(known, subject)]
    of = known.record.n
    if subject == "value" and known.values[1] is not None:
        probability = known.values[2]
        alone = known.value_at(z) is known.values[1]
        if alone:
            of = int((known.record.z == 1).sum())
            notes.append(
                f"It is of z = 1 alone: easier levels help to predict it with a probability of {probability:.0%} only."
            )
        elif probability >= EVEN:
            notes.append(
                f"Easier levels are in it: they help to predict z = 1 with a probability of {probability:.0%}."
            )
        else:
            notes.append(
                f"Easier levels are in it because one is shown; at z = 1 they help with a probability of "
                f"{probability:.0%} only, and are left out there."
            )
    if subject == "value" and not known.record.complete.all():
        worst = float(np.min(imputed(known.record)))
        notes.append(f"Trials that failed count as the worst value seen, {worst:.4g}.")
    conditioned, n = len(known.process(subject, z).X), known.record.n
    if conditioned < of and subject == "value":
        notes.append(f"It stands on {conditioned} of {of} observations: the best of them, and others spread out.")
    if n > MOST_SAMPLES:
        notes.append(f"The {MOST_SAMPLES} observations nearest to the slice are shown, of {n}.")
    return tuple(notes)


def _whose(known: Surrogates, subject: Subject) -> str:
    """Whether the study's search proposes from this surrogate."""
    name = known.strategy.name
    if known.is_own(subject):
        return f"The surrogate that {name} proposes from."
    if known.models(subject):
        return f"A surrogate fitted for looking: {name} as published proposes from one that is fitted in another way."
    return f"A surrogate fitted for looking: {name} does not propose from one of the {subject}."


def foot_of(space: Space, params: Mapping[str, Scalar], name: str) -> Scalar:
    """A parameter of a candidate as an axis shows it: angles between -pi and pi, whole numbers whole."""
    parameter = space.parameters[name]
    value = params[name]
    if isinstance(parameter, Angle):
        return parameter.from_unit(parameter.to_unit(value))
    return int(value) if isinstance(parameter, Int) else value
