"""Synthetic multi-fidelity objectives with known optimum: what a training reaches, by settings and difficulty.

Built like curricula: an easy task (low z) is cheap, has a broad optimum and high values; the real one (z = 1) has a
narrow optimum nearby, so that the regions of good settings overlap between difficulties and the values don't.

    f(x, z) = (1 + easy (1 - z)) max over peaks p of h_p exp(-q_p(x, z)^s / 2),
    q_p(x, z) = |A_p (x - c_p - shift_p (1 - z))|^2 / (width (1 + widen (1 - z)))^2

The first peak has h = 1; the optimum of the real task is 1. Three other shapes move and widen alike:

- `valley`: 1 / (1 + q), q rising slowly along a bent valley and steeply across it, with heavy tails instead of none.
- `cliff`: a slope towards the optimum inside a region outside of which nothing is learnt at all.
- `hartmann`: the six-dimensional function of Hartmann, divided by its maximum.

Evaluating at z costs 0.1 + 0.9 z of a full evaluation. With transfer, a warm start from a near and good enough
evaluation saves up to 60 % of that. Each seed of a benchmark sees another instance: other centres, other directions.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from search import Categorical, Float, Int, Space

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Objective:
    """An objective with a known answer.

    Args:
        name: as tables print it.
        d: number of parameters.
        relevant: how many of them matter.
        peaks: number of peaks of the real task; all but the first reach 0.4 to 0.75.
        width: of the peaks, in ranges, for each of the relevant dimensions together.
        shift: how far the optimum moves from z = 1 to z = 0, in ranges.
        widen: how much broader the optimum is at z = 0.
        easy: how much higher values are at z = 0.
        low: `informative`, `none` (easy tasks have unrelated optima) or `deceptive` (a false peak grows as z falls).
        noise: standard deviation of a value.
        mixed: whether two parameters are integers and one a category.
        shape: `peaks`, `valley`, `cliff` or `hartmann` (six relevant parameters).
        instance: which draw of centres and directions.
    """

    name: str
    d: int
    relevant: int
    peaks: int = 3
    width: float = 0.45
    shift: float = 0.15
    widen: float = 1.0
    easy: float = 0.5
    low: str = "informative"
    noise: float = 0.01
    mixed: bool = False
    shape: str = "peaks"
    instance: int = 0

    @property
    def space(self) -> Space:
        """Log floats and floats; integers and a category where it is mixed."""
        parameters: dict[str, Any] = {}
        for i in range(self.d):
            if self.mixed and i == self.d - 1:
                parameters["kind"] = Categorical(("a", "b", "c"))
            elif self.mixed and i in {1, 3}:
                parameters[f"n_{i}"] = Int(1, 12)
            else:
                parameters[f"x_{i}"] = Float(1e-5, 1e-1, log=True) if i % 2 == 0 else Float(0, 1)
        return Space(parameters)

    def cost(self, z: float) -> float:
        """Of an evaluation from scratch, in full evaluations."""
        return 0.1 + 0.9 * z

    def value(self, u: Array, z: float) -> float:
        """Without noise, at unit coordinates ``d``; at most 1 where z is 1."""
        return landscape(self).value(u, z)

    def evaluate(
        self,
        params: Mapping[str, Any],
        z: float,
        parent: tuple[Mapping[str, Any], float] | None,
        rng: np.random.Generator,
    ) -> tuple[float, float]:
        """Noisy value and cost; `parent` are parameters and difficulty of the policy to start from, if it transfers."""
        u = self.space.to_unit(params)
        cost = self.cost(z)
        if parent is not None:
            v = self.space.to_unit(parent[0])
            near = math.exp(-float(np.square((u - v) / 0.3).sum()) / self.relevant)
            skill = min(1.0, 2 * self.value(v, parent[1]))
            cost *= 1 - 0.6 * near * skill * math.exp(-2 * abs(z - parent[1]))
        return float(self.value(u, z) + rng.standard_normal() * self.noise), cost


class Landscape:
    """The random pieces of an objective, drawn from its name."""

    def __init__(self, o: Objective) -> None:
        self.o = o
        rng = np.random.default_rng((zlib.crc32(o.name.encode()), o.instance))
        self.dims = rng.permutation(o.d)[: o.relevant]
        r = o.relevant
        u = o.space.snap(rng.uniform(0.15, 0.85, (o.peaks + 2, o.d)))
        self.centres = u[: o.peaks][:, self.dims]
        self.heights = np.concatenate([[1.0], rng.uniform(0.4, 0.75, o.peaks - 1)])
        direction = rng.standard_normal((o.peaks, r))
        self.shift = o.shift * direction / np.linalg.norm(direction, axis=1, keepdims=True)
        # a rotation close to the identity, and weights of a few to one
        Q = np.linalg.qr(np.eye(r) + 0.3 * rng.standard_normal((r, r)))[0]
        self.A = Q * rng.uniform(0.6, 1.6, r)[:, None]
        self.false = u[-1][self.dims]
        self.unrelated = u[-2][self.dims]

    def value(self, u: Array, z: float) -> float:
        """Without noise, at unit coordinates ``d``."""
        o = self.o
        x = u[self.dims]
        ease = 1 - z
        width = o.width * math.sqrt(o.relevant / 4) * (1 + o.widen * ease)
        if o.low == "none" and z < 1:
            # the further from the real task, the more of another one
            other = self._bump(x - self.unrelated, width)
            own = self._peaks(x, 0.0, o.width * math.sqrt(o.relevant / 4))
            return (1 + o.easy * ease) * float(own * max(0.0, 1 - 3 * ease) + other * min(1.0, 3 * ease))
        found = self._own(x, ease, width)
        if o.low == "deceptive":
            found = max(found, self._bump(x - self.false, width) * (0.3 + 1.0 * ease))
        return (1 + o.easy * ease) * found

    def _own(self, x: Array, ease: float, width: float) -> float:
        """The objective's own optima, without the higher values of easy tasks."""
        if self.o.shape == "peaks":
            return self._peaks(x, ease, width)
        gap = x - self.centres[0] - self.shift[0] * ease
        if self.o.shape == "hartmann":
            return hartmann6(HARTMANN_BEST + gap / (1 + 0.25 * ease)) / HARTMANN_MAXIMUM
        if self.o.shape == "cliff":
            r = math.sqrt(float(np.square(self.A @ gap).sum())) / (1.6 * width)
            return 0.0 if r >= 1 else (1 - r) ** 1.5
        t = 3 * (self.A @ gap)
        across = float(np.square(t[1:] - 0.7 * t[:-1] ** 2).sum())
        return 1 / (1 + (4 * across + float(np.square(t).sum())) / (8 * width**2))

    def _peaks(self, x: Array, ease: float, width: float) -> float:
        return max(
            h * self._bump(x - c - s * ease, width)
            for h, c, s in zip(self.heights, self.centres, self.shift, strict=True)
        )

    def _bump(self, gap: Array, width: float) -> float:
        q = float(np.square(self.A @ gap).sum()) / width**2
        return math.exp(-0.5 * q * 2)


