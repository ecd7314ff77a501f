import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import save

from workers.contracts import BadJob
from workers.learning.policy import ActionMap, Normaliser, Policy, forward


def layers(rng, *sizes):
    return [
        (rng.normal(size=(a, b)).astype(np.float32), rng.normal(size=b).astype(np.float32))
        for a, b in itertools.pairwise(sizes)
    ]


def policy(actions=None, activation="relu", seed=0):
    rng = np.random.default_rng(seed)
    actions = actions or ActionMap.box(np.array([-2.0, -np.inf]), np.array([6.0, np.inf]))
    normaliser = Normaliser.identity(3).updated(rng.normal(2.0, 3.0, (50, 3)))
    return Policy(activation, actions, normaliser, layers(rng, 3, 5, 4, actions.size), layers(rng, 3, 5, 4, 1))


@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_the_numpy_network_agrees_with_torch(activation):
    rng = np.random.default_rng(1)
    weights = layers(rng, 3, 16, 8, 2)
    x = rng.normal(size=(7, 3)).astype(np.float32)
    expected = torch.tensor(x)
    for i, (weight, bias) in enumerate(weights):
        expected = expected @ torch.tensor(weight) + torch.tensor(bias)
        if i < len(weights) - 1:
            expected = getattr(torch, activation)(expected)
    np.testing.assert_allclose(forward(weights, x, activation), expected.numpy(), rtol=1e-4, atol=1e-5)


def test_a_hand_worked_network_gives_the_hand_worked_output():
    weights = [
        (np.array([[1.0, -1.0]], np.float32), np.array([0.0, 1.0], np.float32)),
        (np.array([[2.0], [3.0]], np.float32), np.array([0.5], np.float32)),
    ]
    # x = 2: hidden (2, -1) -> relu (2, 0); output 2 * 2 + 0.5. x = -2: hidden (-2, 3) -> (0, 3); output 9.5.
    assert forward(weights, np.array([[2.0], [-2.0]], np.float32), "relu").tolist() == [[4.5], [9.5]]


def test_a_bounded_action_is_scaled_to_its_bounds_and_clipped_and_an_unbounded_one_is_left_alone():
    actions = ActionMap.box(np.array([-2.0, -np.inf]), np.array([6.0, np.inf]))
    outputs = np.array([[0.0, 0.0], [1.0, 1.0], [-1.0, -7.5], [3.0, 100.0]], np.float32)
    assert actions.to_environment(outputs).tolist() == [[2.0, 0.0], [6.0, 1.0], [-2.0, -7.5], [6.0, 100.0]]


def test_a_policy_read_back_acts_to_the_last_bit_as_the_one_written():
    for actions in (None, ActionMap("discrete", 4, start=2)):
        written = policy(actions)
        read = Policy.from_bytes(written.to_bytes())
        observation = np.array([0.3, -4.0, 11.0])
        assert np.array_equal(read.act(observation), written.act(observation))
        assert read.to_bytes() == written.to_bytes()
        assert read.sha256() == written.sha256()
        assert (read.hidden, read.observation_size, read.activation) == ((5, 4), 3, "relu")


def test_the_hash_sees_a_change_of_one_weight_and_of_the_statistics():
    original = policy()
    changed = Policy.from_bytes(original.to_bytes())
    weight = changed.critic[0][0].copy()
    weight[0, 0] = np.nextafter(weight[0, 0], 9, dtype=np.float32)
    critic = [(weight, changed.critic[0][1]), *changed.critic[1:]]
    assert Policy("relu", changed.actions, changed.normaliser, changed.actor, critic).sha256() != original.sha256()
    statistics = original.normaliser.updated(np.ones((1, 3)))
    assert Policy("relu", original.actions, statistics, original.actor, original.critic).sha256() != original.sha256()


def test_the_exploration_is_kept_where_it_is_known():
    known = replace(policy(), sigma=np.array([0.3, 0.2], np.float32))
    assert Policy.from_bytes(known.to_bytes()).sigma.tolist() == known.sigma.tolist()
    assert Policy.from_bytes(policy().to_bytes()).sigma is None
    assert known.sha256() != policy().sha256()


def test_the_likeliest_choice_is_taken_counted_from_the_first_action():
    logits = [(np.zeros((1, 3), np.float32), np.array([0.0, 2.0, 1.0], np.float32))]
    chooser = Policy("relu", ActionMap("discrete", 3, start=5), Normaliser.identity(1), logits, logits)
    assert chooser.act(np.zeros(1)) == 6


@pytest.mark.parametrize("data", [b"", b"nonsense", save({"a": np.zeros(2)}), policy().to_bytes()[:-8]])
def test_what_is_no_policy_is_refused(data):
    with pytest.raises(BadJob, match=r"policy: expected a policy.safetensors written by halma, found something else"):
        Policy.from_bytes(data)


@given(st.lists(st.integers(1, 6), min_size=1, max_size=5), st.integers(0, 2**31))
def test_observation_statistics_do_not_depend_on_how_observations_arrive(sizes, seed):
    rng = np.random.default_rng(seed)
    chunks = [rng.normal(rng.uniform(-5, 5), rng.uniform(0.1, 4), (n, 2)) for n in sizes]
    normaliser = Normaliser.identity(2)
    for chunk in chunks:
        normaliser = normaliser.updated(chunk)
    everything = np.concatenate(chunks)
    np.testing.assert_allclose(normaliser.mean, everything.mean(0), atol=1e-9)
    np.testing.assert_allclose(normaliser.var, everything.var(0), atol=1e-9)
    assert normaliser.count == len(everything)


def test_a_normalised_observation_is_clipped_and_a_constant_one_is_zero():
    normaliser = Normaliser.identity(2, clip=3.0).updated(np.array([[1.0, 7.0], [3.0, 7.0]]))
    np.testing.assert_allclose(
        normaliser(np.array([[3.0, 7.0], [2.0, 7.0], [500.0, 7.0]])), [[1, 0], [0, 0], [3, 0]], atol=1e-6
    )
