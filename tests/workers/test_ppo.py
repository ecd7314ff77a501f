import math

import gymnasium
import numpy as np
import pytest
import scipy.stats
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.workers.toy_environments import Choice, Target, ToyProblem, job, settings
from workers.contracts import BadJob, Interrupted
from workers.learning.learner import Batch, Learner, advantages, discounted_returns, stream
from workers.learning.networks import Network
from workers.learning.policy import ActionMap
from workers.learning.ppo import train
from workers.learning.problem import Diverged
from workers.learning.rollout import Episode
from workers.local_context import LocalContext


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


def test_a_continuous_policy_learns_what_the_reward_asks_for(tmp_path):
    fast = {"actor_rate": 0.01, "critic_rate": 0.01, "sigma_end": 0.1, "sigma_iterations": 30}
    trained = train(job(), LocalContext(tmp_path), ToyProblem(), settings(40, **fast))
    assert trained.policy.act(np.array([5.0, 1.0]))[0] == pytest.approx(0.5, abs=0.1)
    assert trained.policy.act(np.array([-5.0, 1.0]))[0] == pytest.approx(-0.5, abs=0.1)


def test_a_discrete_policy_learns_what_the_reward_asks_for(tmp_path):
    trained = train(job(), LocalContext(tmp_path), ToyProblem(Choice), settings(20, actor_rate=0.01))
    assert [trained.policy.act(np.array([s, 1.0])) for s in (5.0, -5.0)] == [4, 3]


def test_each_iteration_plays_whole_episodes_and_reports_what_they_cost(tmp_path):
    context = LocalContext(tmp_path)
    trained = train(job(), context, ToyProblem(), settings(2, samples=50, environments=4))
    first, second = context.reports()
    # Episodes of 3 steps: 17 of them reach 50. The first iteration also warms up.
    assert first["metrics"]["episodes"] == 17
    assert (first["samples"], second["samples"]) == (102, 153)
    assert trained.cost.samples == 153
    assert trained.iterations == 2
    assert first["metrics"]["episode_length"] == 3.0
    assert {"return_mean", "success_rate", "kl", "sigma", "samples_per_second", "critic_loss"} <= set(first["metrics"])


def test_the_budget_in_samples_ends_the_training_at_the_first_iteration_that_reaches_it(tmp_path):
    from workers.learning.settings import Budget, TrainingSettings

    small = settings()
    trained = train(
        job(), LocalContext(tmp_path), ToyProblem(), TrainingSettings(Budget(130), small.network, small.ppo)
    )
    assert (trained.iterations, trained.cost.samples) == (2, 144)


class Broken(Target):
    """Gives `bad` as reward or observation from its 40th step on (all environments counted)."""

    steps = 0
    quantity, bad = "reward", math.nan

    def step(self, action):
        Broken.steps += 1
        observation, reward, over, cut, info = super().step(action)
        if Broken.steps > 200 and self.quantity == "reward":
            reward = self.bad
        if Broken.steps > 200 and self.quantity == "observation":
            observation = np.array([1.0, self.bad])
        return observation, reward, over, cut, info


@pytest.mark.parametrize("quantity", ["reward", "observation"])
@pytest.mark.parametrize(("bad", "words"), [(math.nan, "NaN"), (-math.inf, "infinite")])
def test_a_number_that_is_none_ends_the_training_as_diverged_with_the_iteration(tmp_path, quantity, bad, words):
    class Subject(Broken):
        pass

    Subject.quantity, Subject.bad, Broken.steps = quantity, bad, 0
    context = LocalContext(tmp_path)
    with pytest.raises(Diverged) as raised:
        train(job(), context, ToyProblem(Subject), settings(20))
    # 48 samples an iteration, 48 more to warm up: step 201 lies in the fourth iteration.
    assert str(raised.value) == f"iteration 4: {quantity} became {words}"
    assert raised.value.cost.samples == 201, "what was played has been paid for, to the last step"
    assert raised.value.cost.seconds > 0
    assert [r["iteration"] for r in context.reports()] == [1, 2, 3]


