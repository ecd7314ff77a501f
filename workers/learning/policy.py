"""A learnt policy at rest and at work: safetensors in and out, a deterministic action for an observation.

Inference is plain numpy: for the batches of a rollout (1 to 16 observations) it takes less than half the time that
torch's modules do (`benchmarks/ppo.py`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from workers.contracts import JSON, BadJob

Activation = Literal["relu", "tanh"]
Layers = Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]]
"""Weights ``[fan_in, fan_out]`` and biases ``[fan_out]``, input first."""

_FORMAT = 1
_METADATA_KEY = "halma.policy"
"""One key only: safetensors writes several in no fixed order, and equal policies must be equal bytes."""


def forward(layers: Layers, x: NDArray[np.float32], activation: Activation) -> NDArray[np.float32]:
    """A perceptron's output ``[n, fan_out]`` for inputs ``[n, fan_in]``, linear in its last layer."""
    for weight, bias in layers[:-1]:
        x = x @ weight
        x += bias
        x = np.tanh(x, out=x) if activation == "tanh" else np.maximum(x, 0, out=x)
    weight, bias = layers[-1]
    return x @ weight + bias


def _clipped(x: NDArray[np.float32], low: Any, high: Any) -> NDArray[np.float32]:
    """`np.clip` in place, without its checks, which take longer than the work for a single observation."""
    np.maximum(x, low, out=x)
    np.minimum(x, high, out=x)
    return x


@dataclass(frozen=True, slots=True)
class ActionMap:
    """From the network's output to the environment's actions.

    Args:
        kind: `continuous` (the output is the action's mean) or `discrete` (logits).
        size: number of coordinates, or of choices.
        offset, scale: action = offset + scale * output ``[size]``; continuous only.
        low, high: what goes beyond is clipped ``[size]``, -inf and inf where there is no bound; continuous only.
        start: the smallest action; discrete only.
    """

    kind: Literal["continuous", "discrete"]
    size: int
    offset: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))
    scale: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))
    low: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))
    high: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))
    start: int = 0

    @classmethod
    def box(cls, low: NDArray[Any], high: NDArray[Any]) -> ActionMap:
        """For a `Box` with these bounds ``[size]``: output 0 is the middle, +-1 the bounds; without bounds, 1:1."""
        low, high = low.astype(np.float32), high.astype(np.float32)
        bounded = np.isfinite(low) & np.isfinite(high)
        offset = np.where(bounded, (np.where(bounded, low, 0) + np.where(bounded, high, 0)) / 2, 0).astype(np.float32)
        scale = np.where(bounded, (np.where(bounded, high, 0) - np.where(bounded, low, 0)) / 2, 1).astype(np.float32)
        return cls("continuous", len(low), offset, scale, low, high)

    def to_environment(self, output: NDArray[np.float32]) -> NDArray[np.float32]:
        """Continuous actions ``[..., size]`` in the environment's units, within its bounds."""
        return _clipped(self.offset + self.scale * output, self.low, self.high)

    def to_json(self) -> dict[str, JSON]:
        """Bounds that are infinite become null: JSON has no infinity."""
        bounds = {
            name: [float(v) if np.isfinite(v) else None for v in getattr(self, name)]
            for name in ("offset", "scale", "low", "high")
        }
        return {"kind": self.kind, "size": self.size, "start": self.start, **bounds}

    @classmethod
    def from_json(cls, value: Mapping[str, JSON]) -> ActionMap:
        """What `to_json` gave."""

        def array(name: str, missing: float) -> NDArray[np.float32]:
            return np.array([missing if v is None else v for v in value[name]], np.float32)

        return cls(
            value["kind"],
            value["size"],
            array("offset", 0.0),
            array("scale", 1.0),
            array("low", -np.inf),
            array("high", np.inf),
            value["start"],
        )


@dataclass(frozen=True, slots=True)
class Normaliser:
    """Observation statistics: (o - mean) / sqrt(var + 1e-6), clipped. The 1e-6 keeps constant coordinates at 0.

    Args:
        mean, var: of each coordinate ``[observation]``, float64.
        count: how many observations they are of.
        clip: bound of the normalised observation.
    """

    mean: NDArray[np.float64]
    var: NDArray[np.float64]
    count: float
    clip: float = 8.0
    scale: NDArray[np.float64] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "scale", 1 / np.sqrt(self.var + 1e-6))  # once, not for each step of a rollout

    @classmethod
    def identity(cls, size: int, clip: float = 8.0) -> Normaliser:
        """Changes nothing but for the clipping; the first `updated` replaces it."""
        return cls(np.zeros(size), np.ones(size), 0.0, clip)

    def __call__(self, observations: NDArray[np.float64]) -> NDArray[np.float32]:
        """Normalised observations ``[..., observation]``."""
        normalised: NDArray[np.float32] = ((observations - self.mean) * self.scale).astype(np.float32)
        return _clipped(normalised, -self.clip, self.clip)

    def updated(self, observations: NDArray[np.float64]) -> Normaliser:
        """With ``[n, observation]`` more (Chan, Golub and LeVeque 1983, equation 2.1)."""
        n = len(observations)
        total = self.count + n
        shift = observations.mean(0) - self.mean
        mean = self.mean + shift * (n / total)
        squares = self.var * self.count + observations.var(0) * n + shift**2 * (self.count * n / total)
        return Normaliser(mean, squares / total, total, self.clip)