HARTMANN_A = np.array(
    [[10, 3, 17, 3.5, 1.7, 8], [0.05, 10, 17, 0.1, 8, 14], [3, 3.5, 1.7, 10, 17, 8], [17, 8, 0.05, 10, 0.1, 14]]
)
HARTMANN_P = np.array(
    [
        [0.1312, 0.1696, 0.5569, 0.0124, 0.8283, 0.5886],
        [0.2329, 0.4135, 0.8307, 0.3736, 0.1004, 0.9991],
        [0.2348, 0.1451, 0.3522, 0.2883, 0.3047, 0.6650],
        [0.4047, 0.8828, 0.8732, 0.5743, 0.1091, 0.0381],
    ]
)
HARTMANN_BEST = np.array([0.20168952, 0.15001069, 0.47687398, 0.27533243, 0.31165162, 0.65730054])
HARTMANN_MAXIMUM = 3.32236801141551


def hartmann6(x: Array) -> float:
    """Hartmann's function of six variables, to be maximised (Dixon and Szego 1978); defined outside [0, 1] as well."""
    return float(np.array([1.0, 1.2, 3.0, 3.2]) @ np.exp(-(HARTMANN_A * np.square(x - HARTMANN_P)).sum(1)))


@cache
def landscape(o: Objective) -> Landscape:
    """The pieces of an objective, once a process."""
    return Landscape(o)


TUNE = (
    Objective("tune-5d", 5, 5),
    Objective("tune-7d-narrow", 7, 6, width=0.35),
    Objective("tune-12d", 12, 8, peaks=4),
    Objective("tune-6d-uninformative", 6, 5, low="none"),
    Objective("tune-8d-deceptive", 8, 5, low="deceptive"),
    Objective("tune-9d-mixed", 9, 6, mixed=True, noise=0.03),
    Objective("tune-8d-valley", 8, 5, shape="valley"),
    Objective("tune-6d-cliff", 6, 5, shape="cliff"),
)
"""Objectives to tune on."""

REPORT = (
    Objective("peaks-5d", 5, 5, peaks=5),
    Objective("narrow-6d", 6, 6, width=0.38),
    Objective("ppo-7d", 7, 6, shift=0.2),
    Objective("ppo-8d-mixed", 8, 6, mixed=True),
    Objective("noisy-10d", 10, 6, noise=0.05),
    Objective("ppo-12d", 12, 8, peaks=4),
    Objective("wide-20d", 20, 6),
    Objective("unrelated-6d", 6, 5, low="none"),
    Objective("deceptive-7d", 7, 5, low="deceptive"),
    Objective("hartmann-6d", 6, 6, shape="hartmann"),
    Objective("valley-10d", 10, 6, shape="valley"),
    Objective("cliff-8d", 8, 6, shape="cliff"),
)
"""Objectives that figures are reported on; nothing was tuned on them."""

OBJECTIVES = {o.name: o for o in TUNE + REPORT}
