import math

import gymnasium
import numpy as np
import pytest

from tests.workers.toy_environments import Choice, Target, ToyProblem, job, settings
from workers.contracts import BadJob, Interrupted
from workers.learning.ppo import train
from workers.learning.problem import Diverged
from workers.local_context import LocalContext


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
