"""`halma task check`: tasks that break a promise are found out, those that keep them are not."""

import gymnasium
import numpy as np
import pytest

from tests.workers.toy_environments import Choice, Target
from workers.checking import check_task
from workers.contracts import ParameterSpec
from workers.registry import load_task
from workers.tasks.function import FunctionTask
from workers.tasks.gymnasium_task import from_class

SPACE = {"x": ParameterSpec("float", 0.0, 1.0)}


class Keeps(Target):
    """Keeps its promises: its space is bounded, and z makes it longer."""

    observation_space = gymnasium.spaces.Box(-10.0, 10.0, (2,), np.float64)

    def __init__(self, z=1.0):
        self.length = 2 + round(4 * z)


class Unseeded(Keeps):
    def observe(self):
        self.side = float(np.random.default_rng().choice([-1.0, 1.0]))
        return np.array([5.0 * self.side, np.random.default_rng().normal()])


class Remembers(Keeps):
    count = 0

    def reset(self, *, seed=None, options=None):
        self.count += 1
        return super().reset(seed=seed, options=options)

    def observe(self):
        return np.append(super().observe()[:1], float(self.count))


class GivesNaN(Keeps):
    def step(self, action):
        observation, _, over, cut, info = super().step(action)
        return observation, float("nan") if over else 0.0, over, cut, info


class Blind(Keeps):
    def observe(self):
        return super().observe() * np.nan


class Longer(Keeps):
    def step(self, action):
        observation, *rest = super().step(action)
        return (np.append(observation, 0.0), *rest)


class Endless(Keeps):
    def step(self, action):
        observation, reward, _, _, _ = super().step(action)
        return observation, reward, False, False, {}


class Raises(Keeps):
    def step(self, action):
        return 1 / 0


def found(task, name="m:f", settings=None, **more):
    return {f.check: f for f in check_task(task, name=name, settings=settings or {}, **more)}


def looked_at(cls, **settings):
    return found(from_class(f"tests.workers.test_checking:{cls.__name__}", cls), settings={"episodes": 2, **settings})


def test_an_environment_that_keeps_its_promises_passes():
    checks = looked_at(Keeps, difficulty={"budget": 0.2})
    assert {name: f.verdict for name, f in checks.items()} == dict.fromkeys(
        ["settings", "spaces", "gymnasium", "episodes", "seeding", "determinism", "difficulty", "resumption"], "good"
    )
    assert "20,000 at z = 0, 40,000 at z = 0.25" in checks["difficulty"].found


def test_a_discrete_environment_is_looked_at_as_well():
    checks = found(from_class("m:Choice", Choice))
    assert [f.check for f in checks.values() if f.verdict == "bad"] == []


@pytest.mark.parametrize(
    ("cls", "check", "words", "remedy"),
    [
        (Unseeded, "seeding", "same seed and the same actions differ", "self.np_random"),
        (Unseeded, "determinism", "two runs of the same job differ", "self.np_random"),
        (GivesNaN, "episodes", "the reward of step 6 is nan", "division by 0"),
        (Blind, "episodes", "an observation holds NaN", "finite"),
        (Longer, "episodes", r"an observation has shape (3,), the observation space (2,)", "both the same"),
        (Endless, "episodes", "an episode had not ended after 10,000 steps", "max_episode_steps: 500"),
        (Raises, "episodes", "ZeroDivisionError: division by zero", "mend the error"),
    ],
)
def test_a_broken_promise_is_told_with_what_to_mend(cls, check, words, remedy):
    finding = looked_at(cls)[check]
    assert finding.verdict == "bad"
    assert words in finding.found
    assert remedy in finding.remedy


def test_an_environment_that_remembers_is_doubtful_since_each_iteration_gets_a_new_one():
    checks = looked_at(Remembers)
    assert (checks["seeding"].verdict, checks["determinism"].verdict) == ("doubtful", "good")
    assert "rebuild" in checks["seeding"].remedy
    assert checks["resumption"].verdict == "good"
    assert looked_at(Remembers, rebuild=False)["resumption"].verdict == "doubtful"


def test_difficulties_that_cost_the_same_save_nothing():
    finding = looked_at(Keeps)["difficulty"]
    assert finding.verdict == "doubtful"
    assert "every difficulty costs the same (100,000 samples)" in finding.found
    assert "budget: 0.2" in finding.remedy


def test_a_wrong_setting_ends_the_check():
    (finding,) = looked_at(Keeps, episods=3).values()
    assert (finding.check, finding.verdict) == ("settings", "bad")
    assert "did you mean 'episodes'" in finding.found


def rising(params, z):
    return params["x"], None, 10 + 90 * z


def falling(params, z):
    return params["x"], None, 100 - 90 * z


def costless(params, z):
    return params["x"]


@pytest.mark.parametrize(
    ("function", "verdict", "words"),
    [
        (rising, "good", "10 at z = 0, 33 at z = 0.25"),
        (falling, "bad", "the cost in samples falls as z rises"),
        (costless, "doubtful", "every difficulty costs the same"),
    ],
)
def test_a_functions_cost_must_rise_with_the_difficulty(function, verdict, words):
    task = FunctionTask("m:f", function)
    finding = found(task, space=SPACE)["difficulty"]
    assert finding.verdict == verdict
    assert words in finding.found


def test_a_function_needs_its_study_file_for_a_space():
    finding = found(FunctionTask("m:f", rising))["spaces"]
    assert finding.verdict == "bad"
    assert "halma task check FILE.yaml" in finding.remedy


def test_a_function_that_is_not_deterministic_is_found_out():
    drawn = np.random.default_rng(1)
    finding = found(FunctionTask("m:f", lambda params: float(drawn.random())), space=SPACE)["determinism"]
    assert finding.verdict == "bad"


def test_a_built_in_task_passes():
    checks = found(load_task("point_jump"), name="point_jump")
    assert {f.verdict for f in checks.values()} == {"good"}
