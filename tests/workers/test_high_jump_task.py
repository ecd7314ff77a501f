"""The task end to end, with trainings of a few seconds. In flight, action 0 clears 0.5 m, so every policy jumps."""

import hashlib
import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from workers.contracts import BadJob, BadSetting, Interrupted, Job
from workers.learning.policy import Policy
from workers.local_context import LocalContext
from workers.physics.limits import HUMAN
from workers.registry import load_task
from workers.replay import Replay
from workers.run import run
from workers.tasks.high_jump import HighJump, simulate, task
from workers.tasks.high_jump.env import HighJumpEnv

TRAINING = {
    "budget": {"iterations": 2},
    "network": {"hidden": [16]},
    "ppo": {"samples": 30, "environments": 2, "minibatch": 16, "epochs": 2, "sigma_start": 0.1},
}
SETTINGS = {"formulation": "flight", "first_bar": 0.45, "lowest_bar": 0.45, "highest_bar": 0.6, "bar_step": 0.05}
FLOP = {"alpha": 0.4, "omega_x": -3.0, "omega_z": 1.0, "v_z": -2.4}


def job(**changes):
    values = {"task_settings": SETTINGS, "training": TRAINING, "params": FLOP} | changes
    return Job("test", 3, "high_jump", seed=11, **values)


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    context = LocalContext(tmp_path_factory.mktemp("trial"))
    return run(job(), context), context.folder / "artifacts"


def test_a_trial_reports_the_highest_bar_of_an_audited_jump(trial):
    outcome, artifacts = trial
    assert outcome.status == "complete"
    details = outcome.details
    assert outcome.value == details["bar"] >= 0.45
    assert details["cleared"] is True
    assert details["audit"]["passed"] is True
    assert outcome.features == (details["facing"],)
    assert np.linalg.norm(details["rotation"]) == pytest.approx(1)
    replay = Replay.from_bytes((artifacts / "replay.bin").read_bytes())
    assert replay.header["bar"] == outcome.value
    assert outcome.cost.samples >= 60


def test_the_stored_policy_simulated_again_gives_the_stored_replay(trial):
    _, artifacts = trial
    policy = (artifacts / "policy.safetensors").read_bytes()
    stored = (artifacts / "replay.bin").read_bytes()
    assert simulate(job(), policy).to_bytes() == stored
    assert HighJump().simulate(job(), policy).to_bytes() == stored


