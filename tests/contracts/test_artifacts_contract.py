"""What every artifact store has to do, on a folder and on object storage (an S3 server, fsspec's memory)."""

from __future__ import annotations

import hashlib
import os
import time
import uuid
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import ray
from hypothesis import given
from hypothesis import strategies as st

from services.artifacts.folder import FolderArtifacts
from services.artifacts.names import study_key
from services.artifacts.objects import ObjectArtifacts
from services.artifacts.open import open_artifacts
from services.dispatch.relay import KeeperActor, RelayedArtifacts, artifacts_here
from services.errors import ArtifactDamaged, BadInput, StorageUnavailable

KEY = "1-jump"
POLICY = b"weights" * 100


class Wire:
    """An actor handle whose calls are made at once: what Ray does, without Ray."""

    def __init__(self, actor):
        self._actor = actor

    def __getattr__(self, name):
        def remote(*arguments):
            try:
                return getattr(self._actor, name)(*arguments), None
            except Exception as error:  # noqa: BLE001 - whatever the actor raises crosses the wire
                return None, error

        return SimpleNamespace(remote=remote)


def answer(reference):
    found, error = reference
    if error is not None:
        raise ray.exceptions.RayTaskError("call", "traceback", error).as_instanceof_cause()
    return found


@pytest.fixture(params=["folder", "memory", "s3", "relayed"])
def files(request, tmp_path, monkeypatch):
    if request.param == "memory":
        return open_artifacts(f"memory://{uuid.uuid4().hex}/artifacts")
    if request.param == "s3":
        return open_artifacts(request.getfixturevalue("s3_root"))
    root = str(tmp_path / "artifacts")
    if request.param == "folder":
        return open_artifacts(root)
    monkeypatch.setattr("services.dispatch.relay.ray.get", answer)
    return RelayedArtifacts(Wire(KeeperActor(root)), root)


def overwrite(files, path, data):
    """What a bad disk, or somebody with an editor, does."""
    if not isinstance(files, ObjectArtifacts):
        Path(files.url, path).write_bytes(data)
    else:
        files._files.pipe_file(f"{files.url}/{path}", data)


def test_each_kind_of_place_has_its_adapter(tmp_path):
    assert isinstance(open_artifacts(tmp_path), FolderArtifacts)
    assert isinstance(open_artifacts(str(tmp_path)), FolderArtifacts)
    assert open_artifacts(f"file://{tmp_path}").url == str(tmp_path)
    assert isinstance(open_artifacts("memory://x"), ObjectArtifacts)


def test_a_study_key_is_one_folder_name_whatever_the_study_is_called():
    assert study_key(7, "high_jump-2.0") == "7-high_jump-2.0"
    assert study_key(7, "../a b/ü") == "7-.._a_b_"


