"""Perceptrons in torch with their optimisers, as plain tensors in and out.

Weights lie ``[fan_in, fan_out]``, so that the numpy inference of a rollout sees torch's own memory, always current.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from workers.contracts import BadJob
from workers.learning.policy import Activation, Layers


class Network:
    """A perceptron and its Adam (decoupled weight decay; Loshchilov and Hutter 2019).

    Args:
        name: prefix of its tensors in a checkpoint, and in messages.
        sizes: input, hidden layers, output.
        activation: of the hidden layers.
        rate: learning rate.
        weight_decay: of the optimiser.
        rng: for the initial weights: uniform within 1 / sqrt(fan_in), as torch's own linear layers.
        last_scale: factor on the last layer's weights; a small one makes all first actions alike.
        sigma_start: where given, one learnt standard deviation for each output, from this start.
    """

    def __init__(
        self,
        name: str,
        sizes: Sequence[int],
        activation: Activation,
        *,
        rate: float,
        weight_decay: float,
        rng: np.random.Generator,
        last_scale: float = 1.0,
        sigma_start: float | None = None,
    ) -> None:
        self.name = name
        self.activation = activation
        self.parameters: list[torch.nn.Parameter] = []
        for fan_in, fan_out in itertools.pairwise(sizes):
            bound = 1 / math.sqrt(fan_in)
            weight, bias = rng.uniform(-bound, bound, (fan_in, fan_out)), rng.uniform(-bound, bound, fan_out)
            self.parameters += [_parameter(weight), _parameter(bias)]
        with torch.no_grad():
            self.parameters[-2].mul_(last_scale)
            self.parameters[-1].zero_()
        self.layers = list(zip(self.parameters[::2], self.parameters[1::2], strict=True))
        self.log_sigma: torch.nn.Parameter | None = None
        if sigma_start is not None:
            self.log_sigma = _parameter(np.full(sizes[-1], math.log(sigma_start)))
            self.parameters.append(self.log_sigma)
        self.optimiser = torch.optim.AdamW(self.parameters, lr=rate, weight_decay=weight_decay, fused=True)

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        """Output ``[n, fan_out]`` for inputs ``[n, fan_in]``."""
        for weight, bias in self.layers[:-1]:
            x = torch.addmm(bias, x, weight)
            x = torch.tanh(x) if self.activation == "tanh" else torch.relu(x)
        weight, bias = self.layers[-1]
        return torch.addmm(bias, x, weight)

    def descend(self, loss: torch.Tensor, grad_norm: float) -> None:
        """One gradient step, the gradient shortened to `grad_norm`."""
        self.optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call] # torch annotates its arguments, not its result
        torch.nn.utils.clip_grad_norm_(self.parameters, grad_norm)
        self.optimiser.step()

    def finite(self) -> bool:
        """Whether all weights are."""
        return all(bool(torch.isfinite(p).all()) for p in self.parameters)

    def view(self) -> Layers:
        """The layers as numpy, sharing memory."""
        return [(weight.detach().numpy(), bias.detach().numpy()) for weight, bias in self.layers]

    def snapshot(self) -> Layers:
        """The layers as numpy, copied."""
        return [(weight.copy(), bias.copy()) for weight, bias in self.view()]

    def put(self, layers: Layers) -> None:
        """Take over layers of the same sizes."""
        with torch.no_grad():
            for (weight, bias), (new_weight, new_bias) in zip(self.layers, layers, strict=True):
                weight.copy_(torch.tensor(new_weight))
                bias.copy_(torch.tensor(new_bias))

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Weights and optimiser moments by dotted name, copied."""
        found = {f"{self.name}.{i}": p.detach().numpy().copy() for i, p in enumerate(self.parameters)}
        for i, moments in self.optimiser.state_dict()["state"].items():
            for key, value in moments.items():
                found[f"{self.name}.adam.{i}.{key}"] = value.numpy().copy()
        return found

    def load(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Continue from what `tensors` gave. Raises `BadJob` where it is of other sizes.

        The parameters keep their memory: where it is aligned can decide the last bit of a matrix product.
        """
        moments: dict[int, dict[str, torch.Tensor]] = {}
        prefix = f"{self.name}.adam."
        for name, value in tensors.items():
            if name.startswith(prefix):
                index, key = name.removeprefix(prefix).split(".")
                moments.setdefault(int(index), {})[key] = torch.tensor(value)
        with torch.no_grad():
            for i, parameter in enumerate(self.parameters):
                weights = tensors.get(f"{self.name}.{i}")
                if weights is None or weights.shape != tuple(parameter.shape):
                    raise BadJob(
                        f"checkpoint: expected {self.name}.{i} of shape {tuple(parameter.shape)}, found "
                        f"{'nothing' if weights is None else weights.shape}; it is of another network"
                    )
                parameter.copy_(torch.tensor(weights))
        self.optimiser.load_state_dict({**self.optimiser.state_dict(), "state": moments})


def _parameter(value: NDArray[np.float64]) -> torch.nn.Parameter:
    return torch.nn.Parameter(torch.tensor(value, dtype=torch.float32))
