"""What is removed and what stays, told by the trial database; on a folder and on an S3 server."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from services.artifacts.names import study_key
from services.artifacts.objects import ObjectArtifacts
from services.artifacts.open import open_artifacts
from services.artifacts.root import settle
from services.errors import ArtifactsMoved, BadInput
from services.garbage import Fate, collect
from services.states import StudyState, TrialState
from services.store.open import open_store
from services.store.port import Driver, NewTrial, Result
from services.verifying import verify

SPEC = {"name": "s", "task": "t", "search": {"strategy": "random", "trials": 9}}
LATER = 7200.0


class World:
    """A database with a driven study of three trials: 0 has ended, 1 runs, 2 waits; and their files."""

    def __init__(self, tmp_path, root):
        self.store = open_store(tmp_path / "halma.db")
        self.files = open_artifacts(root)
        settle(self.store, self.files)
        self.id, self.token = self.study("s")
        with self.store.transaction() as change:
            trials = change.propose(
                self.id, self.token, strategy="random", history=0, pending=[], rng_key=[1], seconds=0.0,
                trials=[NewTrial({}, seed=i) for i in range(3)],
            )  # fmt: skip
            ended, self.running = (change.start(trial.id, self.token, worker="w") for trial in trials[:2])
        self.key = study_key(self.id, "s")
        self.policy = self.put(0, "policy.safetensors", b"weights")
        with self.store.transaction() as change:
            result = Result(TrialState.COMPLETE, value=1.0, artifacts=[self.policy])
            change.finish(ended.id, ended.token, result)
        self.late = self.put(0, "policy.safetensors", b"other weights")
        self.checkpoints = [self.files.put_checkpoint(self.key, trial, 1, b"state") for trial in range(3)]
        self.early = self.put(1, "policy.safetensors", b"to be recorded")

    def study(self, name, **spec):
        with self.store.transaction() as change:
            made = change.create_study(name, {**SPEC, "name": name, **spec}, seed=1)
            return made.id, change.drive(name, Driver("me", "here", 1))

    def put(self, trial, name, data):
        return self.files.put(self.key, trial, name, data)

    def collect(self, later=LATER, **options):
        return collect(self.store, self.files, clock=lambda: time.time() + later, **options)


@pytest.fixture(params=["folder", "s3"])
def world(request, tmp_path):
    root = request.getfixturevalue("s3_root") if request.param == "s3" else tmp_path / "artifacts"
    made = World(tmp_path, root)
    yield made
    made.store.close()


def test_what_no_row_names_goes_and_what_a_living_trial_writes_stays(world):
    collected = world.collect()
    stays = {world.policy.path, *world.checkpoints[1:], world.early.path}
    assert set(world.files.paths()) == stays
    assert collected.removed == (2, len(b"state") + len(b"other weights"))
    assert {fate: count for fate, count in collected.files.items() if count} == {
        Fate.CHECKPOINT: 1,
        Fate.UNNAMED: 1,
        Fate.NAMED: 1,
        Fate.OPEN: 3,
    }


def test_the_running_trial_ends_well_after_a_collection(world):
    world.collect()
    with world.store.transaction() as change:
        result = Result(TrialState.COMPLETE, value=2.0, artifacts=[world.early])
        change.finish(world.running.id, world.running.token, result)
    world.collect()
    verified = verify(world.store, world.files, world.store.studies())
    assert (verified.files, verified.mismatches) == (2, [])


def test_a_dry_run_counts_the_same_and_removes_nothing(world):
    before = set(world.files.paths())
    looked = world.collect(dry_run=True)
    assert set(world.files.paths()) == before
    assert world.collect() == looked


def test_what_is_young_stays_and_so_does_what_comes_from_the_future(world):
    before = set(world.files.paths())
    for later in (60.0, -LATER):
        collected = world.collect(later=later)
        assert collected.files[Fate.YOUNG] == 2
        assert collected.removed == (0, 0)
    assert set(world.files.paths()) == before
    assert world.collect(later=60.0, least_age=30.0).removed[0] == 2


def test_a_study_that_keeps_its_checkpoints_keeps_them(world):
    kept, token = world.study("t", keep_checkpoints=True)
    with world.store.transaction() as change:
        (trial,) = change.propose(
            kept, token, strategy="random", history=0, pending=[], rng_key=[1], seconds=0.0, trials=[NewTrial({}, 1)]
        )
        change.cancel_trial(trial.id, token, "enough")
    path = world.files.put_checkpoint(study_key(kept, "t"), 0, 1, b"state")
    assert world.collect().files[Fate.KEPT] == 1
    assert path in set(world.files.paths())


def test_what_a_deleted_study_left_goes(world):
    with world.store.transaction() as change:
        change.preempt(world.running.id, world.running.token, "over")
        change.release_drive(world.id, world.token, StudyState.CANCELLED)
        change.delete_study("s")
    collected = world.collect()
    assert collected.files[Fate.DELETED] == 6
    assert list(world.files.paths()) == []


def test_files_that_halma_has_not_made_are_never_touched(world):
    others = [
        "README.md", f"{world.key}/notes.txt", f"{world.key}/000000/notes.txt", f"{world.key}/000009/a-{'0' * 16}.txt",
        f"{world.key}/000000/checkpoints/00000009-notes.txt", f"99-gone/000000/a-{'0' * 16}.txt",
        f"{world.id}-other/000000/a-{'0' * 16}.txt",
    ]  # fmt: skip
    for path in others:
        world.files._write(path, b"mine")
    collected = world.collect()
    assert collected.files[Fate.FOREIGN] == len(others)
    assert set(others) <= set(world.files.paths())


def test_a_torn_checkpoint_and_an_unfinished_file_of_an_ended_trial_go(world):
    torn = world.checkpoints[0] + ".torn"
    unfinished = f"{world.key}/000000/.writing-0123"
    for path in (torn, unfinished):
        if isinstance(world.files, ObjectArtifacts):
            world.files._files.pipe_file(f"{world.files.url}/{path}", b"half")
        else:
            Path(world.files.url, path).write_bytes(b"half")
    assert world.collect().files[Fate.UNNAMED] == 3
    assert {torn, unfinished}.isdisjoint(world.files.paths())


def test_the_files_of_another_database_are_left_alone(world, tmp_path):
    other = open_store(tmp_path / "other.db")
    with pytest.raises(BadInput, match="found those of another one"):
        collect(other, world.files, clock=lambda: time.time() + LATER)
    with pytest.raises(BadInput, match="found those of another one"):
        settle(other, world.files)
    other.close()
    with pytest.raises(ArtifactsMoved):
        collect(world.store, open_artifacts(tmp_path / "elsewhere"))


def test_a_missing_and_an_altered_file_are_told_and_the_others_counted(world):
    with world.store.transaction() as change:
        result = Result(TrialState.COMPLETE, value=2.0, artifacts=[world.early])
        change.finish(world.running.id, world.running.token, result)
    told = []
    assert verify(world.store, world.files, world.store.studies(), told.append).files == 2
    world.files.remove(world.policy.path)
    world.files._write(world.early.path, b"to be recorbed")
    verified = verify(world.store, world.files, world.store.studies(), told.append)
    assert (verified.files, verified.mismatches) == (0, told)
    missing, altered = told
    assert (missing.study, missing.trial, missing.artifact.name) == ("s", 0, "policy.safetensors")
    assert "found no file" in missing.found
    assert altered.trial == 1
    assert f"with SHA-256 {world.early.sha256}, found 14 bytes with" in altered.found
