import math

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from tests.workers.toy_environments import job
from workers.contracts import BadSetting
from workers.learning.policy import Policy
from workers.learning.ppo import POLICY_ARTIFACT
from workers.learning.rollout import play
from workers.local_context import LocalContext
from workers.tasks.point_jump import Hop, PointJump


def hop(action, level=0.3, **state):
    env = Hop(**({"speed": 2.0, "spin": 0.0, "lean": 0.0, "distance": 1.0} | state))
    env.reset(seed=1, options={"level": level})
    while True:
        observation, reward, over, _, info = env.step(np.array(action, np.float32))
        if over:
            return observation, reward, info, env


def test_it_is_an_environment_that_gymnasium_accepts():
    with pytest.warns(UserWarning, match="not within the observation space|Box|spec"):
        check_env(Hop(2.0, 0.0, 0.0, 1.0))


def test_free_flight_is_a_parabola():
    env = Hop(2.0, 0.0, 0.0, 10.0)
    env.reset(seed=1)
    env.x, env.y, env.vx, env.vy, env.left = -10.0, 1.0, 3.0, 2.0, True
    for _ in range(8):
        env.step(np.ones(2, np.float32))
    t = 0.4
    assert env.x == pytest.approx(-10 + 3 * t)
    assert env.y == pytest.approx(1 + 2 * t - 9.81 * t**2 / 2)
    assert env.vy == pytest.approx(2 - 9.81 * t)


def test_a_full_push_clears_a_low_bar_and_no_push_none():
    observation, reward, info, _ = hop([0.0, 1.0])
    assert (reward, info["success"]) == (1.0, True)
    assert info["height"] >= 0.3
    assert observation[0] >= 0
    _, reward, info, _ = hop([0.0, -1.0])
    assert (reward, info["success"], info["height"]) == (0.0, False, 0.0)


def test_a_bar_above_the_hop_is_touched():
    height = hop([0.0, 1.0])[2]["height"]
    assert hop([0.0, 1.0], level=height - 1e-6)[2]["success"]
    assert not hop([0.0, 1.0], level=height + 1e-6)[2]["success"]


def test_the_body_turns_with_its_spin_until_it_passes_the_bar():
    still, turning = (hop([0.0, 1.0], spin=s, lean=0.5)[2]["facing"] for s in (0.0, 2.0))
    assert still == 0.5
    speed = hop([0.0, 1.0])[3].vx
    assert turning == pytest.approx(0.5 + 2.0 * 1.0 / speed, abs=0.01)
    assert -math.pi < hop([0.0, 1.0], spin=6.0, lean=3.0)[2]["facing"] <= math.pi


def test_it_learns_to_clear_a_bar_of_a_metre(tmp_path):
    found = PointJump().run(job(params={"speed": 2.0, "spin": 2.0, "lean": 0.0}), LocalContext(tmp_path))
    assert found.status == "complete"
    assert found.details["mastered"]
    assert found.details["bar"] == 1.0
    assert found.value > 0.9
    reports = LocalContext(tmp_path).reports()
    assert reports[0]["metrics"]["level"] == 0.3
    assert reports[-1]["metrics"]["level_mastered"] == 1.0


def test_a_standing_start_never_gets_to_the_bar(tmp_path):
    training = {"budget": {"iterations": 3}}
    found = PointJump().run(job(params={"speed": 0.0}, training=training), LocalContext(tmp_path))
    assert (found.status, found.value, found.features) == ("infeasible", None, None)
    assert found.message == "the hop doesn't get as far as the bar"


def test_difficulty_is_the_height_of_the_bar(tmp_path):
    easy = PointJump().run(job(params={"speed": 2.0}, z=0.0), LocalContext(tmp_path / "easy"))
    assert easy.details["bar"] == 0.3
    hard = PointJump().run(job(params={"speed": 2.0}, z=1.0), LocalContext(tmp_path / "hard"))
    assert easy.cost.samples < hard.cost.samples


def test_the_kept_policy_makes_the_reported_hop(tmp_path):
    subject = job(params={"speed": 2.0, "spin": 1.0, "lean": 0.2})
    found = PointJump().run(subject, LocalContext(tmp_path))
    policy = Policy.from_bytes(LocalContext(tmp_path).artifact(POLICY_ARTIFACT))
    seed = int(subject.rng("evaluation").integers(2**31))
    again = play(Hop(2.0, 1.0, 0.2, 1.0), policy, seed=seed, level=found.details["bar"])
    assert (again.info["height"], again.info["facing"]) == (found.value, *found.features)


@pytest.mark.parametrize(
    ("settings", "names", "message"),
    [
        ({"bra": 1.0}, [], r"task.settings.bra: expected one of bar, distance"),
        ({"bar": 0.1}, [], r"task.settings.bar: expected a number from 0.3 to 3, found 0.1"),
        ({}, ["sped"], r"space.sped: expected one of speed, spin, lean"),
    ],
)
def test_wrong_settings_are_refused(settings, names, message):
    with pytest.raises(BadSetting, match=message):
        PointJump().validate(settings, {}, names)
