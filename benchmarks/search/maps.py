"""Synthetic strategy maps: from take-off parameters to behaviours, with a known number of distinct strategies.

Three families. *Regions*: the box is cut into regions by the largest of several quadratic scores (a power diagram with
a metric for each centre); every region is one strategy, some regions fail. Offsets are calibrated so that the regions
have given shares of the volume; centres lie at faces or in the interior. *Folds*: a smooth random function of the
parameters is pulled towards the nearest of several attractors, which leaves flat plateaus with jumps between them; its
extremes lie mostly at the faces, bumps put rare ones into the interior. *Flights*: the body leaves the ground facing
alpha with an angular velocity omega and turns for as long as the flight takes; training ends at the nearest of several
attractors of the resulting pose. Nothing is calibrated: extreme poses need extreme take-offs, and the hardest
take-offs fail.

Within a strategy the behaviour still varies: it drifts a little, and near a border it leans towards the neighbour, by
less than half of the distance between strategies altogether. The number of strategies found by a search is the number
of regions (attractors) it has hit with a trial that didn't fail.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from search import Angle, Categorical, Features, Float, Int, Space

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StrategyMap:
    """A map with a known answer.

    Args:
        name: as tables print it.
        d: number of parameters.
        metric: `circle`, `rotation` or `plane` (vectors in [-1, 1]^2).
        family: `regions`, `folds` or `flights`.
        shares: share of the volume of each strategy, before failures. In `folds` the large ones lie in the middle of
            the range of behaviours, the rare ones at its ends; in `flights` only their number counts.
        interior: how many of the rarest strategies lie in the interior instead of at a face.
        fails: share of the volume that fails.
        noise: standard deviation of the behaviour's noise, as a fraction of the distance between strategies.
        flaky: probability that a trial fails for no reason.
        relevant: how many parameters matter.
        angles: how many of the parameters are full circles.
        mixed: whether the last two parameters are an integer and a category.
    """

    name: str
    d: int
    metric: str
    family: str
    shares: tuple[float, ...]
    interior: int = 0
    fails: float = 0.0
    noise: float = 0.0
    flaky: float = 0.0
    relevant: int | None = None
    angles: int = 0
    mixed: bool = False
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __hash__(self) -> int:
        return hash(self.name)

    @property
    def space(self) -> Space:
        """Angles first, then floats in [-3, 3], then what is mixed in."""
        parameters: dict[str, Any] = {}
        for i in range(self.d):
            if i < self.angles:
                parameters[f"alpha_{i}"] = Angle()
            elif self.mixed and i == self.d - 1:
                parameters["foot"] = Categorical(("left", "right", "both"))
            elif self.mixed and i == self.d - 2:
                parameters["steps"] = Int(1, 6)
            else:
                parameters[f"omega_{i}"] = Float(-3, 3)
        return Space(parameters)

    @property
    def features(self) -> Features:
        """The feature space."""
        if self.metric == "circle":
            return Features.circle()
        return Features.rotation() if self.metric == "rotation" else Features.euclidean(2, low=-1, high=1)

    @property
    def count(self) -> int:
        """How many distinct strategies there are to find."""
        return len(self.shares)

    def label(self, params: Mapping[str, Any]) -> int:
        """Which strategy these parameters lead to; -1 where they fail."""
        return int(world(self).labels(self.space.to_unit(params)[None, :])[0])

    def evaluate(self, params: Mapping[str, Any], rng: np.random.Generator) -> tuple[int, list[float] | None]:
        """Strategy and behaviour of one trial; -1 and None where it failed."""
        w = world(self)
        u = self.space.to_unit(params)[None, :]
        label = int(w.labels(u)[0])
        if label < 0 or rng.random() < self.flaky:
            return -1, None
        return label, w.behaviour(u[0], label, rng)


LEAN = 0.3
"""How far a behaviour leans towards the neighbouring strategy at the border between them, in their distance."""


class World:
    """The random pieces of a map, drawn from its name.

    Args:
        m: the map.
        points: how many points shares are calibrated on.
        like: a world whose attractors are taken over; which parameters lead where does not depend on them, except in
            `flights`.
    """

    def __init__(self, m: StrategyMap, points: int = 4096, like: World | None = None) -> None:
        self.m = m
        rng = np.random.default_rng(zlib.crc32(m.name.encode()))
        self.relevant = rng.permutation(m.d)[: m.relevant or m.d]
        self.attractors, self.gap = (like.attractors, like.gap) if like else self._attractors(rng)
        self.sample = m.space.snap(qmc.Sobol(m.d, rng=np.random.default_rng(0)).random(points))
        # a slow drift within each strategy
        self.drift = rng.standard_normal((m.d, 3))
        self.phase = rng.uniform(0, 2 * np.pi, 3)
        {"regions": self._regions, "folds": self._folds, "flights": self._flights}[m.family](rng)

    # ---- behaviours

    def _attractors(self, rng: np.random.Generator) -> tuple[Array, float]:
        m = self.m
        k = len(m.shares)
        if m.metric == "circle":
            angles = (np.arange(k) + 0.5) / k * 2 * np.pi - np.pi
            return angles[:, None], 2 * np.pi / k
        plane = m.metric == "plane"
        pool = rng.uniform(-0.9, 0.9, (4000, 2)) if plane else Rotation.random(4000, rng=rng).as_quat()
        chosen = [pool[0]]
        while len(chosen) < k:
            gaps = m.features.pairwise(pool, np.array(chosen)).min(1)
            chosen.append(pool[int(np.argmax(gaps))])
        Y = np.array(chosen)
        gaps = m.features.pairwise(Y, Y) + np.eye(k) * 1e9
        # neighbours in the list should be similar behaviours, as neighbouring parameters often are
        order, left = [0], set(range(1, k))
        while left:
            near = min(left, key=lambda j: gaps[order[-1], j])
            order.append(near)
            left.remove(near)
        return Y[order], float(gaps.min())

    def behaviour(self, u: Array, label: int, rng: np.random.Generator) -> list[float]:
        """What a trial at unit coordinates ``d`` with this label shows."""
        m = self.m
        drift = np.sin(self._periodic(u) @ self.drift * 2 + self.phase) * self.gap * 0.15 / math.sqrt(3)
        drift = drift + rng.standard_normal(3) * m.noise * self.gap
        y = self.attractors[label]
        other, closeness = self._leaning(u, label)
        if m.metric == "circle":
            toward = (self.attractors[other][0] - y[0] + np.pi) % (2 * np.pi) - np.pi
            lean = np.sign(toward) * min(abs(toward), self.gap) * LEAN * closeness
            return [float((y[0] + lean + drift[0] + np.pi) % (2 * np.pi) - np.pi)]
        if m.metric == "plane":
            toward = self.attractors[other] - y
            lean = toward * min(1.0, self.gap / max(float(np.linalg.norm(toward)), 1e-9)) * LEAN * closeness
            return [float(v) for v in y + lean + drift[:2]]
        turn = (Rotation.from_quat(self.attractors[other]) * Rotation.from_quat(y).inv()).as_rotvec()
        turn *= min(1.0, self.gap / max(float(np.linalg.norm(turn)), 1e-9)) * LEAN * closeness
        return [float(v) for v in (Rotation.from_rotvec(drift + turn) * Rotation.from_quat(y)).as_quat()]

    def _leaning(self, u: Array, label: int) -> tuple[int, float]:
        """The strategy next to this one, and how near its border is: 0 far inside, 1 at the border."""
        if self.m.family == "regions":
            score = (self._scores(u[None, :]) + self.offset)[0, : self.k]
            order = np.argsort(-score)
            return int(order[1]), float(np.exp(-(score[order[0]] - score[order[1]]) / 0.5))
        if self.m.family == "flights":
            gaps = self.m.features.pairwise(self._pose(u[None, :]), self.attractors)[0]
            order = np.argsort(gaps)
            return int(order[1]), float(np.exp(-2 * (gaps[order[1]] - gaps[order[0]]) / self.gap))
        t = float(self._latent_raw(u[None, :])[0])
        width = float(np.ptp(self.cuts)) / len(self.cuts)
        below = t - self.cuts[label - 1] if label > 0 else np.inf
        above = self.cuts[label] - t if label < len(self.cuts) else np.inf
        return label + (1 if above < below else -1), float(np.exp(-2 * min(above, below) / width))

    def _periodic(self, U: Array) -> Array:
        """Centred coordinates; angles enter through their sine so that nothing jumps at the seam."""
        V = np.atleast_2d(U) - 0.5
        angular = self.m.space.is_periodic()
        V = np.where(angular, 0.5 * np.sin(2 * np.pi * np.atleast_2d(U)), V)
        return V if U.ndim > 1 else V[0]

    # ---- regions

    def _regions(self, rng: np.random.Generator) -> None:
        m = self.m
        k = len(m.shares)
        fails = max(1, m.d // 3) if m.fails else 0
        target = np.array(
            [*(s * (1 - m.fails) / sum(m.shares) for s in m.shares), *([m.fails / max(fails, 1)] * fails)]
        )
        order = np.argsort(target[:k])
        centres = rng.uniform(0.1, 0.9, (len(target), m.d))
        for i in range(len(target)):
            rare = i < k and target[i] < 0.12
            if i in order[: m.interior]:
                centres[i] = rng.uniform(0.3, 0.7, m.d)
            elif rare or i >= k:
                # rare strategies and failures belong to extreme take-offs: an edge or a corner of the box
                least = max(1, len(self.relevant) // 2)
                faces = rng.permutation(self.relevant)[: rng.integers(least, len(self.relevant) + 1)]
                centres[i, faces] = rng.integers(0, 2, len(faces))
        # strategies that lie next to each other along one direction are neighbours in behaviour, too
        self.attractors = self.attractors[np.argsort(np.argsort(centres[:k] @ rng.standard_normal(m.d)))]
        self.centres = centres
        scale = np.zeros((len(target), m.d))
        scale[:, self.relevant] = rng.uniform(1.0, 2.5, (len(target), len(self.relevant)))
        # rare regions are compact
        scale *= np.sqrt(np.clip(0.2 / target, 0.5, 3.0))[:, None]
        self.scale = scale
        self.offset = np.zeros(len(target))
        scores = self._scores(self.sample)
        for step in range(600):
            share = np.bincount(np.argmax(scores + self.offset, 1), minlength=len(target)) / len(scores)
            self.offset += 0.5 / (1 + step / 100) * np.clip(np.log(target / np.maximum(share, 1e-3)), -1, 1) * 0.2
        self.k = k

    def _scores(self, U: Array) -> Array:
        gap = U[:, None, :] - self.centres
        angular = self.m.space.is_periodic()
        gap = np.where(angular, np.sin(np.pi * gap) / np.pi, gap)
        return np.asarray(-np.square(gap * self.scale).sum(2))

    # ---- folds

    def _folds(self, rng: np.random.Generator) -> None:
        m = self.m
        r = len(self.relevant)
        self.waves = rng.standard_normal((r, 6)) * 1.5 / math.sqrt(r)
        self.shift = rng.uniform(0, 2 * np.pi, 6)
        self.weight = rng.standard_normal(6) * 0.4
        self.slope = rng.standard_normal(r) * 1.6 / math.sqrt(r)
        self.bumps = rng.uniform(0.3, 0.7, (m.interior, r))
        self.heights = np.where(np.arange(m.interior) % 2 == 0, 1.0, -1.0)
        raw = self._latent_raw(self.sample)
        shares = np.sort(np.array(m.shares))
        self.cuts = np.quantile(raw, np.cumsum(np.concatenate([shares[::2], shares[1::2][::-1]]))[:-1])
        if m.fails:
            self.fail_waves = rng.standard_normal((r, 4)) * 3 / math.sqrt(r)
            self.fail_shift = rng.uniform(0, 2 * np.pi, 4)
            self.fail_level = -np.inf
            self.fail_level = float(np.quantile(self._fail_raw(self.sample), 1 - m.fails))

    def _latent_raw(self, U: Array) -> Array:
        V = self._periodic(U)[:, self.relevant]
        out = V @ self.slope + np.sin(2 * V @ self.waves + self.shift) @ self.weight
        for c, h in zip(self.bumps, self.heights, strict=True):
            r2 = np.square(U[:, self.relevant] - c).sum(1)
            out = out + h * 2.2 * np.exp(-r2 / (2 * 0.17**2 * max(1, len(self.relevant) / 3)))
        return np.asarray(out)

    def _fail_raw(self, U: Array) -> Array:
        V = self._periodic(U)[:, self.relevant]
        return np.asarray(np.sin(V @ self.fail_waves + self.fail_shift).sum(1))

    # ---- flights

    def _flights(self, rng: np.random.Generator) -> None:
        m = self.m
        self.mix = rng.standard_normal((m.d, 3)) / math.sqrt(max(1, len(self.relevant) - m.angles))
        self.mix[: m.angles] = 0.0
        self.mix[[i for i in range(m.d) if i not in self.relevant]] = 0.0
        self.tilt = rng.standard_normal(3)
        self.tilt /= np.linalg.norm(self.tilt)
        self.fail_lean = rng.standard_normal(3)
        speed = np.linalg.norm(self._omega(self.sample), axis=1)
        # the fastest take-offs turn the body by three quarters of a turn on the way to the bar
        self.flight = 1.5 * np.pi / float(np.quantile(speed, 0.999))
        self.fail_level = np.inf
        self.fail_level = float(np.quantile(self._strain(self.sample), 1 - m.fails)) if m.fails else np.inf
        poses = self._pose(self.sample[self._strain(self.sample) <= self.fail_level])
        # attractors: well apart, among poses that are reached, and each of them by at least one take-off in a hundred
        chosen = [poses[int(rng.integers(len(poses)))]]
        dense = m.features.pairwise(poses[:1024], poses[:1024])
        reach = 2.0 * float(np.quantile(np.sort(dense, 1)[:, 10], 0.5))
        crowded = (dense < max(reach, 0.15 * m.features.diameter)).mean(1) > 0.01
        pool = poses[:1024][crowded]
        while len(chosen) < len(m.shares):
            gaps = m.features.pairwise(pool, np.array(chosen)).min(1)
            chosen.append(pool[int(np.argmax(gaps))])
        self.attractors = np.array(chosen[: len(m.shares)])
        between = m.features.pairwise(self.attractors, self.attractors) + np.eye(len(chosen)) * 1e9
        self.gap = float(between.min())

    def _omega(self, U: Array) -> Array:
        """Angular velocities ``n x 3``."""
        return np.asarray(2 * (U - 0.5) @ self.mix)

    def _pose(self, U: Array) -> Array:
        """How the body would pass the bar, ``n x D``: what training starts from."""
        m = self.m
        turn = self._omega(U) * self.flight
        alpha = (U[:, 0] - 0.5) * 2 * np.pi if m.angles and 0 in self.relevant else np.zeros(len(U))
        if m.metric == "circle":
            # only the turn about the bar's axis is told apart, of which facing changes the share
            angle = turn[:, 0] * np.cos(alpha) + turn[:, 1] * np.sin(alpha) if m.angles else turn[:, 0]
            return np.asarray((angle[:, None] + np.pi) % (2 * np.pi) - np.pi)
        facing = Rotation.from_rotvec(np.stack([np.zeros(len(U)), np.zeros(len(U)), alpha], 1))
        pose = Rotation.from_rotvec(turn) * facing
        if m.metric == "rotation":
            return m.features.canonical(pose.as_quat())
        return np.asarray(pose.apply(self.tilt)[:, :2] * 0.9)

    def _strain(self, U: Array) -> Array:
        """How hard a take-off is."""
        omega = self._omega(U)
        return np.asarray(np.linalg.norm(omega, axis=1) + 0.5 * np.sin(omega @ self.fail_lean + 2 * U[:, -1] * np.pi))

    def labels(self, U: Array) -> NDArray[np.int64]:
        """Strategy of each of ``n x d`` unit points, -1 for failure."""
        if self.m.family == "flights":
            nearest = np.argmin(self.m.features.pairwise(self._pose(U), self.attractors), 1)
            return np.where(self._strain(U) > self.fail_level, -1, nearest)
        if self.m.family == "regions":
            found = np.argmax(self._scores(U) + self.offset, 1)
            return np.where(found < self.k, found, -1)
        found = np.searchsorted(self.cuts, self._latent_raw(U))
        return np.where(self._fail_raw(U) > self.fail_level, -1, found) if self.m.fails else found


@cache
def world(m: StrategyMap) -> World:
    """The pieces of a map, once a process."""
    return World(m)