class TestArtifacts:
    def test_what_was_put_can_be_read(self, files):
        kept = files.put(KEY, 3, "policy.safetensors", POLICY)
        digest = hashlib.sha256(POLICY).hexdigest()
        assert kept.name == "policy.safetensors"
        assert kept.path == f"1-jump/000003/policy-{digest[:16]}.safetensors"
        assert (kept.sha256, kept.size) == (digest, 700)
        assert files.read(kept) == POLICY
        assert list(files.paths()) == [kept.path]

    def test_the_same_bytes_twice_are_one_file(self, files):
        assert files.put(KEY, 3, "a", b"x") == files.put(KEY, 3, "a", b"x")
        assert len(list(files.paths())) == 1

    def test_a_worker_back_from_the_dead_does_not_overwrite_its_successor(self, files):
        kept = files.put(KEY, 3, "policy.safetensors", POLICY)
        late = files.put(KEY, 3, "policy.safetensors", b"other weights")
        assert files.read(kept) == POLICY
        assert late.path != kept.path

    def test_an_empty_artifact_is_one(self, files):
        assert files.read(files.put(KEY, 0, "log.txt", b"")) == b""

    @pytest.mark.parametrize("found", [POLICY[:-1], b"", POLICY.replace(b"w", b"v", 1)])
    def test_an_altered_artifact_is_told_with_path_and_both_hashes(self, files, found):
        kept = files.put(KEY, 3, "policy.safetensors", POLICY)
        overwrite(files, kept.path, found)
        with pytest.raises(ArtifactDamaged) as error:
            files.read(kept)
        message = str(error.value)
        assert kept.path in message
        assert f"expected 700 bytes with SHA-256 {kept.sha256}" in message
        assert f"found {len(found)} bytes with {hashlib.sha256(found).hexdigest()}" in message

    def test_a_missing_artifact_is_told_with_what_to_do(self, files):
        kept = files.put(KEY, 3, "policy.safetensors", POLICY)
        files.remove(kept.path)
        with pytest.raises(ArtifactDamaged, match="found no file; if the artifacts have moved, name their new place"):
            files.read(kept)

    def test_removing_twice_is_fine(self, files):
        kept = files.put(KEY, 3, "a", b"x")
        files.remove(kept.path)
        files.remove(kept.path)
        assert list(files.paths()) == []

    @pytest.mark.parametrize("name", ["../a", "/etc/passwd", "a/../../b", "a/b", "", ".", "..", "a\\b", "c:x", "a\0b"])
    def test_a_name_that_would_leave_the_folder_is_refused(self, files, name):
        with pytest.raises(BadInput, match="expected"):
            files.put(KEY, 3, name, b"x")
        with pytest.raises(BadInput, match="expected"):
            files.put(name, 3, "a", b"x")
        assert list(files.paths()) == []

    @pytest.mark.parametrize("path", ["../secret", "/secret", "1-jump/../../secret", "1-jump//a", ""])
    def test_a_recorded_path_that_leaves_the_root_is_refused(self, files, path):
        kept = replace(files.put(KEY, 3, "a", b"x"), path=path)
        with pytest.raises(BadInput, match=r"artifact path .*can't leave its folder"):
            files.read(kept)
        with pytest.raises(BadInput, match="artifact path"):
            files.remove(path)


class TestCheckpoints:
    def test_there_is_none_at_first(self, files):
        assert files.newest_checkpoint(KEY, 3) is None

    def test_the_newest_is_found_and_the_last_two_are_kept(self, files):
        for iteration in (8, 9, 10, 11):
            files.put_checkpoint(KEY, 3, iteration, b"state %d" % iteration)
        assert files.newest_checkpoint(KEY, 3) == (11, b"state 11")
        assert sorted(path.split("/")[-1][:8] for path in files.paths()) == ["00000010", "00000011"]

    def test_trials_keep_their_own(self, files):
        files.put_checkpoint(KEY, 3, 1, b"three")
        files.put_checkpoint(KEY, 4, 2, b"four")
        files.put_checkpoint("2-other", 3, 9, b"other")
        assert files.newest_checkpoint(KEY, 3) == (1, b"three")
        assert files.newest_checkpoint(KEY, 4) == (2, b"four")

    @pytest.mark.parametrize("torn", [b"", b"state", b"state!2"])
    def test_a_torn_one_is_set_aside_and_the_one_before_it_used(self, files, torn):
        files.put_checkpoint(KEY, 3, 1, b"state 1")
        newest = files.put_checkpoint(KEY, 3, 2, b"state 2")
        overwrite(files, newest, torn)
        assert files.newest_checkpoint(KEY, 3) == (1, b"state 1")
        assert newest not in list(files.paths())
        assert newest + ".torn" in list(files.paths())
        assert files.newest_checkpoint(KEY, 3) == (1, b"state 1")

    def test_where_all_are_torn_there_is_none(self, files):
        for iteration in (1, 2):
            overwrite(files, files.put_checkpoint(KEY, 3, iteration, b"state"), b"torn")
        assert files.newest_checkpoint(KEY, 3) is None

    def test_one_set_aside_makes_room_for_the_repeated_iteration(self, files):
        files.put_checkpoint(KEY, 3, 1, b"state 1")
        overwrite(files, files.put_checkpoint(KEY, 3, 2, b"state 2"), b"torn")
        files.newest_checkpoint(KEY, 3)
        files.put_checkpoint(KEY, 3, 2, b"state 2")
        assert files.newest_checkpoint(KEY, 3) == (2, b"state 2")

    def test_other_files_among_them_are_let_be(self, files):
        path = files.put_checkpoint(KEY, 3, 1, b"state 1")
        overwrite(files, path.rsplit("/", 1)[0] + "/00000009-notes.txt", b"mine")
        assert files.newest_checkpoint(KEY, 3) == (1, b"state 1")

    def test_dropping_removes_them_and_leaves_artifacts(self, files):
        kept = files.put(KEY, 3, "policy.safetensors", POLICY)
        files.put_checkpoint(KEY, 3, 1, b"state 1")
        overwrite(files, files.put_checkpoint(KEY, 3, 2, b"state 2"), b"torn")
        files.newest_checkpoint(KEY, 3)
        files.drop_checkpoints(KEY, 3)
        assert list(files.paths()) == [kept.path]

    def test_an_artifact_named_like_the_checkpoints_folder_is_no_checkpoint(self, files):
        kept = files.put(KEY, 3, "checkpoints", b"mine")
        files.put_checkpoint(KEY, 3, 1, b"state 1")
        files.drop_checkpoints(KEY, 3)
        assert files.read(kept) == b"mine"


