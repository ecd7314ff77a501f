"""Behaviours as vectors that a Gaussian process can model: circles and rotations as what they are.

An angle becomes (cos, sin). A rotation q becomes the traceless part of q q', which is the same for q and -q, scaled to
norm 1; the inner product of two of them is (4 cos^2(theta/2) - 1) / 3 for an angle theta between the rotations.
Euclidean behaviours are scaled so that their declared range is [-1, 1]. The prior mean is 0 in all cases: the middle of
the range, or no preferred direction.

A draw from the surrogate is no unit vector; only its direction counts. So a prediction that knows nothing (mean near 0)
draws all directions alike, and one that is sure draws one.
"""

from __future__ import annotations

import math

import numpy as np

from search.features import Features
from search.space import Array

ROWS, COLUMNS = np.triu_indices(4)
WEIGHTS = np.where(ROWS == COLUMNS, 1.0, math.sqrt(2)) * math.sqrt(4 / 3)


class Embedding:
    """The outputs ``k`` that stand for a behaviour.

    Args:
        metric: the feature space.
    """

    def __init__(self, metric: Features) -> None:
        self.metric = metric
        self.k = {"circle": 2, "rotation": 10}.get(metric.kind, metric.d)
        self.amplitude = {"circle": math.sqrt(0.5), "rotation": math.sqrt(0.1)}.get(metric.kind, 0.6)
        """Standard deviation of one output over behaviours spread evenly: the prior's amplitude."""
        self.middle = (np.array(metric.low) + np.array(metric.high)) / 2
        self.half = (np.array(metric.high) - np.array(metric.low)) / 2

    def embed(self, Y: Array) -> Array:
        """``n x d`` behaviours -> ``n x k`` outputs."""
        if self.metric.kind == "circle":
            return np.stack([np.cos(Y[:, 0]), np.sin(Y[:, 0])], 1)
        if self.metric.kind == "rotation":
            Q = Y[:, :, None] * Y[:, None, :] - np.eye(4) / 4
            return np.asarray(Q[:, ROWS, COLUMNS] * WEIGHTS)
        return np.asarray((Y - self.middle) / self.half)

    def unembed(self, V: Array) -> Array:
        """``n x k`` outputs -> the nearest behaviours, ``n x d``."""
        if self.metric.kind == "circle":
            return np.arctan2(V[:, 1], V[:, 0])[:, None]
        if self.metric.kind == "rotation":
            Q = np.zeros((len(V), 4, 4))
            Q[:, ROWS, COLUMNS] = V / WEIGHTS
            Q[:, COLUMNS, ROWS] = Q[:, ROWS, COLUMNS]
            return self.metric.canonical(np.linalg.eigh(Q)[1][:, :, -1])
        return np.asarray(V * self.half + self.middle)

    def nearest(self, V: Array, known: Array) -> Array:
        """Distance of draws ``... x k`` to the nearest of ``p x k`` embedded behaviours, in the metric's unit."""
        if self.metric.kind == "euclidean":
            A, B = V * self.half, known * self.half
            square = (A * A).sum(-1)[..., None] + (B * B).sum(-1) - 2 * A @ B.T
            return np.asarray(np.sqrt(np.maximum(square.min(-1), 0)))
        length = np.sqrt((V * V).sum(-1))
        inner = (V @ known.T).max(-1) / np.maximum(length, 1e-12)
        if self.metric.kind == "circle":
            return np.asarray(np.arccos(np.clip(inner, -1, 1)))
        return np.asarray(2 * np.arccos(np.sqrt(np.clip((1 + 3 * inner) / 4, 0, 1))))
