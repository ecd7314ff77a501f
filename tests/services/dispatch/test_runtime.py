"""One attempt in a worker process, with an artifact folder and a list in place of the wire."""

import json
from dataclasses import replace

import numpy as np
import pytest

from services.artifacts.open import open_artifacts
from services.dispatch.port import Assignment, Began, Crashed, Ended, Hindered, Reported, Stopped
from services.dispatch.runtime import Attempt, WorkerContext, decode_checkpoint, encode_checkpoint
from services.errors import StorageUnavailable
from services.store.port import NewArtifact
from workers.contracts import BadJob, Checkpoint, Cost, Interrupted, Job


@pytest.fixture
def artifacts(tmp_path):
    return open_artifacts(tmp_path / "artifacts")


def assignment(task, **more):
    job = Job(study="s", trial=3, task=task, params={"x": 0.5}, seed=7, **more)
    return Assignment(attempt=11, token=2, study_key="1-s", trial=3, job=job.to_json())


def outcome_of(artifacts, given, *, stop=False):
    sent = []
    attempt = Attempt(given, artifacts, sent.append)
    if stop:
        attempt.stop()
    attempt.run()
    assert isinstance(sent[0], Began)
    assert {(message.attempt, message.token) for message in sent} == {(11, 2)}
    return sent


@pytest.fixture
def module(tmp_path, monkeypatch):
    def write(name, text):
        (tmp_path / f"{name}.py").write_text(text)
        monkeypatch.syspath_prepend(str(tmp_path))
        return name

    return write


def test_a_job_that_ends_says_its_outcome_last(artifacts, module):
    name = module("hill_of_runtime", "def hill(params, z):\n    return 2 * params['x']\n")
    last = outcome_of(artifacts, assignment(f"{name}:hill"))[-1]
    assert isinstance(last, Ended)
    assert json.loads(last.outcome)["value"] == 1.0


def test_a_task_that_raises_is_told_with_its_users_traceback_alone(artifacts, module):
    text = """
import gymnasium

class Broken(gymnasium.Env):
    def __init__(self, x):
        raise OSError("no robot")
"""
    last = outcome_of(artifacts, assignment(f"{module('broken_of_runtime', text)}:Broken"))[-1]
    said = last.message if isinstance(last, Crashed) else json.loads(last.outcome)["message"]
    assert "no robot" in said
    assert "services/dispatch" not in said


def test_a_stop_ends_at_a_checkpoint_from_which_the_next_attempt_goes_on(artifacts):
    given = Assignment(
        attempt=11,
        token=2,
        study_key="1-s",
        trial=3,
        job=Job(
            study="s",
            trial=3,
            task="point_jump",
            params={"speed": 3.0, "spin": 1.0, "lean": 0.0},
            training={"budget": {"iterations": 3}},
            seed=7,
        ).to_json(),
    )
    first = outcome_of(artifacts, given, stop=True)
    assert isinstance(first[-1], Stopped)
    done = [message.iteration for message in first if isinstance(message, Reported)]
    second = outcome_of(artifacts, replace(given, iteration=done[-1]))
    assert isinstance(second[-1], Ended)
    assert done + [message.iteration for message in second if isinstance(message, Reported)] == [1, 2, 3]


def test_a_metric_that_is_no_number_is_left_out(artifacts):
    sent = []
    context = WorkerContext(assignment("point_jump"), artifacts, sent.append)
    context.report(1, {"kl": float("nan"), "return_mean": 1.0}, Cost(5, 0.1))
    assert sent[0].metrics == {"return_mean": 1.0}


def test_a_checkpoint_survives_storage_to_the_last_bit():
    checkpoint = Checkpoint(
        iteration=4,
        tensors={"w": np.array([0.1, -0.0, 1e-300]), "n": np.array([[1, 2]], np.int64)},
        state={"level": 0.1 + 0.2, "generator": [1, 2**63]},
    )
    again, reports = decode_checkpoint(encode_checkpoint(checkpoint))
    assert reports == []
    assert (again.iteration, again.state) == (4, checkpoint.state)
    for name, tensor in checkpoint.tensors.items():
        assert again.tensors[name].dtype == tensor.dtype
        assert again.tensors[name].tobytes() == tensor.tobytes()


def test_reports_that_reached_nobody_are_told_again_by_the_next_attempt(artifacts):
    deaf = WorkerContext(assignment("point_jump"), artifacts, lambda _: None)
    for iteration in (1, 2, 3):
        deaf.report(iteration, {"return_mean": iteration / 10}, Cost(iteration * 100, iteration / 7))
        deaf.save_checkpoint(Checkpoint(iteration, {"w": np.zeros(2)}, {}))
    sent = []
    given = replace(assignment("point_jump"), attempt=12, token=3, iteration=1)
    checkpoint = WorkerContext(given, artifacts, sent.append).load_checkpoint()
    assert checkpoint.iteration == 3
    assert sent == [
        Reported(12, 3, iteration=2, metrics={"return_mean": 0.2}, samples=200, seconds=2 / 7),
        Reported(12, 3, iteration=3, metrics={"return_mean": 0.3}, samples=300, seconds=3 / 7),
    ]


def test_a_parents_artifact_that_was_altered_is_refused(artifacts, tmp_path):
    kept = artifacts.put("1-s", 0, "policy.safetensors", b"weights")
    given = Assignment(11, 2, "1-s", 3, "{}", parent_artifacts=(kept,))
    context = WorkerContext(given, artifacts, lambda _: None)
    assert context.parent_artifact("policy.safetensors") == b"weights"
    (tmp_path / "artifacts" / kept.path).write_bytes(b"wEights")
    with pytest.raises(
        BadJob, match=r"its policy\.safetensors can't be used: artifact .*policy.*restore the file from a backup"
    ):
        context.parent_artifact("policy.safetensors")


def test_a_parent_that_left_no_such_artifact_is_named(artifacts):
    left = NewArtifact("log.txt", "1-s/0/log.txt", "0" * 64, 1)
    context = WorkerContext(Assignment(11, 2, "1-s", 3, "{}", parent_artifacts=(left,)), artifacts, lambda _: None)
    with pytest.raises(BadJob, match=r"to have left policy\.safetensors, found log\.txt"):
        context.parent_artifact("policy.safetensors")


class Full:
    """Storage that is full for a while."""

    def __init__(self, artifacts, times):
        self._artifacts = artifacts
        self.times = times

    def __getattr__(self, name):
        def call(*arguments):
            if self.times:
                self.times -= 1
                raise StorageUnavailable("No space left on device")
            return getattr(self._artifacts, name)(*arguments)

        return call


def test_a_full_disk_is_waited_for_and_told_once_it_is_over(artifacts, monkeypatch):
    monkeypatch.setattr("services.dispatch.runtime.FIRST_PAUSE", 0.001)
    sent = []
    context = WorkerContext(assignment("t"), Full(artifacts, 2), sent.append)
    context.save_artifact("policy", b"weights")
    assert sent == [
        Hindered(11, 2, "No space left on device"),
        Hindered(11, 2, "No space left on device"),
        Hindered(11, 2, ""),
    ]
    (kept,) = context.artifacts()
    assert artifacts.read(kept) == b"weights"


def test_an_attempt_that_waits_for_storage_stops_when_asked_to(artifacts):
    sent = []
    context = WorkerContext(assignment("t"), Full(artifacts, 10**9), sent.append)
    context.request_stop()
    with pytest.raises(Interrupted, match="No space left"):
        context.save_checkpoint(Checkpoint(1, {"w": np.zeros(2)}, {}))
    assert len(sent) == 1