class TestIdentity:
    def test_a_root_without_a_mark_has_none(self, files):
        assert files.identity() == ""

    def test_a_root_keeps_the_identity_it_was_given_and_does_not_list_it(self, files):
        identity = files.mark()
        assert identity
        assert files.mark() == files.identity() == identity
        assert list(files.paths()) == []

    def test_a_root_is_told_whose_it_is(self, files):
        identity = files.mark()
        assert files.owner() == ""
        assert files.mark(owner="history 1") == identity
        assert (files.identity(), files.owner()) == (identity, "history 1")
        assert files.mark("another") == "another"
        assert (files.identity(), files.owner()) == ("another", "history 1")

    def test_two_roots_differ(self, files, tmp_path):
        assert files.mark() != open_artifacts(tmp_path / "other").mark()

    def test_a_worker_that_sees_the_same_root_writes_there_itself(self, tmp_path):
        identity = open_artifacts(tmp_path / "a").mark()
        (tmp_path / "mounted-elsewhere").symlink_to(tmp_path / "a")
        here = artifacts_here(str(tmp_path / "mounted-elsewhere"), identity, keeper=object())
        assert isinstance(here, FolderArtifacts)

    def test_a_worker_that_sees_another_root_or_none_sends_its_files_to_the_head(self, tmp_path):
        identity = open_artifacts(tmp_path / "a").mark()
        open_artifacts(tmp_path / "b").mark()
        for root in ("b", "nothing"):
            assert isinstance(artifacts_here(str(tmp_path / root), identity, keeper=object()), RelayedArtifacts)
        assert isinstance(artifacts_here(str(tmp_path / "b"), identity, keeper=None), FolderArtifacts)


class TestListing:
    def test_every_file_is_listed_with_its_size_and_when_it_was_written(self, files):
        before = time.time() - 5  # S3 tells whole seconds
        kept = files.put(KEY, 3, "policy.safetensors", POLICY)
        checkpoint = files.put_checkpoint(KEY, 3, 1, b"state")
        files.mark()
        listed = {file.path: file for file in files.files()}
        assert {path: file.size for path, file in listed.items()} == {kept.path: 700, checkpoint: 5}
        assert all(before <= file.modified <= time.time() + 5 for file in listed.values())

    def test_an_unfinished_file_is_listed_and_can_be_removed(self, files):
        files.put(KEY, 3, "a", b"x")
        unfinished = f"{KEY}/000003/.writing-0123"
        overwrite(files, unfinished, b"half")
        assert unfinished in list(files.paths())
        files.remove(unfinished)
        assert unfinished not in list(files.paths())

    def test_a_file_in_a_folder_that_was_emptied_meanwhile_can_be_written(self, files):
        files.remove(files.put(KEY, 3, "a", b"x").path)
        assert files.read(files.put(KEY, 3, "a", b"x")) == b"x"


