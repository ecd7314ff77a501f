"""Bayesian diversity search as printed: Algorithm 1 of Yin et al. 2021.

Glossary: f(x) the behaviour of the policy trained for x; F the behaviours found so far; mu, sigma the posterior of
a Gaussian process fitted to (x, f(x)). The algorithm alternates N_exp proposals at argmax sigma(x) (found by L-BFGS)
with N_opt at argmax E[min over g in F of |f(x) - g|] (Monte Carlo; found by DIRECT).

As printed, the surrogate has independent outputs with Matern 5/2 kernels, a length scale for each dimension, the prior
mean at the middle of the feature range, and hyperparameters of maximum likelihood (BoTorch). Angles of the search
space are plain intervals; a circle of behaviours is modelled as the number in [-pi, pi), a rotation as its rotation
vector; the distance to the nearest known behaviour is the metric's own.

What the paper leaves open is settled as follows. A trial that is pending or came without a behaviour is taken to have
shown the posterior mean (kriging believer): it lowers the deviation where it was asked and teaches nothing else. The
first proposal, with nothing known, is uniform.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import Bounds, direct, minimize
from scipy.spatial.transform import Rotation

from search.features import Features
from search.record import Record
from search.space import Array, Space
from search.surrogate.gp import GaussianProcess
from search.surrogate.threads import one_torch_thread

QUIET = (DeprecationWarning, PendingDeprecationWarning, FutureWarning)

STARTS = 4
RAW = 128
"""L-BFGS starts at the best `STARTS` of `RAW` uniform points."""


@dataclass(frozen=True, slots=True)
class Hyperparameters:
    """What the fit found, for each of ``D`` outputs. Everything is in the scaled units of `to_outputs`."""

    w: Array
    """``D x d`` inverse length scales."""
    amplitude: Array
    """``D`` prior standard deviations."""
    noise: Array
    """``D`` noise variances relative to the squared amplitude."""
    warnings: tuple[str, ...]


def to_outputs(metric: Features, Y: Array) -> Array:
    """Behaviours as the surrogate's outputs, ``n x D``, with the feature range mapped to [-1, 1]."""
    if metric.kind == "rotation":
        return np.asarray(Rotation.from_quat(Y).as_rotvec() / np.pi)
    middle = (np.array(metric.low) + np.array(metric.high)) / 2
    return np.asarray((Y - middle) / (np.array(metric.high) - middle))


def from_outputs(metric: Features, F: Array) -> Array:
    """The surrogate's outputs ``... x D`` as behaviours."""
    if metric.kind == "rotation":
        flat = Rotation.from_rotvec(F.reshape(-1, 3) * np.pi).as_quat()
        return metric.canonical(np.asarray(flat).reshape(*F.shape[:-1], 4))
    middle = (np.array(metric.low) + np.array(metric.high)) / 2
    return metric.canonical(F * (np.array(metric.high) - middle) + middle)


def fit(X: Array, F: Array) -> Hyperparameters:
    """Maximum likelihood on BoTorch.

    Args:
        X: ``n x d`` in [0, 1].
        F: ``n x D`` scaled outputs; their prior mean is 0, the middle of the feature range.
    """
    D, d = F.shape[1], X.shape[1]
    fallback = Hyperparameters(np.full((D, d), 2.0), np.full(D, 0.5), np.full(D, 1e-3), ())
    if len(X) < 2:
        return fallback
    with warnings.catch_warnings(record=True) as caught, one_torch_thread():
        warnings.simplefilter("always")
        try:
            found = _fit_botorch(X, F)
        except Exception as error:  # noqa: BLE001  # whatever BoTorch, GPyTorch or LAPACK raise, the study goes on
            return Hyperparameters(fallback.w, fallback.amplitude, fallback.noise, (f"fit failed: {error}",))
    # deprecations speak to developers, and once a process: they would make equal proposals look different
    told = {str(w.message).split("\n", maxsplit=1)[0] for w in caught if not issubclass(w.category, QUIET)}
    return Hyperparameters(*found, tuple(sorted(told)))


def _fit_botorch(X: Array, F: Array) -> tuple[Array, Array, Array]:
    import torch  # noqa: PLC0415  # BoTorch takes seconds to import; only a fit should pay for it
    from botorch.fit import fit_gpytorch_mll  # noqa: PLC0415
    from botorch.models import SingleTaskGP  # noqa: PLC0415
    from gpytorch.kernels import MaternKernel, ScaleKernel  # noqa: PLC0415
    from gpytorch.likelihoods import GaussianLikelihood  # noqa: PLC0415
    from gpytorch.means import ZeroMean  # noqa: PLC0415
    from gpytorch.mlls import ExactMarginalLogLikelihood  # noqa: PLC0415

    D, d = F.shape[1], X.shape[1]
    batch = torch.Size([D]) if D > 1 else torch.Size([])
    model = SingleTaskGP(
        torch.from_numpy(X),
        torch.from_numpy(F),
        likelihood=GaussianLikelihood(batch_shape=batch).double(),
        covar_module=ScaleKernel(MaternKernel(nu=2.5, ard_num_dims=d, batch_shape=batch), batch_shape=batch).double(),
        mean_module=ZeroMean(batch_shape=batch),
        outcome_transform=None,
    )
    # the retries after a failed fit draw new starting points from torch's generator: keep it, and the caller's, in hand
    with torch.random.fork_rng():
        torch.manual_seed(0)
        fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    scale = model.covar_module.outputscale.detach().reshape(D).numpy()
    length = model.covar_module.base_kernel.lengthscale.detach().reshape(D, d).numpy()
    noise = model.likelihood.noise.detach().reshape(D).numpy()
    return 1 / length, np.sqrt(scale), noise / scale


