import numpy as np
import pytest
import torch

from workers.learning.networks import Network


def a_network(seed=0, *, weight_decay=0.0, sigma_start=None):
    rng = np.random.default_rng(seed)
    return Network("n", (2, 4, 1), "tanh", rate=0.1, weight_decay=weight_decay, rng=rng, sigma_start=sigma_start)


@pytest.mark.parametrize("weight_decay", [0.0, 0.3])
@pytest.mark.parametrize("grad_norm", [0.05, 100.0])
def test_a_step_of_ours_is_a_step_of_torchs_adam(weight_decay, grad_norm):
    ours = a_network(weight_decay=weight_decay, sigma_start=0.5)
    theirs = [p.detach().clone().requires_grad_() for p in ours.parameters]
    optimiser = torch.optim.AdamW(theirs, lr=0.1, weight_decay=weight_decay)

    def loss(parameters, x):
        w0, b0, w1, b1, log_sigma = parameters
        return ((torch.tanh(x @ w0 + b0) @ w1 + b1) * log_sigma.exp()).square().mean()

    rng = np.random.default_rng(5)
    for _ in range(5):
        x = torch.tensor(rng.normal(size=(6, 2)), dtype=torch.float32)
        ours.descend((ours(x) * ours.log_sigma.exp()).square().mean(), grad_norm)
        optimiser.zero_grad()
        loss(theirs, x).backward()
        torch.nn.utils.clip_grad_norm_(theirs, grad_norm)
        optimiser.step()
        for mine, other in zip(ours.parameters, theirs, strict=True):
            torch.testing.assert_close(mine, other, rtol=1e-4, atol=1e-5)


def test_the_numpy_view_of_a_network_follows_its_weights():
    subject = a_network()
    view, snapshot = subject.view(), subject.snapshot()
    subject.descend(subject(torch.ones(1, 2)).sum(), 1.0)
    assert not np.array_equal(view[0][0], snapshot[0][0])
    assert np.array_equal(view[0][0], subject.parameters[0].detach().numpy())


def test_a_network_read_back_descends_as_the_one_written():
    first, second = (a_network(seed, weight_decay=0.01, sigma_start=0.5) for seed in (0, 1))
    x = torch.tensor(np.random.default_rng(2).normal(size=(5, 2)), dtype=torch.float32)
    first.descend(first(x).square().mean() + first.log_sigma.sum(), 1.0)
    second.load(first.tensors())
    for subject in (first, second):
        subject.descend(subject(x).square().mean() + subject.log_sigma.sum(), 1.0)
    assert all(torch.equal(a, b) for a, b in zip(first.parameters, second.parameters, strict=True))