class TestObjects:
    def test_a_server_that_is_away_is_storage_that_is_unavailable(self, monkeypatch):
        files = open_artifacts(f"memory://{uuid.uuid4().hex}/artifacts")

        def away(*_, **__):
            raise LookupError("no endpoint")

        monkeypatch.setattr(files._files, "pipe_file", away)
        with pytest.raises(StorageUnavailable, match=r"can be written, found: LookupError: no endpoint"):
            files.put(KEY, 3, "a", b"x")


class TestFolder:
    @pytest.fixture
    def files(self, tmp_path):
        return FolderArtifacts(tmp_path / "root")

    def test_links_out_of_the_root_are_not_followed(self, files, tmp_path):
        (tmp_path / "outside").mkdir()
        (tmp_path / "outside" / "secret").write_bytes(b"s")
        (tmp_path / "root").mkdir()
        (tmp_path / "root" / KEY).symlink_to(tmp_path / "outside")
        with pytest.raises(BadInput, match=r"found that links lead to .*outside"):
            files.put(KEY, 3, "a", b"x")
        with pytest.raises(BadInput, match=r"found that links lead to .*outside"):
            files.read(replace(FolderArtifacts(tmp_path / "x").put("k", 0, "a", b"s"), path=f"{KEY}/secret"))
        assert [path.name for path in (tmp_path / "outside").iterdir()] == ["secret"]

    def test_removing_a_link_removes_the_link(self, files, tmp_path):
        (tmp_path / "secret").write_bytes(b"s")
        (tmp_path / "root").mkdir()
        (tmp_path / "root" / "link").symlink_to(tmp_path / "secret")
        files.remove("link")
        assert list(files.paths()) == []
        assert (tmp_path / "secret").exists()

    def test_a_root_that_is_itself_a_link_is_fine(self, tmp_path):
        (tmp_path / "real").mkdir()
        (tmp_path / "root").symlink_to(tmp_path / "real")
        files = FolderArtifacts(tmp_path / "root")
        assert files.read(files.put(KEY, 3, "a", b"x")) == b"x"

    def test_a_write_that_fails_leaves_nothing_and_what_was_there_stays(self, files, monkeypatch):
        files.put_checkpoint(KEY, 3, 1, b"state 1")
        before = list(files.paths())

        def full(_):
            raise OSError(28, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr("services.artifacts.folder.os.fsync", full)
            with pytest.raises(OSError, match="No space left"):
                files.put_checkpoint(KEY, 3, 2, b"state 2")
        assert list(files.paths()) == before
        assert files.newest_checkpoint(KEY, 3) == (1, b"state 1")

    def test_nothing_appears_under_its_name_before_it_is_on_the_disk(self, files, monkeypatch):
        """File flushed, then renamed, then its folder flushed: in this order, so that no crash leaves half a file."""
        seen = []
        real = os.fsync

        def record(descriptor):
            names = sorted(path.split("/")[-1] for path in files.paths())
            seen.append((Path(f"/proc/self/fd/{descriptor}").readlink().name, names))
            real(descriptor)

        monkeypatch.setattr("services.artifacts.folder.os.fsync", record)
        files.put(KEY, 3, "a", b"x")
        final = "a-" + hashlib.sha256(b"x").hexdigest()[:16]
        *folders, (temporary, during), (folder, after) = seen
        assert [name for name, _ in folders][1:] == ["root", KEY]
        assert temporary.startswith(".writing-")
        assert during == [temporary]
        assert (folder, after) == ("000003", [final])


@given(data=st.binary(max_size=2000), name=st.from_regex(r"[A-Za-z0-9_-]{1,20}(\.[a-z]{1,8}){0,2}", fullmatch=True))
def test_any_bytes_under_any_plain_name_come_back(data, name):
    files = open_artifacts("memory://any")
    assert files.read(files.put(KEY, 3, name, data)) == data
