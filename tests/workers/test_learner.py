import math
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import scipy.stats
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.workers.toy_environments import Choice, job, settings
from workers.learning.learner import Batch, Learner, advantages, discounted_returns, stream
from workers.learning.policy import ActionMap
from workers.learning.rollout import Episode


def test_advantages_of_a_hand_worked_episode():
    # gamma 0.5, lambda 0.5; deltas: 3 + 0.5 * 8 - 4 = 3, 2 + 0.5 * 4 - 8 = -4, 1 + 0.5 * 6 - 4 = 0 (from the first
    # step back to front: 1 + .5 * 8 - 4 = 1, 2 + .5 * 4 - 8 = -4, 3 + .5 * 6 - 4 = 2).
    # A_2 = 2; A_1 = -4 + 0.25 * 2 = -3.5; A_0 = 1 + 0.25 * -3.5 = 0.125.
    found = advantages([1.0, 2.0, 3.0], [4.0, 8.0, 4.0], 6.0, 0.5, 0.5)
    assert found.tolist() == [0.125, -3.5, 2.0]


numbers = st.floats(-10, 10)


@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=12), numbers, st.floats(0, 1), st.floats(0, 1))
def test_advantages_agree_with_the_weighted_sum_of_n_step_advantages(steps, bootstrap, gamma, lam):
    rewards, values = [r for r, _ in steps], [v for _, v in steps]
    T = len(rewards)
    states = [*values, bootstrap]
    for t in range(T):
        # 2016, equation 16: A_t = sum_l (gamma lambda)^l delta_{t+l}.
        slow = sum(
            (gamma * lam) ** k * (rewards[t + k] + gamma * states[t + k + 1] - states[t + k]) for k in range(T - t)
        )
        assert advantages(rewards, values, bootstrap, gamma, lam)[t] == pytest.approx(slow, abs=1e-9)


def test_discounted_returns_of_a_hand_worked_episode():
    assert discounted_returns([1.0, 2.0, 4.0], 0.5).tolist() == [3.0, 4.0, 4.0]


def learner(actions=None, **ppo):
    return Learner(job(), settings(**ppo), 2, actions or ActionMap.box(np.array([-1.0]), np.array([1.0])))


def an_episode(rewards, *, terminated, last=(1.0, 1.0)):
    return Episode(
        [np.array([float(i), 1.0]) for i in range(len(rewards))],
        [np.array([0.1 * i], np.float32) for i in range(len(rewards))],
        list(rewards),
        np.array(last),
        terminated,
        {},
    )


def test_a_truncated_episode_is_worth_what_the_critic_sees_in_its_last_state_and_a_finished_one_nothing():
    subject = learner(gae_lambda=1.0, gamma=0.5)
    with torch.no_grad():
        subject.critic.parameters[-1].fill_(3.0)
        value = float(subject.critic(torch.tensor(subject.normaliser(np.array([[1.0, 1.0]]))))[0, 0])
    ended, cut = (subject.batch([an_episode([1.0, 2.0], terminated=t)]).returns.tolist() for t in (True, False))
    assert ended == pytest.approx([2.0, 2.0], abs=1e-5)
    assert cut == pytest.approx([2.0 + 0.25 * value, 2.0 + 0.5 * value], abs=1e-5)


def test_normalised_rewards_make_the_unit_of_the_reward_irrelevant():
    batches = [
        learner(normalise_rewards=True).batch([an_episode([s * r for r in (1.0, -2.0, 5.0)], terminated=True)])
        for s in (1.0, 1000.0)
    ]
    np.testing.assert_allclose(batches[0].returns, batches[1].returns, rtol=1e-4)


def a_batch(n, advantage):
    return Batch(torch.zeros(n, 2), torch.full((n, 1), 0.3), advantage, torch.zeros(n))


