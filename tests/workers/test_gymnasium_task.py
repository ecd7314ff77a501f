import math
import sys

import gymnasium
import numpy as np
import pytest

from tests.workers.toy_environments import Choice, Target, job
from workers.contracts import BadJob, BadSetting
from workers.learning.policy import Policy
from workers.learning.ppo import POLICY_ARTIFACT
from workers.learning.problem import Diverged
from workers.local_context import LocalContext
from workers.tasks.gymnasium_task import DEFAULTS, GymnasiumTask, Renewed, from_class, registered
from workers.user_code import EnvironmentFailed, UnknownTask

QUICK = {"budget": {"iterations": 2}, "network": {"hidden": [8]}, "ppo": {"samples": 60, "environments": 2}}
FACING = {"kind": "circle", "names": ["facing"], "distinct": 0.5}


class Sized(Target):
    """A target whose reward has a size."""

    def __init__(self, size=1.0, z=1.0, colour="red"):
        self.size, self.z, self.colour = size, z, colour

    def step(self, action):
        observation, reward, over, cut, info = super().step(action)
        if over:
            info["features"] = [0.25 * self.size]
        return observation, self.size * reward, over, cut, info


def outcome(task, tmp_path, params=None, settings=None, training=None, **fields):
    context = LocalContext(tmp_path)
    settings = {"episodes": 3} | (settings or {})
    return task.run(job(params=params or {}, task_settings=settings, training=training or QUICK, **fields), context)


def test_a_registered_environment_is_trained_and_its_mean_return_is_the_value(tmp_path):
    found = outcome(registered("CartPole-v1"), tmp_path, training=QUICK | {"budget": {"samples": 400}})
    assert found.status == "complete"
    assert found.features is None
    assert found.value == pytest.approx(found.details["episode_length"])  # a reward of one a step
    assert found.cost.samples >= 400
    policy = Policy.from_bytes(LocalContext(tmp_path).artifact(POLICY_ARTIFACT))
    assert (policy.observation_size, policy.actions.kind, policy.actions.size) == (4, "discrete", 2)


def test_the_value_is_that_of_the_kept_policy_played_again(tmp_path):
    found = outcome(from_class("m:Sized", Sized), tmp_path, settings={"episodes": 4})
    policy = Policy.from_bytes(LocalContext(tmp_path).artifact(POLICY_ARTIFACT))
    returns = []
    for seed in job().rng("evaluation").integers(2**31, size=4):
        env = Sized()
        observation, _ = env.reset(seed=int(seed))
        total, over = 0.0, False
        while not over:
            observation, reward, over, _, _ = env.step(policy.act(observation))
            total += reward
        returns.append(total)
    assert found.value == pytest.approx(np.mean(returns), rel=1e-12)


def test_parameters_are_learner_settings_or_constructor_arguments(tmp_path):
    made = []

    class Noting(Sized):
        def __init__(self, size=1.0, colour="red"):
            super().__init__(size, 1.0, colour)
            made.append((size, colour))

    params = {"ppo.epochs": 1, "size": 3.0}
    task = from_class("m:Noting", Noting)
    task.validate({}, QUICK, list(params))
    outcome(task, tmp_path, params, {"arguments": {"colour": "blue"}})
    assert set(made[1:]) == {(3.0, "blue")}


def test_a_learner_setting_that_is_searched_over_changes_the_training(tmp_path):
    task = from_class("m:Sized", Sized)
    policies = []
    for i, rate in enumerate([1e-4, 1e-2]):
        outcome(task, tmp_path / str(i), {"ppo.actor_rate": rate})
        policies.append(LocalContext(tmp_path / str(i)).artifact(POLICY_ARTIFACT))
    assert policies[0] != policies[1]


def test_a_setting_out_of_range_is_refused_when_the_trial_runs(tmp_path):
    with pytest.raises(BadSetting, match=r"training.ppo.clip: expected a number above 0 and at most 1, found -1"):
        outcome(from_class("m:Sized", Sized), tmp_path, {"ppo.clip": -1})