class PublishedModel:
    """Independent Gaussian processes for ``D`` outputs, conditioned on data and on believed points.

    Args:
        metric: the feature space.
        fitted: hyperparameters.
        X, F: ``n x d`` unit coordinates and ``n x D`` scaled outputs that were observed.
        believed: ``p x d`` points whose outcome is unknown.
    """

    def __init__(self, metric: Features, fitted: Hyperparameters, X: Array, F: Array, believed: Array) -> None:
        self.metric = metric
        self.outputs = []
        for j in range(F.shape[1]):
            gp = GaussianProcess(X, F[:, [j]], fitted.w[j], fitted.amplitude[[j]], float(fitted.noise[j]), np.zeros(1))
            if len(believed):
                gp = gp.with_data(believed, gp.posterior(believed)[0], float(fitted.noise[j]))
            self.outputs.append(gp)

    def deviation(self, u: Array) -> tuple[float, Array]:
        """Posterior standard deviation at a point ``d``, over all outputs together, and its gradient ``d``."""
        total, gradient = 0.0, np.zeros(len(u))
        for gp in self.outputs:
            _, v, _, dv = gp.gradient(u)
            total += float(gp.amplitude[0] ** 2) * v
            gradient += float(gp.amplitude[0] ** 2) * dv
        sigma = float(np.sqrt(total))
        return sigma, gradient / (2 * sigma)

    def posterior(self, U: Array) -> tuple[Array, Array]:
        """Mean and standard deviation, each ``m x D``, in scaled outputs."""
        means, deviations = [], []
        for gp in self.outputs:
            m, v = gp.posterior(U)
            means.append(m[:, 0])
            deviations.append(gp.amplitude[0] * np.sqrt(v))
        return np.stack(means, 1), np.stack(deviations, 1)

    def expected_distance(self, U: Array, known: Array, normals: Array) -> Array:
        """Expected distance to the nearest known behaviour, ``m``, by Monte Carlo.

        Args:
            U: ``m x d`` unit coordinates.
            known: ``p x D'`` behaviours.
            normals: ``N x D`` standard normal draws, the same for every point so that the objective is smooth.
        """
        mean, deviation = self.posterior(U)
        draws = from_outputs(self.metric, mean[:, None, :] + deviation[:, None, :] * normals)
        nearest = self.metric.distance(draws[:, :, None, :], known).min(axis=2)
        return np.asarray(nearest.mean(axis=1))


def explore(model: PublishedModel, d: int, rng: np.random.Generator) -> tuple[Array, float]:
    """The point ``d`` of largest posterior deviation, by L-BFGS from the best of some uniform points, and its value."""
    raw = rng.random((RAW, d))
    scores = np.square(model.posterior(raw)[1]).sum(1)
    best, best_value = raw[int(np.argmax(scores))], -np.inf

    def objective(u: Array) -> tuple[float, Array]:
        sigma, gradient = model.deviation(u)
        return -sigma, -gradient

    for start in raw[np.argsort(-scores, kind="stable")[:STARTS]]:
        found = minimize(objective, start, jac=True, method="L-BFGS-B", bounds=[(0, 1)] * d)
        if -found.fun > best_value:
            best, best_value = np.clip(found.x, 0, 1), float(-found.fun)
    return best, best_value


def diversify(model: PublishedModel, known: Array, normals: Array, space: Space, budget: int) -> tuple[Array, float]:
    """The point ``d`` of largest expected distance to what is known, by DIRECT, and its value."""

    def objective(u: Array) -> float:
        return -float(model.expected_distance(space.snap(u[None, :]), known, normals)[0])

    found = direct(
        objective,
        Bounds(np.zeros(space.d), np.ones(space.d)),
        maxfun=budget,
        maxiter=budget,
        locally_biased=True,
    )
    return np.clip(np.asarray(found.x), 0, 1), -float(found.fun)


def propose(
    space: Space,
    metric: Features,
    record: Record,
    count: int,
    rng: np.random.Generator,
    settings: Any,
) -> list[tuple[Array, dict[str, Any]]]:
    """Algorithm 1, for `count` points one after the other, each pending for the next.

    Returns:
        Unit coordinates ``d`` and the reasons for each.
    """
    known_rows = record.known
    X, F = record.X[known_rows], to_outputs(metric, record.features[known_rows])
    archive = record.features[known_rows & record.complete]
    fitted = fit(X, F)
    proposals: list[tuple[Array, dict[str, Any]]] = []
    unknown = np.concatenate([record.X[~known_rows], record.pending])
    normals = rng.standard_normal((settings.samples, F.shape[1]))
    step = record.n + len(record.pending)
    for i in range(count):
        believed = np.concatenate([unknown, *(u[None, :] for u, _ in proposals)])
        model = PublishedModel(metric, fitted, X, F, believed)
        turn = (step + i) % (settings.n_exp + settings.n_opt)
        info: dict[str, Any]
        if not len(X) and not len(believed):
            u, info = rng.random(space.d), {"mode": "start"}
        elif turn < settings.n_exp or not len(archive):
            u, value = explore(model, space.d, rng)
            info = {"mode": "explore", "acquisition": value}
        else:
            u, value = diversify(model, archive, normals, space, settings.direct_evaluations)
            info = {"mode": "diversify", "acquisition": value}
        u = space.snap(u[None, :])[0]
        mean = model.posterior(u[None, :])[0]
        info["predicted"] = from_outputs(metric, mean)[0].tolist()
        if fitted.warnings:
            info["warnings"] = list(fitted.warnings)
        proposals.append((u, info))
    return proposals