def test_an_update_makes_good_actions_likelier_and_bad_ones_less_likely():
    for sign in (1.0, -1.0):
        subject = learner(minibatch=16)
        batch = a_batch(16, torch.full((16,), sign))
        before, _ = subject._log_probability(batch.observations, batch.actions, torch.tensor([0.4]))
        subject.update(batch, 1, np.random.default_rng(0))
        after, _ = subject._log_probability(batch.observations, batch.actions, torch.tensor([0.4]))
        assert sign * (after - before).mean().item() > 0


def test_beyond_the_clip_a_good_action_pulls_no_further():
    """With ratios beyond 1 + clip the objective is flat: no gradient, so Adam's first step moves nothing."""
    subject = learner(clip=0.1, epochs=1, minibatch=16)
    batch = a_batch(16, torch.ones(16))
    old = subject._log_probability
    calls = []

    def shifted(*arguments):
        result, entropy = old(*arguments)
        calls.append(None)
        return (result - 0.5 if len(calls) == 1 else result), entropy  # the sampling policy found them less likely

    subject._log_probability = shifted
    before = [p.detach().clone() for p in subject.actor.parameters]
    subject.update(batch, 1, np.random.default_rng(0))
    assert all(torch.equal(a, b) for a, b in zip(before, subject.actor.parameters, strict=True))


def test_updates_end_early_where_the_policy_has_moved_too_far():
    steps = []
    for stop in (1e-9, 1e9):
        subject = learner(kl_stop=stop, epochs=5, minibatch=16)
        subject.update(a_batch(16, torch.linspace(-1, 1, 16)), 1, np.random.default_rng(0))
        steps.append(subject.actor.steps)
    assert steps == [2, 5]  # the first step leaves the sampling policy, the second epoch sees it


def test_updates_end_within_an_epoch_where_every_step_is_checked():
    steps = {}
    for check in ("epoch", "step"):
        subject = learner(kl_stop=1e-9, kl_check=check, epochs=5, minibatch=4)
        subject.update(a_batch(16, torch.linspace(-1, 1, 16)), 1, np.random.default_rng(0))
        steps[check] = subject.actor.steps
    assert steps == {"epoch": 4, "step": 2}