def test_the_picture_shows_something(trial):
    _, artifacts = trial
    picture = np.asarray(Image.open(io.BytesIO((artifacts / "pose.png").read_bytes())))
    assert picture.shape == (360, 480, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50


def test_the_learner_reads_a_policy_that_knows_its_bar(trial):
    outcome, artifacts = trial
    policy = (artifacts / "policy.safetensors").read_bytes()
    assert task.bar_of(policy) == outcome.value
    assert Policy.from_bytes(policy).sha256() == outcome.details["policy_sha256"]


def test_the_same_job_gives_the_same_weights_even_when_interrupted(trial, tmp_path):
    outcome, artifacts = trial
    stopped = LocalContext(tmp_path, stop=lambda: True)
    with pytest.raises(Interrupted):
        run(job(), stopped)
    again = run(job(), LocalContext(tmp_path))
    assert again.details["policy_sha256"] == outcome.details["policy_sha256"]
    assert again.value == outcome.value
    for name in ("policy.safetensors", "replay.bin", "pose.png"):
        digests = {hashlib.sha256((f / name).read_bytes()).digest() for f in (artifacts, tmp_path / "artifacts")}
        assert len(digests) == 1, name


def test_the_rotation_can_be_the_feature(tmp_path):
    settings = SETTINGS | {"feature": "rotation"}
    outcome = run(job(task_settings=settings), LocalContext(tmp_path))
    assert list(outcome.features) == outcome.details["rotation"]
    spec = HighJump().info(settings).features
    assert (spec.kind, len(spec.names)) == ("rotation", 4)


def test_a_policy_that_clears_nothing_is_infeasible(tmp_path):
    settings = SETTINGS | {"formulation": "support", "rise": -2.0}
    outcome = run(job(task_settings=settings), LocalContext(tmp_path))
    assert outcome.status == "infeasible"
    assert outcome.value is None
    assert outcome.features is None
    assert outcome.message == "the policy clears no bar of 0.45 m or more"
    assert outcome.details["cleared"] is False
    stored = (tmp_path / "artifacts" / "policy.safetensors").read_bytes()
    with pytest.raises(BadJob, match="expected one of a trial that cleared a bar"):
        simulate(job(task_settings=settings), stored)


def test_a_jump_that_the_audit_refuses_counts_for_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("workers.audit.HUMAN", replace(HUMAN, push=-1.0))
    outcome = run(job(), LocalContext(tmp_path))
    assert outcome.status == "infeasible"
    assert "the audit refused every jump" in outcome.message
    assert "foot_push" in outcome.message
    assert outcome.details["audit"]["passed"] is False


def test_nan_ends_the_trial_as_diverged_with_its_iteration(tmp_path, monkeypatch):
    honest = HighJumpEnv._observation
    calls = iter(range(10_000))

    def sick(self):
        return honest(self) * (np.nan if next(calls) > 80 else 1.0)

    monkeypatch.setattr(HighJumpEnv, "_observation", sick)
    outcome = run(job(training=TRAINING | {"budget": {"iterations": 20}}), LocalContext(tmp_path))
    assert outcome.status == "diverged"
    assert outcome.message.startswith("iteration ")
    assert "observation became NaN" in outcome.message


def test_a_policy_of_another_task_is_refused(trial):
    _, artifacts = trial
    with pytest.raises(BadJob, match=r"policy\.safetensors"):
        simulate(job(), (artifacts / "replay.bin").read_bytes())


def test_the_registry_knows_the_task():
    info = load_task("high_jump").info({})
    assert info.name == "high_jump"
    assert set(info.parameters) == {"alpha", "omega_x", "omega_z", "v_z"}
    assert info.features.names == ("facing",)
    assert info.settings["formulation"] == "support"
    assert info.training["budget"]["samples"] > 0


@pytest.mark.parametrize(
    ("settings", "training", "names", "section", "field", "message"),
    [
        ({"formulatoin": "flight"}, {}, (), "task.settings", "formulatoin", "did you mean 'formulation'?"),
        (
            {"formulation": "swim"}, {}, (), "task.settings", "formulation",
            "expected support or flight, found the text 'swim'",
        ),
        ({"feature": "speed"}, {}, (), "task.settings", "feature", "expected facing or rotation"),
        ({"first_bar": "high"}, {}, (), "task.settings", "first_bar", "expected a number from 0.1 to 2.5"),
        (
            {"control_rate": 7}, {}, (), "task.settings", "control_rate",
            "expected a divisor of 120 (the frames of a second), found 7",
        ),
        (
            {"lowest_bar": 0.9, "highest_bar": 0.5}, {}, (), "task.settings", "highest_bar",
            "expected at least lowest_bar, which is 0.9, found 0.5",
        ),
        (
            {"first_bar": 1.0, "highest_bar": 0.5}, {}, (), "task.settings", "highest_bar",
            "expected at least first_bar, which is 1, found 0.5",
        ),
        ({}, {"ppo": {"clip": 0}}, (), "training", "ppo.clip", "found 0"),
        ({}, {}, ("alpha", "omega_q"), "space", "omega_q", "did you mean 'omega_"),
    ],
)  # fmt: skip
def test_bad_settings_say_where_and_what(settings, training, names, section, field, message):
    with pytest.raises(BadSetting) as caught:
        HighJump().validate(settings, training, names)
    assert (caught.value.section, caught.value.field) == (section, field)
    assert message in caught.value.message


def test_bars_are_tried_from_above_the_level_downwards():
    problem = task.problem_of(
        job(task_settings={"first_bar": 0.2, "lowest_bar": 0.3, "bar_step": 0.05, "highest_bar": 0.6})
    )
    assert problem.levels_from(0.1) == [0.5, 0.45, 0.4, 0.35, 0.3]
    assert problem.levels_from(0.55) == [0.6, 0.55, 0.5, 0.45, 0.4, 0.35, 0.3]


def test_a_stored_policy_is_judged_with_its_success_rate(trial):
    outcome, artifacts = trial
    policy = (artifacts / "policy.safetensors").read_bytes()
    judged = HighJump().audit(job(), policy, 4)
    checks = judged.to_json()["checks"]
    assert judged.passed
    assert {**checks, "deterministic_failure": 0, "stochastic_success": 0}.keys() == checks.keys()
    assert checks["foot_push"] == outcome.details["audit"]["checks"]["foot_push"]
    assert checks["deterministic_failure"]["found"] == 0
    assert checks["stochastic_success"]["found"] in {0, 0.25, 0.5, 0.75, 1.0}
    assert checks["stochastic_success"]["bound"] is None
    assert HighJump().audit(job(), policy, 4).to_json() == judged.to_json()
    assert "stochastic_success" not in HighJump().audit(job(), policy, 0).to_json()["checks"]


def test_a_policy_that_misses_its_bar_fails_the_audit(trial):
    _, artifacts = trial
    policy = task.with_bar((artifacts / "policy.safetensors").read_bytes(), 2.4)
    judged = HighJump().audit(job(), policy, 2)
    assert judged.failures == ("deterministic_failure",)
    assert judged.to_json()["checks"]["stochastic_success"]["found"] == 0
