"""Whether the artifacts are where the trial database knows them. Without them no trial could go on or be shown.

The root holds a mark with an identity of its own and the history of the database it belongs to; the database holds
the identity and where it was last seen. So a root that was moved is known again, another one is told from it, and two
databases never share one (their studies have the same numbers: their files would get mixed up).
"""

from __future__ import annotations

import uuid

from services.artifacts.port import ArtifactStore
from services.errors import ArtifactsMoved, BadInput
from services.store.port import ArtifactRoot, Store


def settle(store: Store, artifacts: ArtifactStore) -> None:
    """Make sure that the artifacts are those of this database; the first time, note where they are.

    Raises:
        ArtifactsMoved: they are not.
        BadInput: the root is another database's.
        StorageUnavailable: the root can't be reached.
    """
    known = confirm(store, artifacts)
    found = artifacts.identity()
    if known is None:
        with store.transaction() as change:
            known = change.place_artifacts(ArtifactRoot(found or uuid.uuid4().hex, artifacts.url))
    elif found not in {"", known.identity}:  # nothing is lost with the root that was known
        with store.transaction() as change:
            change.place_artifacts(ArtifactRoot(found, artifacts.url), instead_of=known.identity)
        known = ArtifactRoot(found, artifacts.url)
    if known.url != artifacts.url:
        with store.transaction() as change:
            change.place_artifacts(ArtifactRoot(known.identity, artifacts.url), instead_of=known.identity)
    artifacts.mark(known.identity, store.history_id())


def confirm(store: Store, artifacts: ArtifactStore) -> ArtifactRoot | None:
    """Refuse artifacts that are not those of this database, and change nothing. Returns what is known of them.

    Raises:
        ArtifactsMoved, BadInput, StorageUnavailable: as `settle`.
    """
    known, found = store.artifact_root(), artifacts.identity()
    if known is not None and found == known.identity:
        return known
    _refuse_anothers(store, artifacts)
    if not _leaves_behind(store):
        return known
    if known is None:
        # A database from before roots were noted: its artifacts are here, or nobody knows where they are.
        if found or next(artifacts.paths(), None) is not None:
            return None
        was = "kept where this database's trials ran"
    else:
        was = f"with the mark {known.identity[:12]}..., last seen at {known.url}"
    what = f"a root with the mark {found[:12]}..." if found else "a root without a mark"
    raise ArtifactsMoved(
        f"artifacts {artifacts.url}: expected the artifacts of this database, {was}, found {what}; "
        "name the place that they have moved to with --artifacts PLACE or HALMA_ARTIFACTS, or, where this is that "
        "place or they are gone for good, see what is missing and take it as it is: halma verify --adopt"
    )


def adopt(store: Store, artifacts: ArtifactStore) -> None:
    """Take this root for the artifacts of this database from now on, whatever was known. Raises as `settle`."""
    known, found = store.artifact_root(), artifacts.identity()
    if known is None or found != known.identity:
        _refuse_anothers(store, artifacts)
    identity = found or (uuid.uuid4().hex if known is None else known.identity)
    with store.transaction() as change:
        change.place_artifacts(
            ArtifactRoot(identity, artifacts.url), instead_of="" if known is None else known.identity
        )
    artifacts.mark(identity, store.history_id())


def _refuse_anothers(store: Store, artifacts: ArtifactStore) -> None:
    owner = artifacts.owner()
    if owner not in {"", store.history_id()}:
        raise BadInput(
            f"artifacts {artifacts.url}: expected the artifacts of this database, found those of another one (its "
            f"history is {owner}), whose studies have the same numbers; give each database its own with --artifacts or "
            "HALMA_ARTIFACTS, or, where that database is gone, move these files away"
        )


def _leaves_behind(store: Store) -> bool:
    """Whether anything would be missing without the artifacts: a file that a trial names, or a checkpoint."""
    for row in store.studies():
        if store.study_artifacts(row.id):
            return True
        if any(trial.iteration for trial in store.trials(row.id) if trial.position is None):
            return True
    return False
