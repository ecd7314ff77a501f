"""Bayesian diversity search, repaired.

What differs from the published algorithm, and why (`benchmarks.search.ablations` takes them away one by one):

- *Start*: a few Sobol points, since a surrogate of two points has nothing to say.
- *Priors*: length scales, noise and amplitude are fitted by maximum a posteriori (`search.surrogate.fit`).
- *Geometry*: circles and rotations are modelled as what they are (`search.surrogate.embedding`), angles of the search
  space are circles to the kernel.
- *Feasibility*: a second process learns from failures where trials fail; proposals are weighed by the probability that
  they don't.
- *One acquisition*: the expected distance to the nearest known behaviour under the whole posterior already prefers the
  unknown; nothing has to alternate. The distance counts up to a cap, beyond which a behaviour is new anyway.
- *Faces*: proposals keep away from the faces of the box, where the posterior deviation always is largest, by distances
  that take turns (`INSETS`): rare behaviours may lie in the middle as well as near the faces.
- *Repetition*: a candidate nearer than a small radius to anything asked for is not proposed again.
- *Pending* trials are believed to show what the posterior expects (kriging believer); a batch is proposed one by one.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr

from search.designs import next_sobol, sobol_points
from search.features import Features
from search.record import Record
from search.space import Array, Space
from search.surrogate.embedding import Embedding
from search.surrogate.fit import Fit, Prior, fit_map, keep
from search.surrogate.gp import GaussianProcess, IllConditioned, scaled_distance
from search.surrogate.milestones import milestone
from search.surrogate.subset import farthest_first

FIT_POINTS = 160
"""Hyperparameters are fitted to at most so many observations."""
MODEL_POINTS = 500
"""The posterior is conditioned on at most so many."""
ARCHIVE_POINTS = 96
"""Distances are taken to at most so many known behaviours, farthest first."""
SOBOL_POOL = 512
REFINE = ((12, 16, 0.15), (8, 16, 0.05))
"""Rounds of refinement: survivors, perturbations of each, their radius in unit coordinates."""


@dataclass(frozen=True, slots=True)
class Models:
    """What was fitted to a history."""

    behaviour: Fit
    feasibility: Fit


class DiversityModel:
    """Surrogates of behaviour and feasibility, conditioned on a record.

    Args:
        space, metric: of the study.
        record: what is known.
        fitted: hyperparameters.
        feasibility: whether failures are modelled; otherwise their points only count as asked for.
    """

    def __init__(self, space: Space, metric: Features, record: Record, fitted: Models, *, feasibility: bool) -> None:
        self.space = space
        self.embedding = Embedding(metric)
        k = self.embedding.k
        known = np.flatnonzero(record.known)
        E = space.encode(record.X)
        keep = known[farthest_first(E[known] * fitted.behaviour.w, MODEL_POINTS)]
        V = self.embedding.embed(record.features[keep]) if len(keep) else np.empty((0, k))
        self.behaviour = GaussianProcess(
            E[keep], V, fitted.behaviour.w, np.full(k, fitted.behaviour.amplitude), fitted.behaviour.noise, np.zeros(k)
        )
        archive = np.flatnonzero(record.known & record.complete)
        all_known = self.embedding.embed(record.features[archive]) if len(archive) else np.empty((0, k))
        self.archive = all_known[farthest_first(all_known, ARCHIVE_POINTS)]
        self.feasible: GaussianProcess | None = None
        if feasibility and not record.complete.all():
            rows = farthest_first(E * fitted.feasibility.w, MODEL_POINTS)
            labels = np.where(record.complete[rows], 1.0, -1.0)[:, None]
            self.feasible = GaussianProcess(
                E[rows],
                labels,
                fitted.feasibility.w,
                np.full(1, fitted.feasibility.amplitude),
                fitted.feasibility.noise,
                np.full(1, PRIOR_FEASIBLE),
            )

    def believe(self, U: Array) -> None:
        """Take ``p x d`` points to show what the posterior expects; later proposals know of them."""
        if len(U):
            E = self.space.encode(U)
            mean = self.behaviour.mean_at(E)
            self.behaviour = self.behaviour.with_data(
                E, mean, float(np.mean(self.behaviour.noise)) if len(self.behaviour.X) else 1e-3
            )

    def probability_feasible(self, E: Array) -> Array:
        """``m``, of ``m x e`` model coordinates."""
        if self.feasible is None:
            return np.ones(len(E))
        mean, variance = self.feasible.posterior(E)
        sigma = self.feasible.amplitude[0] * np.sqrt(variance)
        return np.asarray(ndtr(mean[:, 0] / np.sqrt(0.1 + sigma**2)))

    def expected_novelty(self, E: Array, normals: Array, cap: float, known: Array) -> Array:
        """E[min(distance to the nearest known behaviour, cap)], ``m``, over ``N x k`` common normal draws."""
        mean, variance = self.behaviour.posterior(E)
        sigma = self.behaviour.amplitude * np.sqrt(variance)[:, None]
        draws = mean[:, None, :] + sigma[:, None, :] * normals
        if not len(known):
            return sigma[:, 0]
        return np.asarray(np.minimum(self.embedding.nearest(draws, known), cap).mean(1))


PRIOR_FEASIBLE = 0.6
"""Prior mean of the feasibility label (1 complete, -1 not): most trials succeed."""


def fit_models(space: Space, metric: Features, record: Record, *, believed: Callable[[Prior], Prior] = keep) -> Models:
    """Hyperparameters for behaviour and feasibility from the first observations of a record.

    Args:
        space: of the study.
        metric: of the study.
        record: what is known.
        believed: what is made of the priors; as they are, or `flat`.
    """
    m = milestone(record.n)
    E = space.encode(record.X[:m])
    known = np.flatnonzero(record.known[:m])
    embedding = Embedding(metric)
    scale = math.sqrt(max(1.0, space.d / 4))
    prior = believed(Prior(length=0.5 * scale, amplitude=embedding.amplitude, noise=1e-2))
    rows = known[farthest_first(E[known], FIT_POINTS)]
    V = embedding.embed(record.features[rows]) if len(rows) else np.empty((0, embedding.k))
    behaviour = fit_map(E[rows], V, space.owner, prior)
    rows = farthest_first(E, FIT_POINTS)
    labels = np.where(record.complete[rows], 1.0, -1.0)[:, None] - PRIOR_FEASIBLE
    prior = believed(Prior(length=0.4 * scale, noise=5e-2, length_spread=0.5))
    feasibility = fit_map(E[rows], labels, space.owner, prior)
    return Models(behaviour, feasibility)


def propose(
    space: Space,
    metric: Features,
    record: Record,
    count: int,
    rng: np.random.Generator,
    settings: Any,
    fitted: Models,
    form: type[DiversityModel] = DiversityModel,
) -> list[tuple[Array, dict[str, Any]]]:
    """`count` points, one after the other, each pending for the next.

    Returns:
        Unit coordinates ``d`` and the reasons for each.
    """
    start = settings.start
    asked = len(record.asked)
    proposals: list[tuple[Array, dict[str, Any]]] = []
    if asked < start:
        points = next_sobol(space, record.asked, min(count, start - asked), settings.seed)
        proposals = [(u, {"mode": "start"}) for u in points]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", IllConditioned)
        model = form(space, metric, record, fitted, feasibility=settings.feasibility)
        model.believe(np.concatenate([record.pending, *(u[None, :] for u, _ in proposals)]))
        normals = rng.standard_normal((settings.samples, model.embedding.k))
        taken = [*record.asked, *(u for u, _ in proposals)]
        while len(proposals) < count:
            turn = asked + len(proposals)
            u, info = _next(model, space, np.array(taken).reshape(-1, space.d), normals, turn, rng, settings)
            proposals.append((u, info))
            taken.append(u)
            model.believe(u[None, :])
    told = sorted({str(w.message) for w in caught if issubclass(w.category, IllConditioned)})
    told += [*fitted.behaviour.warnings, *fitted.feasibility.warnings]
    if told:
        for _, info in proposals:
            info["warnings"] = told
    return proposals


def _pool(space: Space, rng: np.random.Generator, inset: float) -> Array:
    """Where the search for one proposal begins, ``m x d``; `inset` away from the faces, or many of it on them if 0."""
    pool = sobol_points(space, 0, SOBOL_POOL, int(rng.integers(2**31)))
    straight = ~(space.is_periodic() | space.is_categorical())
    if inset:
        inner = np.where(straight, inset + (1 - 2 * inset) * pool, pool)
        return space.snap(inner)
    snapped = np.where((rng.random(pool.shape) < 0.5) & straight, np.round(pool), pool)
    return np.concatenate([pool, space.snap(snapped)])


INSETS = (0.25, 0.15, 0.05)
"""How far proposals keep from the faces, in unit coordinates, in turn."""


def _next(
    model: DiversityModel,
    space: Space,
    taken: Array,
    normals: Array,
    turn: int,
    rng: np.random.Generator,
    settings: Any,
) -> tuple[Array, dict[str, Any]]:
    """The next point ``d`` and its reasons."""
    inset = INSETS[turn % len(INSETS)] if settings.interior else 0.0
    straight = ~(space.is_periodic() | space.is_categorical())
    pool = _pool(space, rng, inset)
    taken_e, plain = space.encode(taken), np.ones(space.e)
    radius = settings.radius * math.sqrt(space.d)
    cap = settings.cap if settings.cap is not None else math.inf

    def score(U: Array) -> tuple[Array, Array, Array]:
        E = space.encode(U)
        novelty = model.expected_novelty(E, normals, cap, model.archive)
        feasible = model.probability_feasible(E)
        gap = scaled_distance(E, taken_e, plain).min(1) if len(taken) else np.ones(len(E))
        penalty = np.clip(gap / radius, 0, 1) if radius > 0 else 1.0
        return novelty * feasible * penalty, novelty, feasible

    values, novelty, feasible = score(pool)
    for survivors, children, spread in REFINE:
        best = np.argsort(-values, kind="stable")[:survivors]
        step = rng.standard_normal((survivors, children, space.d)) * spread
        near = (pool[best][:, None, :] + step).reshape(-1, space.d)
        if inset:
            near = np.where(straight, np.clip(near, inset, 1 - inset), near)
        near = np.where(space.is_periodic(), near % 1.0, near)
        near = space.snap(near)
        more = score(near)
        pool = np.concatenate([pool[best], near])
        values, novelty, feasible = (
            np.concatenate([a[best], b]) for a, b in zip((values, novelty, feasible), more, strict=True)
        )
    at = int(np.argmax(values))
    u = pool[at]
    mean = model.behaviour.mean_at(space.encode(u[None, :]))
    return u, {
        "mode": "diversify",
        "inset": inset,
        "acquisition": float(values[at]),
        "novelty": float(novelty[at]),
        "feasible": float(feasible[at]),
        "predicted": model.embedding.unembed(mean)[0].tolist(),
    }
