"""Curriculum multi-fidelity Bayesian optimisation as printed: Algorithms 3 and 4.

Source: Yang and Yin 2021, Efficient Hyperparameter Optimization for Physics-based Character Animation.

Glossary: f(x, z) the objective of settings x at difficulty z; k((x, z), (x', z')) = k_X(x, x') k_Z(z, z') the
product of two Matern 5/2 kernels (equation 17 with the usual square root in its distance: as printed it is not
positive definite); mu, sigma the posterior.

Algorithm 3, for as long as the cost budget lasts: x_t maximises mu(x, 1) + sqrt(beta_t) sigma(x, 1) by L-BFGS from the
best evaluation so far; z_t progresses from easy to hard: it is the lowest difficulty at which the predictive deviation
at x_t is still above epsilon = 0.02, in the unit of the values. Algorithm 4: the training at (x_t, z_t) starts from the
policy of the evaluation whose kernel correlation with it is highest. The answer is the best value over all evaluations,
of whatever difficulty.

What the paper leaves open is settled as follows. The search starts with d + 1 Sobol points at the lowest difficulty, as
the other searches here do at theirs. It can't start with one: where all evaluations share their x, the gradients of mu
and sigma in x are zero there, L-BFGS begins there, and the same x is asked for ever. Trials that failed or are pending
are believed to have shown the posterior mean.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from search.designs import next_sobol
from search.quality.budget import CostModel, spent
from search.quality.fidelity import ProductProcess
from search.record import Candidate, Record
from search.space import Array, Space
from search.surrogate.gp import GaussianProcess
from search.surrogate.threads import one_torch_thread

EPSILON = 0.02
LEVELS = (np.arange(10) + 1) / 10
BETA = 0.2
"""beta_t = BETA d log(2 t)."""


def fit(X: Array, z: Array, y: Array) -> tuple[Array, float, float, tuple[str, ...]]:
    """Inverse length scales ``d + 1``, amplitude and relative noise by maximum likelihood on BoTorch, and warnings."""
    d = X.shape[1]
    fallback = (np.full(d + 1, 2.0), 1.0, 1e-3)
    if len(X) < 2:
        return *fallback, ()
    with warnings.catch_warnings(record=True) as caught, one_torch_thread():
        warnings.simplefilter("always")
        try:
            found = _fit_botorch(X, z, y)
        except Exception as error:  # noqa: BLE001  # whatever BoTorch, GPyTorch or LAPACK raise, the study goes on
            return *fallback, (f"fit failed: {error}",)
    quiet = (DeprecationWarning, PendingDeprecationWarning, FutureWarning)
    told = {str(w.message).split("\n", maxsplit=1)[0] for w in caught if not issubclass(w.category, quiet)}
    return *found, tuple(sorted(told))


def _fit_botorch(X: Array, z: Array, y: Array) -> tuple[Array, float, float]:
    import torch  # noqa: PLC0415  # BoTorch takes seconds to import; only a fit should pay for it
    from botorch.fit import fit_gpytorch_mll  # noqa: PLC0415
    from botorch.models import SingleTaskGP  # noqa: PLC0415
    from gpytorch.kernels import MaternKernel, ScaleKernel  # noqa: PLC0415
    from gpytorch.likelihoods import GaussianLikelihood  # noqa: PLC0415
    from gpytorch.means import ZeroMean  # noqa: PLC0415
    from gpytorch.mlls import ExactMarginalLogLikelihood  # noqa: PLC0415

    d = X.shape[1]
    kernel = MaternKernel(nu=2.5, ard_num_dims=d, active_dims=tuple(range(d))) * MaternKernel(nu=2.5, active_dims=(d,))
    model = SingleTaskGP(
        torch.from_numpy(np.column_stack([X, z])),
        torch.from_numpy(y[:, None]),
        likelihood=GaussianLikelihood().double(),
        covar_module=ScaleKernel(kernel).double(),
        mean_module=ZeroMean(),
        outcome_transform=None,
    )
    with torch.random.fork_rng():
        torch.manual_seed(0)
        fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    product = model.covar_module.base_kernel
    lengths = [k.lengthscale.detach().reshape(-1).numpy() for k in product.kernels]
    scale = float(model.covar_module.outputscale.detach())
    return 1 / np.concatenate(lengths), math.sqrt(scale), float(model.likelihood.noise.detach()) / scale


@dataclass(frozen=True, slots=True)
class Model:
    """The posterior, and how values were standardised for it."""

    gp: GaussianProcess
    spread: float
    told: tuple[str, ...]


def make_model(record: Record) -> Model:
    """Fitted to complete observations; failed and pending ones are believed to show the posterior mean."""
    rows = record.complete & ~np.isnan(record.value)
    X, z, value = record.X[rows], record.z[rows], record.value[rows]
    spread = float(value.std()) if len(value) > 1 and value.std() > 1e-12 else 1.0
    y = (value - value.mean()) / spread if len(value) else value
    w, amplitude, noise, told = fit(X, z, y)
    gp: GaussianProcess = ProductProcess(
        np.column_stack([X, z]), y[:, None], w, np.array([amplitude]), noise, np.zeros(1)
    )
    unknown = np.concatenate(
        [
            np.column_stack([record.X[~rows], record.z[~rows]]),
            np.column_stack([record.pending, record.pending_z]),
        ]
    )
    if len(unknown):
        gp = gp.with_data(unknown, gp.posterior(unknown)[0], noise)
    return Model(gp, spread, told)


def propose(space: Space, record: Record, count: int, rng: np.random.Generator, settings: Any) -> list[Candidate]:
    """Algorithm 3 for `count` candidates, each pending for the next; fewer where the budget is used up."""
    costs = CostModel(record)
    paid = spent(record, costs)
    budget = math.inf if settings.cost_budget is None else settings.cost_budget
    start = space.d + 1 if settings.start is None else settings.start
    model = make_model(record)
    gp: GaussianProcess = model.gp
    found: list[Candidate] = []
    asked = record.asked
    while len(found) < count and paid < budget:
        t = len(asked)
        if t < start:
            u, z = next_sobol(space, asked, 1, settings.seed)[0], float(LEVELS[0])
        else:
            u = _where(gp, space, record, t, rng)
            _, variance = gp.posterior(np.column_stack([np.tile(u, (len(LEVELS), 1)), LEVELS]))
            # as printed: the predictive deviation, noise included; in the unit of the values, as epsilon is
            deviation = model.spread * gp.amplitude[0] * np.sqrt(variance + float(np.mean(gp.noise)))
            above = np.flatnonzero(deviation > EPSILON)
            z = float(LEVELS[above[0]]) if len(above) else 1.0
        u = space.snap(u[None, :])[0]
        info: dict[str, Any] = {"mode": "start" if t < start else "ucb"}
        if model.told:
            info["warnings"] = list(model.told)
        found.append(Candidate(space.from_unit(u), z, _parent(gp, record, u, z), info))
        point = np.append(u, z)[None, :]
        gp = gp.with_data(point, gp.posterior(point)[0], float(np.mean(gp.noise)) if len(gp.X) else 1e-3)
        asked = np.concatenate([asked, u[None, :]])
        paid += costs.at(z)
    return found


def _where(gp: GaussianProcess, space: Space, record: Record, t: int, rng: np.random.Generator) -> Array:
    """Argmax over x of mu(x, 1) + sqrt(beta_t) sigma(x, 1), by L-BFGS from the best evaluation."""
    root = math.sqrt(BETA * space.d * math.log(2 * t + 1))
    rows = np.flatnonzero(record.complete & ~np.isnan(record.value))
    start = record.X[rows[int(np.argmax(record.value[rows]))]] if len(rows) else rng.random(space.d)

    def negative(u: Array) -> tuple[float, Array]:
        mean, variance, dmean, dvariance = gp.gradient(np.append(u, 1.0))
        sigma = float(gp.amplitude[0]) * math.sqrt(variance)
        dsigma = float(gp.amplitude[0]) * dvariance / (2 * math.sqrt(variance))
        return -float(mean[0]) - root * sigma, -(dmean[0, :-1] + root * dsigma[:-1])

    found = minimize(negative, start, jac=True, method="L-BFGS-B", bounds=[(0, 1)] * space.d)
    return np.asarray(np.clip(found.x, 0, 1))


def _parent(gp: GaussianProcess, record: Record, u: Array, z: float) -> int | None:
    """Algorithm 4: the evaluation with the highest kernel correlation."""
    rows = np.flatnonzero(record.complete)
    if not len(rows):
        return None
    there = np.column_stack([record.X[rows], record.z[rows]])
    return int(rows[int(np.argmax(gp.correlation_between(np.append(u, z)[None, :], there)[0]))])