@pytest.mark.parametrize(("z", "given"), [(None, 1.0), (0.25, 0.25), (0.0, 0.0)])
def test_an_argument_named_z_is_the_difficulty(tmp_path, z, given):
    seen = set()

    class Hard(Target):
        def __init__(self, z=0.5):
            seen.add(z)

    task = from_class("m:Hard", Hard)
    assert task.info({}).has_difficulty
    outcome(task, tmp_path, z=z)
    assert seen == {given}


@pytest.mark.parametrize(("z", "given"), [(None, 6.0), (0.25, 3.0), (0.0, 2.0)])
def test_the_settings_can_say_which_argument_difficulty_stands_for(tmp_path, z, given):
    seen = set()

    class Heavy(Target):
        def __init__(self, weight=0.5):
            seen.add(weight)

    task, settings = from_class("m:Heavy", Heavy), {"difficulty": {"argument": "weight", "low": 2, "high": 6}}
    assert task.info(settings).has_difficulty
    assert not task.info({}).has_difficulty
    outcome(task, tmp_path, settings=settings, z=z)
    assert seen == {given}


def test_features_are_the_mean_of_what_the_environment_says_at_the_end_of_its_episodes(tmp_path):
    found = outcome(from_class("m:Sized", Sized), tmp_path, {"size": 2.0}, {"features": FACING})
    assert found.features == pytest.approx((0.5,))


def test_declared_features_that_the_environment_does_not_give_are_asked_for(tmp_path):
    message = r'info\["features"\] at the end of an episode: expected 1 features \(facing\), found none'
    with pytest.raises(BadJob, match=message):
        outcome(from_class("m:Choice", Choice), tmp_path, settings={"features": FACING})


def test_features_that_become_nan_are_a_divergence(tmp_path):
    class Lost(Target):
        def step(self, action):
            observation, reward, over, cut, _ = super().step(action)
            return observation, reward, over, cut, {"features": [math.nan]}

    with pytest.raises(Diverged, match=r"iteration 2: features became NaN"):
        outcome(from_class("m:Lost", Lost), tmp_path, settings={"features": FACING})


def test_a_time_limit_of_the_settings_ends_episodes(tmp_path):
    class Endless(Target):
        length = 10**9

    found = outcome(from_class("m:Endless", Endless), tmp_path, settings={"max_episode_steps": 7})
    assert found.details["episode_length"] == 7.0


def test_observations_of_any_flat_kind_are_flattened(tmp_path):
    class Grid(Target):
        observation_space = gymnasium.spaces.Box(-9.0, 9.0, (2, 1), np.float64)

        def observe(self):
            return super().observe()[:, None]

    assert outcome(from_class("m:Grid", Grid), tmp_path).status == "complete"


def test_an_environment_is_new_at_each_fresh_reset_and_only_then():
    made = []

    def make():
        made.append(Target())
        return made[-1]

    env = Renewed(make, rebuild=True)
    env.reset(seed=1, options={"level": None, "fresh": True})
    assert len(made) == 1
    env.reset(seed=2, options={"level": None, "fresh": False})
    assert len(made) == 1
    env.reset(seed=3, options={"level": None, "fresh": True})
    assert len(made) == 2
    assert made[-1].options is None
    env = Renewed(make, rebuild=False)
    env.reset(seed=1, options={"fresh": True})
    env.reset(seed=1, options={"fresh": True})
    assert len(made) == 3


