"""Acquisition functions of a normal posterior, and how their maximum over the box is found."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize
from scipy.special import erfcx, log_ndtr

from search.designs import sobol_points
from search.space import Array, Space

LOG_ROOT_2PI = 0.5 * math.log(2 * math.pi)


def log_h(u: Array) -> Array:
    """log(phi(u) + u Phi(u)), the logarithm of the expected improvement of a standard normal over -u.

    The plain form underflows below u = -8 and cancels before. With erfcx it is
    -u^2/2 - log sqrt(2 pi) + log(1 + u sqrt(pi/2) erfcx(-u / sqrt 2)), whose last bracket cancels like 1/u^2;
    below -1000 its limit -2 log(-u) takes over.
    """
    u = np.asarray(u, dtype=float)
    plain = np.maximum(u, -5.0)
    phi = np.exp(-0.5 * plain * plain - LOG_ROOT_2PI)
    direct = np.log(phi + plain * np.exp(log_ndtr(plain)))
    low = np.clip(u, -1000.0, -1.0)
    bracket = 1 + low * math.sqrt(math.pi / 2) * erfcx(-low / math.sqrt(2))
    tail = -0.5 * u * u - LOG_ROOT_2PI + np.where(u < -1000, -2 * np.log(np.maximum(-u, 1.0)), np.log(bracket))
    return np.asarray(np.where(u > -5, direct, tail))


def log_expected_improvement(mean: Array, sigma: Array, best: float) -> Array:
    """Log E[max(f - best, 0)] for f normal (Jones 1998; logarithm as in Ament et al. 2023, section 4.1)."""
    return np.asarray(log_h((mean - best) / sigma) + np.log(sigma))


def log_ei_gradient(mean: float, sigma: float, best: float, dmean: Array, dsigma: Array) -> tuple[float, Array]:
    """`log_expected_improvement` at one point and its gradient, given those of mean and deviation."""
    u = (mean - best) / sigma
    h = float(log_h(np.array([u]))[0])
    # d log h / du = Phi(u) / h(u)
    slope = math.exp(min(float(log_ndtr(u)) - h, 700.0))
    return h + math.log(sigma), slope * (dmean - u * dsigma) / sigma + dsigma / sigma


Objective = Callable[[Array], tuple[float, Array]]
"""Value and gradient ``d`` at one point ``d`` of unit coordinates."""


def maximise(
    space: Space,
    many: Callable[[Array], Array],
    one: Objective,
    around: Array,
    rng: np.random.Generator,
    *,
    pool: int = 512,
    starts: int = 5,
    steps: int = 40,
) -> tuple[Array, float]:
    """The point ``d`` where an acquisition is largest: a pool of points, then L-BFGS from the best of it.

    Args:
        space: the box.
        many: the acquisition of ``m x d`` points.
        one: the same with its gradient at one point.
        around: ``p x d`` good points; the pool holds perturbations of them in all and in few coordinates.
        rng: for the pool.
        pool: number of Sobol points, and of perturbations.
        starts: how many of the best points are refined.
        steps: L-BFGS iterations at most.
    """
    points = [sobol_points(space, 0, pool, int(rng.integers(2**31)))]
    if len(around):
        share = -(-pool // len(around))
        base = np.repeat(around, share, axis=0)
        spread = 10 ** rng.uniform(-2.5, -0.5, (len(base), 1))
        # changing a few coordinates at a time is what still works in twenty dimensions
        chance = np.where(rng.random((len(base), 1)) < 0.5, 1.0, min(1.0, 2.5 / space.d))
        moved = base + rng.standard_normal(base.shape) * spread * (rng.random(base.shape) < chance)
        jump = space.is_categorical() & (rng.random(base.shape) < 0.2)
        moved = np.where(jump, rng.random(base.shape), moved)
        moved = np.where(space.is_periodic(), moved % 1.0, np.clip(moved, 0, 1))
        points += [space.snap(moved), around]
    U = np.concatenate(points)
    values = many(U)
    order = np.argsort(-values, kind="stable")[:starts]
    best, best_value = U[order[0]], float(values[order[0]])

    def negative(u: Array) -> tuple[float, Array]:
        value, gradient = one(u)
        return -value, -gradient

    # angles may be followed past the seam; everything else has its faces
    bounds = [(-0.5, 1.5) if periodic else (0.0, 1.0) for periodic in space.is_periodic()]
    for start in U[order]:
        found = minimize(negative, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": steps})
        u = np.where(space.is_periodic(), found.x % 1.0, np.clip(found.x, 0, 1))
        u = space.snap(u[None, :])
        value = float(many(u)[0])
        if value > best_value:
            best, best_value = u[0], value
    return best, best_value