def test_a_loss_that_explodes_ends_the_training_as_diverged(tmp_path):
    class Huge(Target):
        def step(self, action):
            observation, _, over, cut, info = super().step(action)
            return observation, 1e30, over, cut, info

    with pytest.raises(Diverged, match=r"^iteration 1: loss became infinite$"):
        train(job(), LocalContext(tmp_path), ToyProblem(Huge), settings())


def test_an_episode_that_never_ends_is_refused_with_what_to_do(tmp_path):
    class Endless(Target):
        length = 10**9

    with pytest.raises(BadJob, match=r"expected an episode to end within 30 steps.*give the environment a time limit"):
        train(job(), LocalContext(tmp_path), ToyProblem(Endless), settings(episode_limit=30))


def test_observations_of_another_shape_than_their_space_are_refused(tmp_path):
    class Longer(Target):
        def observe(self):
            return np.append(super().observe(), 0.0)

    with pytest.raises(BadJob, match=r"expected observations of shape \(2,\).*found shape \(3,\)"):
        train(job(), LocalContext(tmp_path), ToyProblem(Longer), settings())


@pytest.mark.parametrize(
    ("attribute", "space", "message"),
    [
        ("observation_space", gymnasium.spaces.Discrete(3), "expected a Box of one dimension as observation space"),
        (
            "action_space",
            gymnasium.spaces.MultiDiscrete([2, 2]),
            "expected a Box of one dimension or a Discrete as action",
        ),
    ],
)
def test_spaces_that_cannot_be_learnt_are_refused(tmp_path, attribute, space, message):
    odd = type("Odd", (Target,), {attribute: space})
    with pytest.raises(BadJob, match=message):
        train(job(), LocalContext(tmp_path), ToyProblem(odd), settings())


def test_environments_are_closed_whatever_happens(tmp_path):
    closed = []

    class Closing(Target):
        def step(self, action):
            raise RuntimeError("out of order")

        def close(self):
            closed.append(None)

    with pytest.raises(RuntimeError, match="out of order"):
        train(job(), LocalContext(tmp_path), ToyProblem(Closing), settings(environments=4))
    assert len(closed) == 4


def test_the_environment_is_told_level_and_freshness(tmp_path):
    told = []

    class Told(Target):
        def reset(self, *, seed=None, options=None):
            told.append((seed, options["level"], options["fresh"]))
            return super().reset(seed=seed, options=options)

    train(job(), LocalContext(tmp_path), ToyProblem(Told, {"start": 0.5, "step": 0.1}), settings(1, samples=20))
    seeds, levels, fresh = zip(*told, strict=True)
    # Warm-up and iteration, each 7 episodes of 3 steps in 4 environments, the first in each environment fresh.
    assert fresh == ((True,) * 4 + (False,) * 3) * 2
    assert set(levels) == {0.5}
    assert len(set(seeds)) == 14


def test_long_episodes_are_played_by_no_more_environments_than_an_iteration_needs(tmp_path):
    class Long(Target):
        length = 20

    context = LocalContext(tmp_path)
    train(job(), context, ToyProblem(Long), settings(2, samples=40, environments=8))
    assert [r["metrics"]["episodes"] for r in context.reports()] == [2, 2]


def test_a_stop_is_honoured_at_the_iteration_boundary_after_checkpoint_and_report(tmp_path):
    context = LocalContext(tmp_path, stop=lambda: len(context.reports()) >= 2)
    with pytest.raises(Interrupted, match="stopped at the checkpoint of iteration 2"):
        train(job(), context, ToyProblem(), settings(5))
    assert context.load_checkpoint().iteration == 2


def test_a_training_that_has_just_ended_is_not_interrupted(tmp_path):
    context = LocalContext(tmp_path, stop=lambda: len(context.reports()) >= 2)
    assert train(job(), context, ToyProblem(), settings(2)).iterations == 2


def test_a_checkpoint_of_another_network_is_refused(tmp_path):
    train(job(), LocalContext(tmp_path), ToyProblem(), settings(1))
    message = r"checkpoint: expected the actor to have layers of \(2, 5, 1\) and 21 numbers, found \(2, 8, 1\) and 33"
    with pytest.raises(BadJob, match=message):
        train(job(), LocalContext(tmp_path), ToyProblem(), settings(2, network={"hidden": [5]}))


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
