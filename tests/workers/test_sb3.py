import importlib.util

import numpy as np
import pytest

from tests.workers.toy_environments import job
from workers.contracts import BadSetting, Interrupted
from workers.learning.policy import Policy
from workers.local_context import LocalContext
from workers.run import run
from workers.tasks.gymnasium_task import registered
from workers.tasks.point_jump import PointJump

TINY = {
    "trainer": "sb3",
    "budget": {"iterations": 2},
    "network": {"hidden": [8]},
    "ppo": {"samples": 64, "environments": 2, "minibatch": 32, "epochs": 2},
}
SETTINGS = {"episodes": 2, "max_episode_steps": 20}


def mine(name="Pendulum-v1", **changes):
    return job(**{"task": f"gymnasium:{name}", "task_settings": SETTINGS, "training": TINY, "params": {}, **changes})


@pytest.mark.parametrize("name", ["Pendulum-v1", "CartPole-v1"])
def test_continuous_and_discrete_environments_are_trained_and_evaluated(name, tmp_path):
    context = LocalContext(tmp_path)
    outcome = run(mine(name), context)
    assert outcome.status == "complete", outcome.message
    assert outcome.cost.samples == 128
    assert outcome.details["iterations"] == 2
    assert context.reports()[-1]["metrics"]["samples"] == 128
    assert Policy.from_bytes(context.artifact("policy.safetensors")).hidden == (8,)


def test_the_policy_that_is_kept_acts_as_stable_baselines_does(tmp_path):
    from workers.learning.sb3 import _Training
    from workers.learning.settings import TrainingSettings
    from workers.tasks.gymnasium_task import DEFAULTS, EnvironmentProblem

    task = registered("Pendulum-v1")
    settings = TrainingSettings.parse(TINY, DEFAULTS, trainers=("sb3",))
    problem = EnvironmentProblem(task.maker(SETTINGS, {}, None), rebuild=True)
    training = _Training(mine(), LocalContext(tmp_path), problem, settings, TINY["ppo"])
    policy = training.policy()
    rng = np.random.default_rng(0)
    for _ in range(5):
        seen = rng.normal(size=3).astype(np.float32)
        theirs, _ = training.model.predict(seen, deterministic=True)
        assert policy.act(seen) == pytest.approx(theirs, abs=1e-5)
    training.envs.close()


def test_it_goes_on_bit_for_bit_and_leaves_the_global_generators_alone(tmp_path):
    np.random.seed(5)  # noqa: NPY002 - the global generator is what is tested
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    whole = LocalContext(tmp_path / "whole")
    undisturbed = run(mine(), whole)
    assert (np.random.get_state()[1] == before).all()  # noqa: NPY002
    parts = LocalContext(tmp_path / "parts", stop=lambda: True)
    with pytest.raises(Interrupted):
        run(mine(), parts)
    resumed = run(mine(), LocalContext(tmp_path / "parts"))
    assert resumed.value == undisturbed.value
    assert parts.artifact("policy.safetensors") == whole.artifact("policy.safetensors")
    # weights are tensors, counters are JSON: nothing is pickled
    assert sorted(path.suffix for path in (tmp_path / "parts" / "checkpoints").iterdir()) == [".safetensors"] * 2


def test_a_child_starts_from_its_parents_networks(tmp_path):
    run(mine(), LocalContext(tmp_path / "parent"))
    child = LocalContext(tmp_path / "child", parent=tmp_path / "parent")
    outcome = run(mine(parent=0), child)
    assert outcome.details["warm_start"] == {
        "parent": 0, "networks": True, "message": "started from the parent's policy",
    }  # fmt: skip
    other = LocalContext(tmp_path / "other", parent=tmp_path / "parent")
    outcome = run(mine("CartPole-v1", parent=0), other)
    assert outcome.status == "failed"
    assert (
        "expected a policy of 4 observations and discrete actions of size 2, found 3, continuous, 1" in outcome.message
    )


def test_it_learns(tmp_path):
    ppo = {"samples": 512, "environments": 4, "actor_rate": 0.002, "epochs": 10}
    training = {"trainer": "sb3", "budget": {"samples": 8000}, "network": {"hidden": [32, 32]}, "ppo": ppo}
    outcome = run(mine("CartPole-v1", training=training, task_settings={"episodes": 5}), LocalContext(tmp_path))
    assert outcome.value > 100, "a random policy stays up for 22 steps"


def test_without_the_package_the_message_says_how_to_get_it(monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda n: None if n == "stable_baselines3" else found(n))
    with pytest.raises(BadSetting) as refusal:
        registered("Pendulum-v1").validate({}, TINY, [])
    assert str(refusal.value) == (
        "training.trainer: expected the package stable-baselines3 for trainer sb3, found that it is not installed; "
        "pip install 'halma[sb3]', or leave trainer out"
    )


@pytest.mark.parametrize(
    ("training", "names", "message"),
    [
        ({**TINY, "ppo": {"critic_rate": 0.1}}, [], "training.ppo.critic_rate: no setting of trainer sb3; it knows"),
        (TINY, ["ppo.sigma_start"], "space.ppo.sigma_start: no setting of trainer sb3; it knows actor_rate"),
        ({**TINY, "trainer": "sb2"}, [], "training.trainer: expected halma or sb3, found the text 'sb2'"),
    ],
)
def test_what_it_cannot_do_is_refused_by_name(training, names, message):
    with pytest.raises(BadSetting) as refusal:
        registered("Pendulum-v1").validate({}, training, names)
    assert str(refusal.value).startswith(message)


def test_tasks_of_ours_are_trained_by_our_own_learner():
    with pytest.raises(BadSetting, match=r"training.trainer: expected halma, found the text 'sb3'"):
        PointJump().validate({}, {"trainer": "sb3"}, [])


def test_an_environment_that_gives_nan_has_diverged(tmp_path):
    outcome = run(
        job(task="tests.workers.test_run:Nan", training=TINY, params={}), LocalContext(tmp_path)
    )  # fmt: skip
    assert (outcome.status, outcome.message) == ("diverged", "iteration 1: reward became NaN")