def test_a_check_after_a_step_goes_by_the_last_samples_of_all_epochs(monkeypatch):
    monkeypatch.setattr("workers.learning.learner.KL_SAMPLES", 8)
    subject = learner(kl_stop=0.5, kl_check="step", epochs=9, minibatch=4)
    # log-ratios of the sampling policy and of each minibatch; one of 1 is a divergence of e - 2 = 0.72
    shifts = iter([0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    original = subject._log_probability

    def shifted(*arguments):
        result, entropy = original(*arguments)
        return 0 * result + next(shifts), entropy

    subject._log_probability = shifted
    found = subject.update(a_batch(4, torch.linspace(-1, 1, 4)), 1, np.random.default_rng(0))
    assert subject.actor.steps == 6  # two in a row
    assert found["kl"] == pytest.approx(math.e - 2, abs=1e-6)


def test_annealed_exploration_falls_on_a_straight_line_and_stays():
    subject = learner(sigma_start=0.5, sigma_end=0.1, sigma_iterations=4)
    assert [round(float(subject.sigma(k)[0]), 6) for k in (1, 2, 3, 5, 50)] == [0.5, 0.4, 0.3, 0.1, 0.1]


def after_updates(count, **ppo):
    subject = learner(**ppo)
    for iteration in range(1, count + 1):
        subject.update(a_batch(16, torch.linspace(-1, 1, 16)), iteration, np.random.default_rng(0))
    return subject


annealing = {"sigma_start": 0.5, "sigma_end": 0.1, "sigma_iterations": 4}


def test_a_childs_exploration_begins_anew_or_falls_on_from_its_parents():
    parent = after_updates(3, **annealing).policy()
    assert parent.sigma == pytest.approx([0.3])
    falls = {}
    for begins in ("start", "parent"):
        child = learner(sigma_child=begins, **annealing)
        child.warm_start(parent)
        falls[begins] = [round(float(child.sigma(k)[0]), 6) for k in (1, 2, 3, 9)]
    assert falls == {"start": [0.5, 0.4, 0.3, 0.1], "parent": [0.3, 0.2, 0.1, 0.1]}


@pytest.mark.parametrize(("found", "begins"), [(0.9, 0.5), (0.02, 0.1)], ids=["more than any", "less than any"])
def test_a_childs_exploration_stays_within_its_own_annealing(found, begins):
    child = learner(sigma_child="parent", **annealing)
    child.warm_start(replace(learner().policy(), sigma=np.array([found], np.float32)))
    assert child.sigma(1) == pytest.approx([begins])


def test_a_childs_learnt_exploration_goes_on_from_its_parents():
    parent = after_updates(3, sigma="learnt", sigma_start=0.4)
    assert parent.sigma(9) != pytest.approx([0.4], abs=1e-6)
    child = learner(sigma="learnt", sigma_start=0.2, sigma_child="parent")
    child.warm_start(parent.policy())
    assert child.sigma(1) == pytest.approx(parent.sigma(9))


def test_a_parent_that_does_not_tell_its_exploration_changes_nothing():
    child = learner(sigma_child="parent", **annealing)
    child.warm_start(learner().policy())
    assert child.sigma(1) == pytest.approx([0.5])


def test_a_checkpoint_keeps_where_exploration_has_got():
    parent = after_updates(3, **annealing).policy()
    child = learner(sigma_child="parent", **annealing)
    child.warm_start(parent)
    child.update(a_batch(16, torch.linspace(-1, 1, 16)), 1, np.random.default_rng(0))
    resumed = learner(sigma_child="parent", **annealing)
    resumed.load(child.tensors())
    assert resumed.sigma(2) == pytest.approx([0.2])
    assert resumed.policy().to_bytes() == child.policy().to_bytes()


def test_learnt_exploration_is_the_derivative_of_a_normal_density():
    subject = learner(sigma="learnt", sigma_start=0.4)
    rng = np.random.default_rng(3)
    observations, actions = (torch.tensor(rng.normal(size=(6, n)), dtype=torch.float32) for n in (2, 1))
    found, entropy = subject._log_probability(observations, actions, torch.tensor([0.4]))
    mean = subject.actor(observations).detach().numpy()
    expected = scipy.stats.norm.logpdf(actions.numpy(), mean, 0.4).sum(1) + 0.5 * math.log(2 * math.pi)
    np.testing.assert_allclose(found.detach().numpy(), expected, rtol=1e-5)
    assert entropy.item() == pytest.approx(scipy.stats.norm.entropy(scale=0.4) - 0.5 * math.log(2 * math.pi * math.e))


def test_choices_are_drawn_as_often_as_their_probabilities_say():
    subject = learner(ActionMap("discrete", 3))
    with torch.no_grad():
        subject.actor.parameters[-2].zero_()
        subject.actor.parameters[-1].copy_(torch.tensor([0.5, 0.2, 0.3]).log())

    class Still(Choice):
        action_space = gymnasium.spaces.Discrete(3)
        length = 50

        def step(self, action):
            self.t += 1
            return self.observe(), 0.0, self.t >= self.length, False, {}

    subject.ppo = settings(samples=5000).ppo
    episodes = subject.rollout([Still() for _ in range(4)], job(), 1, sampling=1, level=None)
    chosen = np.concatenate([e.actions for e in episodes])
    np.testing.assert_allclose(np.bincount(chosen) / len(chosen), [0.5, 0.2, 0.3], atol=0.025)


def test_random_numbers_differ_between_purposes_iterations_and_seeds_and_are_equal_otherwise():
    def first(seed, purpose, iteration):
        return stream(job(seed=seed), purpose, iteration).integers(2**62)

    draws = {first(s, p, i) for s in (1, 2) for p in ("actions", "episodes") for i in (0, 1, 2)}
    assert len(draws) == 12
    assert first(1, "actions", 2) == first(1, "actions", 2)
