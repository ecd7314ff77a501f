"""An artifact root that is where it was, has moved, is another one, or is gone."""

from __future__ import annotations

import re
import shutil

import pytest

from services.artifacts.open import open_artifacts
from services.artifacts.root import adopt, confirm, settle
from services.errors import ArtifactsMoved, BadInput
from services.states import TrialState
from services.store.open import open_store
from services.store.port import ArtifactRoot, Driver, NewTrial, Result


@pytest.fixture
def store(tmp_path):
    opened = open_store(tmp_path / "halma.db")
    yield opened
    opened.close()


@pytest.fixture
def files(tmp_path):
    return open_artifacts(tmp_path / "here")


def leave_something(store, files):
    """A trial with an artifact."""
    with store.transaction() as change:
        study = change.create_study("s", {}, seed=1).id
        token = change.drive("s", Driver("me", "here", 1))
        (trial,) = change.propose(
            study, token, strategy="s", history=0, pending=[], rng_key=[], seconds=0.0, trials=[NewTrial({}, seed=0)]
        )
        attempt = change.start(trial.id, token, worker="w")
    kept = files.put(f"{study}-s", 0, "policy.bin", b"weights")
    with store.transaction() as change:
        change.finish(attempt.id, attempt.token, Result(TrialState.COMPLETE, value=1.0, artifacts=[kept]))


def test_the_first_driver_notes_where_the_artifacts_are(store, files):
    assert store.artifact_root() is None
    settle(store, files)
    assert store.artifact_root() == ArtifactRoot(files.identity(), files.url)
    assert files.owner() == store.history_id()
    before = store.last_event()
    settle(store, files)
    assert store.last_event() == before, "nothing to note"


def test_of_two_that_note_it_at_once_the_second_learns_what_the_first_noted(store):
    first, second = ArtifactRoot("a", "/a"), ArtifactRoot("b", "/b")
    with store.transaction() as change:
        assert change.place_artifacts(first) == first
        assert change.place_artifacts(second) == first
        assert change.place_artifacts(second, instead_of="c") == first
        assert change.place_artifacts(second, instead_of="a") == second
    assert store.artifact_root() == second
    assert [event.payload["url"] for event in store.events() if event.kind == "artifacts_placed"] == ["/a", "/b"]


def test_a_root_that_was_moved_is_known_again(store, files, tmp_path):
    settle(store, files)
    leave_something(store, files)
    shutil.move(files.url, tmp_path / "there")
    there = open_artifacts(tmp_path / "there")
    settle(store, there)
    assert store.artifact_root() == ArtifactRoot(there.identity(), there.url)


@pytest.mark.parametrize("mark", ["", "another"], ids=["nothing", "another root"])
def test_artifacts_that_are_not_there_are_told_with_where_they_were_and_what_to_do(store, files, tmp_path, mark):
    settle(store, files)
    leave_something(store, files)
    there = open_artifacts(tmp_path / "there")
    if mark:
        there.mark(mark)
    for ask in (settle, confirm):
        with pytest.raises(ArtifactsMoved) as caught:
            ask(store, there)
        message = str(caught.value)
        assert message.startswith(f"artifacts {tmp_path}/there: expected the artifacts of this database, with the mark")
        assert f"last seen at {files.url}, found a root with" in message
        assert "--artifacts PLACE or HALMA_ARTIFACTS" in message
        assert "halma verify --adopt" in message
    assert (there.identity(), there.owner()) == (mark, ""), "nothing was changed"
    assert store.artifact_root().url == files.url


def test_a_root_may_change_as_long_as_nothing_was_kept_in_it(store, files, tmp_path):
    settle(store, files)
    shutil.rmtree(files.url)
    settle(store, files)
    assert files.identity() == store.artifact_root().identity
    marked = open_artifacts(tmp_path / "there")
    marked.mark("another")
    settle(store, marked)
    assert store.artifact_root() == ArtifactRoot("another", marked.url)


def test_a_database_from_before_roots_were_noted_takes_the_one_that_holds_its_files(store, files, tmp_path):
    leave_something(store, files)
    with pytest.raises(ArtifactsMoved, match=r"kept where this database's trials ran, found a root without a mark"):
        settle(store, open_artifacts(tmp_path / "there"))
    settle(store, files)
    assert store.artifact_root() == ArtifactRoot(files.identity(), files.url)


def test_a_root_whose_mark_was_not_copied_along_can_be_adopted(store, files, tmp_path):
    settle(store, files)
    leave_something(store, files)
    identity = files.identity()
    shutil.copytree(files.url, tmp_path / "copy", ignore=shutil.ignore_patterns(".halma-artifacts"))
    copy = open_artifacts(tmp_path / "copy")
    with pytest.raises(ArtifactsMoved):
        settle(store, copy)
    adopt(store, copy)
    settle(store, copy)
    assert store.artifact_root() == ArtifactRoot(identity, copy.url)


def test_the_root_of_another_database_is_refused_even_for_adoption(store, files, tmp_path):
    other = open_store(tmp_path / "other.db")
    settle(other, files)
    for ask in (settle, adopt):
        with pytest.raises(BadInput, match=re.escape(f"its history is {other.history_id()}), whose studies")):
            ask(store, files)
    assert store.artifact_root() is None
    other.close()
