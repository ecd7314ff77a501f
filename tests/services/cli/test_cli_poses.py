"""`halma poses train`."""

from __future__ import annotations

import pybullet_data
import pytest

from workers.poses import training
from workers.poses.model import PoseModel

MOTIONS = f"{pybullet_data.getDataPath()}/data/motions"


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(training.train, "__kwdefaults__", {**training.train.__kwdefaults__, "epochs": 1})


def test_a_model_is_trained_on_named_clips(shell):
    told = shell("poses", "train", f"{MOTIONS}/humanoid3d_cartwheel.txt", "--out", "m.safetensors", "--json")
    assert told.code == 0, told.err
    model = PoseModel.read(shell.folder / "m.safetensors")
    assert told.json["latent"] == model.latent
    assert told.json["sha256"] == model.sha256()
    assert told.json["clips"] == 1


def test_without_clips_the_packaged_ones_are_learnt(shell):
    told = shell("poses", "train", "--out", "m.safetensors")
    assert told.code == 0, told.err
    assert "13 latent dimensions" in told.out
    assert (shell.folder / "m.safetensors").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("nowhere.txt", "--out", "m"),
            "CLIPS: expected a motion clip or a folder of them, found nothing at nowhere.txt",
        ),
        (("empty", "--out", "m"), "CLIPS: expected clips (.txt, .json, .bvh) in empty, found none"),
        (("bad.txt", "--out", "m"), "bad.txt: expected a motion clip"),
        (("--out", "no/such/m"), "--out: expected a file in a folder that exists"),
    ],
)
def test_bad_input_is_told_and_nothing_is_left(shell, arguments, message):
    (shell.folder / "empty").mkdir()
    shell.write("bad.txt", "no clip")
    told = shell("poses", "train", *arguments)
    assert told.code == 2
    assert message in told.err
    assert not (shell.folder / "m").exists()
