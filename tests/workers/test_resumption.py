"""A training is a function of its job, whatever interrupts it, and in whatever process it goes on."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.workers.toy_environments import Choice, Target, ToyProblem, job, settings
from workers.contracts import BadJob, Cost, Interrupted, Outcome
from workers.learning.ppo import POLICY_ARTIFACT, train
from workers.local_context import LocalContext
from workers.run import run

SUBJECT = job(
    params={"speed": 1.7, "spin": 1.0, "lean": 0.5},
    training={"budget": {"iterations": 6}, "ppo": {"sigma": "learnt", "normalise_rewards": True}},
)
CONTINUE = """
import sys
from pathlib import Path
from workers.contracts import Job
from workers.local_context import LocalContext
from workers.run import run

print(run(Job.from_json(sys.argv[1]), LocalContext(Path(sys.argv[2]))).to_json())
"""


def continued_in_a_new_process(folder):
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-c", CONTINUE, SUBJECT.to_json(), str(folder)]
    return Outcome.from_json(subprocess.run(command, env=environment, capture_output=True, check=True).stdout)


def test_a_training_interrupted_and_continued_in_a_new_process_is_bit_for_bit_the_uninterrupted_one(tmp_path):
    whole = run(SUBJECT, LocalContext(tmp_path / "whole"))
    context = LocalContext(tmp_path / "parts", stop=lambda: len(context.reports()) == 2)
    with pytest.raises(Interrupted, match="stopped at the checkpoint of iteration 2"):
        run(SUBJECT, context)
    parts = continued_in_a_new_process(tmp_path / "parts")
    clockless = {"cost": Cost(whole.cost.samples)}
    assert dataclasses.replace(parts, **clockless) == dataclasses.replace(whole, **clockless)
    policies = [LocalContext(tmp_path / name).artifact(POLICY_ARTIFACT) for name in ("whole", "parts")]
    assert policies[0] == policies[1]
    curves = [LocalContext(tmp_path / name).reports() for name in ("whole", "parts")]
    for report in curves[0] + curves[1]:
        del report["seconds"], report["metrics"]["samples_per_second"]
    assert curves[0] == curves[1]
    assert len(curves[0]) == 6


@pytest.mark.parametrize("make", [Target, Choice])
@pytest.mark.parametrize("k", [1, 2, 3])
def test_wherever_it_is_interrupted_the_weights_are_the_same(tmp_path, make, k):
    # Twenty environments are more than an iteration has room for: how many play depends on the last one's episodes.
    options = {"iterations": 4, "environments": 20, "normalise_rewards": True}
    problem = ToyProblem(make, {"start": 0.1, "step": 0.1} if make is Target else None)
    whole = train(job(), LocalContext(tmp_path / "whole"), problem, settings(**options))
    context = LocalContext(tmp_path / "parts", stop=lambda: len(context.reports()) == k)
    with pytest.raises(Interrupted):
        train(job(), context, problem, settings(**options))
    resumed = train(job(), LocalContext(tmp_path / "parts"), problem, settings(**options))
    assert resumed.policy.sha256() == whole.policy.sha256()
    assert resumed.level == whole.level
    assert resumed.cost.samples == whole.cost.samples


def test_the_same_job_twice_gives_the_same_weights_and_another_seed_others(tmp_path):
    hashes = [
        train(job(seed=seed), LocalContext(tmp_path / str(i)), ToyProblem(), settings(2)).policy.sha256()
        for i, seed in enumerate([7, 7, 8])
    ]
    assert hashes[0] == hashes[1] != hashes[2]


def test_a_torn_checkpoint_costs_one_iteration_and_no_more(tmp_path):
    whole = train(job(), LocalContext(tmp_path / "whole"), ToyProblem(), settings(4))
    context = LocalContext(tmp_path / "torn", stop=lambda: len(context.reports()) == 3)
    with pytest.raises(Interrupted):
        train(job(), context, ToyProblem(), settings(4))
    newest = max((tmp_path / "torn" / "checkpoints").iterdir())
    newest.write_bytes(newest.read_bytes()[:-100])
    context = LocalContext(tmp_path / "torn")
    resumed = train(job(), context, ToyProblem(), settings(4))
    assert [r["iteration"] for r in context.reports()] == [1, 2, 3, 3, 4]
    assert resumed.policy.sha256() == whole.policy.sha256()


def test_a_finished_training_run_again_does_nothing_and_gives_the_same(tmp_path):
    first = train(job(), LocalContext(tmp_path), ToyProblem(), settings(2))
    again = train(job(), LocalContext(tmp_path), ToyProblem(), settings(2))
    assert again.policy.sha256() == first.policy.sha256()
    assert again.cost == first.cost
    assert again.metrics == first.metrics


def test_a_training_with_a_larger_budget_goes_on_from_where_it_ended(tmp_path):
    whole = train(job(), LocalContext(tmp_path / "whole"), ToyProblem(), settings(4))
    train(job(), LocalContext(tmp_path / "more"), ToyProblem(), settings(2))
    assert (
        train(job(), LocalContext(tmp_path / "more"), ToyProblem(), settings(4)).policy.sha256()
        == whole.policy.sha256()
    )


class TestWarmStart:
    @pytest.fixture
    def parent(self, tmp_path):
        context = LocalContext(tmp_path / "parent")
        trained = train(job(), context, ToyProblem(), settings(3))
        context.save_artifact(POLICY_ARTIFACT, trained.policy.to_bytes())
        return trained.policy

    def child(self, tmp_path, problem=None, **options):
        context = LocalContext(tmp_path / "child", parent=tmp_path / "parent")
        return train(job(trial=1, parent=0), context, problem or ToyProblem(), settings(1, **options)), context

    def test_it_begins_with_the_parents_networks_and_statistics(self, tmp_path, parent):
        tiny = 1e-12
        trained, context = self.child(tmp_path, actor_rate=tiny, critic_rate=tiny, normaliser_iterations=0)
        assert trained.policy.normaliser.count == parent.normaliser.count
        for mine, theirs in zip(
            trained.policy.actor + trained.policy.critic, parent.actor + parent.critic, strict=True
        ):
            np.testing.assert_allclose(mine[0], theirs[0], atol=1e-7)
        assert (context.folder / "log.txt").read_text() == "trial 0: started from the parent's policy\n"

    def test_it_pays_for_no_warm_up(self, tmp_path, parent):
        assert self.child(tmp_path)[0].cost.samples == 48

    def test_it_tells_its_lineage_also_after_it_was_resumed(self, tmp_path, parent):
        told = {"warm_start": {"parent": 0, "networks": True, "message": "started from the parent's policy"}}
        assert self.child(tmp_path)[0].lineage == told
        assert self.child(tmp_path)[0].lineage == told  # again from its checkpoint, which is its last

    def test_a_training_from_scratch_has_no_lineage(self, tmp_path):
        assert train(job(), LocalContext(tmp_path), ToyProblem(), settings(1)).lineage == {}

    def test_with_other_hidden_layers_it_keeps_the_statistics_and_says_so(self, tmp_path, parent):
        trained, context = self.child(tmp_path, network={"hidden": [5]}, normaliser_iterations=0)
        assert trained.policy.normaliser.count == parent.normaliser.count
        assert trained.policy.hidden == (5,)
        assert trained.lineage["warm_start"]["networks"] is False
        assert "started from new networks" in (context.folder / "log.txt").read_text()

    def test_a_parent_with_other_actions_is_refused(self, tmp_path, parent):
        message = "expected a policy of 2 observations and discrete actions of size 2, found 2, continuous, 1"
        with pytest.raises(BadJob, match=message):
            self.child(tmp_path, ToyProblem(Choice))

    def test_a_parent_without_a_policy_is_refused(self, tmp_path):
        (tmp_path / "parent").mkdir()
        with pytest.raises(BadJob, match=r"parent: expected its policy\.safetensors, found none"):
            self.child(tmp_path)

    def test_a_resumed_child_needs_its_parent_no_more(self, tmp_path, parent):
        self.child(tmp_path)
        (tmp_path / "parent" / "artifacts" / POLICY_ARTIFACT).unlink()
        context = LocalContext(tmp_path / "child", parent=tmp_path / "parent")
        assert train(job(trial=1, parent=0), context, ToyProblem(), settings(2)).iterations == 2
