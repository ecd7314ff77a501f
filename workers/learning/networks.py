"""Perceptrons in torch with their optimiser, as plain tensors in and out.

All of a network's numbers lie in one vector, so that a gradient step is a handful of operations however many layers
there are. torch's own optimisers are not used: making the first one imports its compiler, two seconds of every worker
process. Weights lie ``[fan_in, fan_out]``, so that the numpy inference of a rollout sees torch's own memory, always
current.
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

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8
"""Of Adam, as its paper recommends (Kingma and Ba 2015, algorithm 1)."""


class Network:
    """A perceptron and its Adam, with decoupled weight decay (Loshchilov and Hutter 2019, algorithm 2).

    Args:
        name: prefix of its tensors in a checkpoint, and in messages.
        sizes: input, hidden layers, output.
        activation: of the hidden layers.
        rate: learning rate.
        weight_decay: share of a weight that a step with rate 1 would take away.
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
        self.name, self.sizes, self.activation = name, tuple(sizes), activation
        self.rate, self.weight_decay = rate, weight_decay
        initial: list[NDArray[np.float64]] = []
        for fan_in, fan_out in itertools.pairwise(sizes):
            bound = 1 / math.sqrt(fan_in)
            initial += [rng.uniform(-bound, bound, (fan_in, fan_out)), rng.uniform(-bound, bound, fan_out)]
        initial[-2] *= last_scale
        initial[-1][:] = 0
        if sigma_start is not None:
            initial.append(np.full(sizes[-1], math.log(sigma_start)))
        self.vector = torch.tensor(np.concatenate([part.ravel() for part in initial]), dtype=torch.float32)
        self.gradient, self.m, self.v = (torch.zeros_like(self.vector) for _ in range(3))
        self.steps = 0
        self.parameters: list[torch.Tensor] = []
        start = 0
        for part in initial:
            inside = slice(start, start + part.size)
            parameter = self.vector[inside].view(part.shape).requires_grad_()
            parameter.grad = self.gradient[inside].view(part.shape)
            self.parameters.append(parameter)
            start += part.size
        self.log_sigma = None if sigma_start is None else self.parameters[-1]
        depth = len(sizes) - 1
        self.layers = list(zip(self.parameters[0 : 2 * depth : 2], self.parameters[1 : 2 * depth : 2], strict=True))

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        """Output ``[n, fan_out]`` for inputs ``[n, fan_in]``."""
        for weight, bias in self.layers[:-1]:
            x = torch.addmm(bias, x, weight)
            x = torch.tanh(x) if self.activation == "tanh" else torch.relu(x)
        weight, bias = self.layers[-1]
        return torch.addmm(bias, x, weight)

    def descend(self, loss: torch.Tensor, grad_norm: float) -> None:
        """One step of Adam, the gradient shortened to `grad_norm`."""
        self.gradient.zero_()
        loss.backward()  # type: ignore[no-untyped-call] # torch annotates its arguments, not its result
        self.step(grad_norm)

    def step(self, grad_norm: float) -> None:
        """One step of Adam along the gathered gradient, shortened to `grad_norm`."""
        g = self.gradient
        length = float(torch.linalg.vector_norm(g))
        if length > grad_norm:
            g.mul_(grad_norm / length)
        self.steps += 1
        self.vector.mul_(1 - self.rate * self.weight_decay)
        self.m.lerp_(g, 1 - BETA_1)
        self.v.mul_(BETA_2).addcmul_(g, g, value=1 - BETA_2)
        # 2015, algorithm 1: both averages begin at zero, and are divided by the weight they have gathered.
        denominator = self.v.sqrt().div_(math.sqrt(1 - BETA_2**self.steps)).add_(EPSILON)
        self.vector.addcdiv_(self.m, denominator, value=-self.rate / (1 - BETA_1**self.steps))

    def finite(self) -> bool:
        """Whether all weights are."""
        return bool(torch.isfinite(self.vector).all())

    def view(self) -> Layers:
        """The layers as numpy, sharing memory."""
        return [(weight.detach().numpy(), bias.detach().numpy()) for weight, bias in self.layers]

    def snapshot(self) -> Layers:
        """The layers as numpy, copied."""
        return [(weight.copy(), bias.copy()) for weight, bias in self.view()]

    def put(self, layers: Layers) -> None:
        """Take over layers of the same sizes."""
        for (weight, bias), (new_weight, new_bias) in zip(self.view(), layers, strict=True):
            weight[:], bias[:] = new_weight, new_bias

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Weights and optimiser moments by dotted name, copied."""
        moments = {"vector": self.vector, "m": self.m, "v": self.v}
        found: dict[str, NDArray[Any]] = {f"{self.name}.{k}": t.numpy().copy() for k, t in moments.items()}
        return found | {f"{self.name}.sizes": np.array(self.sizes), f"{self.name}.steps": np.array(self.steps)}

    def load(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Continue from what `tensors` gave. Raises `BadJob` where it is of other sizes.

        The vectors keep their memory: where it is aligned can decide the last bit of a matrix product.
        """
        sizes = tensors.get(f"{self.name}.sizes")
        found = None if sizes is None else tuple(int(size) for size in sizes)
        length = 0 if found is None else len(tensors[f"{self.name}.vector"])
        if found != self.sizes or length != len(self.vector):
            raise BadJob(
                f"checkpoint: expected the {self.name} to have layers of {self.sizes} and {len(self.vector)} numbers, "
                f"found {found} and {length}; it is of a training with other settings"
            )
        for name, mine in (("vector", self.vector), ("m", self.m), ("v", self.v)):
            mine.numpy()[:] = tensors[f"{self.name}.{name}"]
        self.steps = int(tensors[f"{self.name}.steps"])