@dataclass(frozen=True, slots=True)
class Policy:
    """A policy with all that acting and going on learning need.

    Args:
        activation: of the hidden layers.
        actions: from the network's output to the environment.
        normaliser: of the observations.
        actor: output ``[actions.size]``.
        critic: output ``[1]``; like `sigma` it is kept for trainings that start from this policy.
        sigma: standard deviation of the action noise that it was last explored with ``[actions.size]``, in network
            units; None where nothing tells.
    """

    activation: Activation
    actions: ActionMap
    normaliser: Normaliser
    actor: Layers
    critic: Layers
    sigma: NDArray[np.float32] | None = None

    @property
    def observation_size(self) -> int:
        """Number of coordinates of an observation."""
        return len(self.normaliser.mean)

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""
        return tuple(len(bias) for _, bias in self.actor[:-1])

    def output(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        """What the network says: means in network units or logits, ``[n, actions.size]`` for ``[n, observation]``."""
        return forward(self.actor, self.normaliser(observations), self.activation)

    def act(self, observation: NDArray[Any]) -> NDArray[np.float32] | int:
        """The deterministic action for one observation ``[observation]``, in the environment's units.

        Continuous: the mean ``[actions.size]``, scaled and clipped. Discrete: the likeliest choice.
        """
        output = self.output(observation[None])[0]
        if self.actions.kind == "discrete":
            return self.actions.start + int(output.argmax())
        return self.actions.to_environment(output)

    def to_bytes(self) -> bytes:
        """safetensors; equal policies give equal bytes."""
        tensors: dict[str, NDArray[Any]] = {
            "normaliser.mean": self.normaliser.mean,
            "normaliser.var": self.normaliser.var,
        }
        for name, layers in (("actor", self.actor), ("critic", self.critic)):
            for i, (weight, bias) in enumerate(layers):
                tensors[f"{name}.{i}.weight"] = np.ascontiguousarray(weight)
                tensors[f"{name}.{i}.bias"] = np.ascontiguousarray(bias)
        if self.sigma is not None:
            tensors["sigma"] = self.sigma
        about = {
            "format": _FORMAT,
            "observation_size": self.observation_size,
            "hidden": list(self.hidden),
            "activation": self.activation,
            "actions": self.actions.to_json(),
            "normaliser": {"count": self.normaliser.count, "clip": self.normaliser.clip},
        }
        return save(tensors, {_METADATA_KEY: json.dumps(about, sort_keys=True)})

    @classmethod
    def from_bytes(cls, data: bytes) -> Policy:
        """What `to_bytes` gave. Raises `BadJob` where it is something else."""
        try:
            tensors = load(data)
            header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])  # the format's own layout
            about = json.loads(header["__metadata__"][_METADATA_KEY])
            normaliser = Normaliser(
                tensors["normaliser.mean"],
                tensors["normaliser.var"],
                about["normaliser"]["count"],
                about["normaliser"]["clip"],
            )
            depth = range(len(about["hidden"]) + 1)
            actor, critic = (
                [(tensors[f"{name}.{i}.weight"], tensors[f"{name}.{i}.bias"]) for i in depth]
                for name in ("actor", "critic")
            )
            actions, sigma = ActionMap.from_json(about["actions"]), tensors.get("sigma")
            return cls(about["activation"], actions, normaliser, actor, critic, sigma)
        except (SafetensorError, KeyError, TypeError, ValueError) as error:
            raise BadJob(
                f"policy: expected a policy.safetensors written by halma, found something else ({error})"
            ) from error

    def sha256(self) -> str:
        """Hash of all weights, statistics and sizes, hexadecimal."""
        return hashlib.sha256(self.to_bytes()).hexdigest()


def with_note(policy: bytes, name: str, value: float) -> bytes:
    """A stored policy that carries a number of its task's own (m of bar, ...); the learner reads it like any other."""
    header = json.loads(policy[8 : 8 + int.from_bytes(policy[:8], "little")])  # the format's own layout
    return save({**load(policy), name: np.array(value)}, header["__metadata__"])


def note_of(policy: bytes, name: str) -> float | None:
    """The number that `with_note` put there, or None. Raises `BadJob` where it is no policy at all."""
    Policy.from_bytes(policy)
    tensors = load(policy)
    return float(tensors[name]) if name in tensors else None