@pytest.mark.parametrize(
    ("identifier", "message"),
    [
        ("CartPole-v9", "Gymnasium knows no environment 'CartPole-v9'; did you mean 'CartPole-v1'"),
        ("Pendulm-v1", "Gymnasium knows no environment 'Pendulm-v1'; did you mean 'Pendulum-v1'"),
        ("no_such_package:Jump-v0", "found no module named 'no_such_package'"),
    ],
)
def test_an_id_that_is_not_registered_is_refused_with_the_nearest_ones(identifier, message):
    with pytest.raises(UnknownTask) as refusal:
        registered(identifier)
    assert message in str(refusal.value)


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "Box2D", None)
    with pytest.raises(UnknownTask, match=r"task 'gymnasium:LunarLander-v3': a package it needs is missing: .*box2d"):
        registered("LunarLander-v3").validate({}, {}, [])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"episods": 3}, r"task.settings.episods: unknown setting; did you mean 'episodes'"),
        ({"episodes": 0}, "task.settings.episodes: expected a whole number of at least 1, found 0"),
        (
            {"max_episode_steps": 2.5},
            "task.settings.max_episode_steps: expected a whole number of at least 1, found 2.5",
        ),
        ({"rebuild": "no"}, "task.settings.rebuild: expected true or false, found 'no'"),
        (
            {"arguments": {"sise": 1}},
            "task.settings.arguments: the environment's constructor has no argument 'sise'; it has",
        ),
        (
            {"difficulty": "size"},
            "task.settings.difficulty: expected a mapping with argument, low and high, with budget",
        ),
        (
            {"difficulty": {"argument": "size", "low": "a", "high": 1}},
            "task.settings.difficulty.low: expected a number, found 'a'",
        ),
    ],
)
def test_a_wrong_setting_is_refused(settings, message):
    with pytest.raises(BadSetting, match=message):
        from_class("m:Sized", Sized).validate(settings, {}, [])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("ppo.clipp", r"space.ppo.clipp: no setting of the learner; did you mean 'ppo.clip'"),
        ("sizes", r"space.sizes: the environment's constructor has no argument 'sizes'; it has colour, size, z"),
    ],
)
def test_a_parameter_that_means_nothing_is_refused(name, message):
    with pytest.raises(BadSetting, match=message):
        from_class("m:Sized", Sized).validate({}, {}, [name])


def test_validation_looks_at_the_spaces():
    odd = type("Odd", (Target,), {"action_space": gymnasium.spaces.MultiBinary(3)})
    with pytest.raises(
        BadJob, match=r"expected a Box of one dimension or a Discrete as action space, found MultiBinary"
    ):
        from_class("m:Odd", odd).validate({}, {}, [])


def test_an_environment_that_cannot_be_made_is_told_by_the_users_traceback():
    class Grumpy(Target):
        def __init__(self):
            raise OSError("no display")

    with pytest.raises(EnvironmentFailed) as refusal:
        from_class("m:Grumpy", Grumpy).validate({}, {}, [])
    lines = str(refusal.value).splitlines()
    assert lines[0] == "task 'm:Grumpy': its environment could not be made"
    assert lines[-1] == "OSError: no display"
    assert "workers/tasks" not in refusal.value.trace


def test_an_argument_without_default_is_left_to_the_space(tmp_path):
    class Needy(Target):
        def __init__(self, length):
            self.length = length

    task = from_class("m:Needy", Needy)
    task.validate({}, QUICK, ["length"])
    assert outcome(task, tmp_path, {"length": 5}).details["episode_length"] == 5.0


def test_its_own_space_and_training_settings_are_told():
    info = registered("Pendulum-v1").info({})
    assert "ppo.actor_rate" in info.parameters
    assert info.training == DEFAULTS.to_json()
    assert not info.has_difficulty
    assert isinstance(registered("Pendulum-v1"), GymnasiumTask)


def test_difficulty_can_be_a_part_of_the_budget(tmp_path):
    task = from_class("m:Sized", Sized)
    settings = {"difficulty": {"budget": 0.25}}
    assert task.info(settings).has_difficulty
    assert task.budget_at(settings, {"budget": {"samples": 1000, "iterations": 10}}, 0.0).samples == 250
    assert task.budget_at(settings, {"budget": {"samples": 1000, "iterations": 10}}, 0.5).iterations == 6
    training = QUICK | {"budget": {"samples": 1000}}
    samples = [
        outcome(task, tmp_path / str(z), settings=settings, training=training, z=z).cost.samples for z in (0.0, 1.0)
    ]
    assert 250 <= samples[0] < 350
    assert 1000 <= samples[1] < 1100


@pytest.mark.parametrize("share", [0, 1.5, "all", True])
def test_a_part_of_the_budget_is_a_share(share):
    with pytest.raises(BadSetting, match=r"difficulty.budget: expected a share above 0 and at most 1"):
        from_class("m:Sized", Sized).validate({"difficulty": {"budget": share}}, {}, [])
