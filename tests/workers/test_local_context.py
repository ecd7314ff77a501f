import numpy as np
import pytest

from workers.contracts import BadJob, Checkpoint, Cost
from workers.local_context import LocalContext


def checkpoint(k):
    return Checkpoint(k, {"a.b": np.arange(3.0) * k, "n": np.array(7)}, {"seed": 2**100, "level": 0.1 * k})


def test_a_checkpoint_read_back_is_the_one_written(tmp_path):
    LocalContext(tmp_path).save_checkpoint(checkpoint(3))
    found = LocalContext(tmp_path).load_checkpoint()
    assert (found.iteration, found.state) == (3, checkpoint(3).state)
    assert {name: value.tolist() for name, value in found.tensors.items()} == {"a.b": [0.0, 3.0, 6.0], "n": 7}


def test_the_newest_checkpoint_is_found_and_the_one_before_it_kept(tmp_path):
    context = LocalContext(tmp_path)
    assert context.load_checkpoint() is None
    for k in (1, 2, 3, 11):
        context.save_checkpoint(checkpoint(k))
    assert context.load_checkpoint().iteration == 11
    assert [p.name for p in sorted((tmp_path / "checkpoints").iterdir())] == [
        "00000003.safetensors",
        "00000011.safetensors",
    ]


@pytest.mark.parametrize("damage", [lambda data: data[:-1], lambda data: b"", lambda data: b"\xff" * len(data)])
def test_a_torn_checkpoint_is_set_aside_and_the_one_before_it_used(tmp_path, damage):
    context = LocalContext(tmp_path)
    for k in (1, 2):
        context.save_checkpoint(checkpoint(k))
    newest = tmp_path / "checkpoints" / "00000002.safetensors"
    newest.write_bytes(damage(newest.read_bytes()))
    assert context.load_checkpoint().iteration == 1
    assert newest.with_suffix(".torn").exists()
    assert (tmp_path / "log.txt").read_text() == "set aside a torn checkpoint: 00000002.safetensors\n"


def test_artifacts_are_kept_replaced_and_handed_to_children(tmp_path):
    parent = LocalContext(tmp_path / "parent")
    parent.save_artifact("policy.safetensors", b"one")
    parent.save_artifact("policy.safetensors", b"two")
    assert parent.artifact("policy.safetensors") == b"two"
    child = LocalContext(tmp_path / "child", parent=tmp_path / "parent")
    assert child.parent_artifact("policy.safetensors") == b"two"
    with pytest.raises(BadJob, match=r"parent: expected its replay.bin, found none"):
        child.parent_artifact("replay.bin")
    with pytest.raises(BadJob, match=r"parent: expected its policy.safetensors, but this context was given no parent"):
        parent.parent_artifact("policy.safetensors")


@pytest.mark.parametrize("name", ["../policy", "a/b", "/etc/passwd"])
def test_an_artifact_stays_in_its_folder(tmp_path, name):
    with pytest.raises(BadJob, match="artifact: expected a plain file name"):
        LocalContext(tmp_path).save_artifact(name, b"")


def test_reports_are_kept_in_order(tmp_path):
    context = LocalContext(tmp_path)
    assert context.reports() == []
    context.report(1, {"kl": 0.1}, Cost(10, 0.5))
    context.report(2, {"kl": 0.2}, Cost(20, 1.5))
    assert LocalContext(tmp_path).reports() == [
        {"iteration": 1, "samples": 10, "seconds": 0.5, "metrics": {"kl": 0.1}},
        {"iteration": 2, "samples": 20, "seconds": 1.5, "metrics": {"kl": 0.2}},
    ]
