"""Artifacts for hosts that don't share the artifact folder: Ray's object store carries them to the head and back.

A write returns when the head has it on its own storage, flushed and renamed; so an outcome that names a file is never
committed before the file is where the record says, and a worker host that burns down takes nothing along.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import ray

from services.artifacts.open import open_artifacts
from services.artifacts.port import ArtifactStore, StoredFile
from services.errors import ArtifactDamaged, BadInput, StorageUnavailable
from services.store.port import ArtifactRow, NewArtifact

Keeper = Any
"""A handle on a `KeeperActor`."""

THREADS = 4
"""Files that are carried at the same time. Most of their time is the head's storage flushing."""


class KeeperActor:
    """The artifact store of the head, for workers elsewhere. All it does can be done twice, so a retry is harmless.

    Args:
        root: the artifact root on the head.
    """

    def __init__(self, root: str) -> None:
        self._artifacts = open_artifacts(root)

    def put(self, study_key: str, trial: int, name: str, data: bytes) -> dict[str, Any]:
        """See `ArtifactStore.put`; the artifact's fields."""
        return dataclasses.asdict(self._artifacts.put(study_key, trial, name, data))

    def read(self, artifact: dict[str, Any]) -> bytes:
        """See `ArtifactStore.read`."""
        return self._artifacts.read(NewArtifact(**artifact))

    def put_checkpoint(self, study_key: str, trial: int, iteration: int, data: bytes) -> str:
        """See `ArtifactStore.put_checkpoint`."""
        return self._artifacts.put_checkpoint(study_key, trial, iteration, data)

    def newest_checkpoint(self, study_key: str, trial: int) -> tuple[int, bytes] | None:
        """See `ArtifactStore.newest_checkpoint`."""
        return self._artifacts.newest_checkpoint(study_key, trial)

    def drop_checkpoints(self, study_key: str, trial: int) -> None:
        """See `ArtifactStore.drop_checkpoints`."""
        self._artifacts.drop_checkpoints(study_key, trial)

    def files(self) -> list[dict[str, Any]]:
        """See `ArtifactStore.files`; the fields of each."""
        return [dataclasses.asdict(file) for file in self._artifacts.files()]

    def remove(self, path: str) -> None:
        """See `ArtifactStore.remove`."""
        self._artifacts.remove(path)

    def identity(self) -> str:
        """See `ArtifactStore.identity`."""
        return self._artifacts.identity()

    def owner(self) -> str:
        """See `ArtifactStore.owner`."""
        return self._artifacts.owner()

    def mark(self, identity: str, owner: str) -> str:
        """See `ArtifactStore.mark`."""
        return self._artifacts.mark(identity, owner)


class RelayedArtifacts:
    """The `ArtifactStore` of a worker whose files the head keeps.

    Args:
        keeper: the head's end.
        url: the artifact root, as the head calls it.
    """

    def __init__(self, keeper: Keeper, url: str) -> None:
        self._keeper = keeper
        self.url = url

    def _ask(self, method: str, *arguments: Any) -> Any:
        try:
            return ray.get(getattr(self._keeper, method).remote(*arguments))
        except ray.exceptions.RayTaskError as error:
            if isinstance(error.cause, ArtifactDamaged | BadInput | StorageUnavailable):
                raise error.cause from None
            raise
        except ray.exceptions.RayError as error:
            raise StorageUnavailable(f"artifacts {self.url} on the head: expected an answer, found: {error}") from error

    def put(self, study_key: str, trial: int, name: str, data: bytes) -> NewArtifact:
        return NewArtifact(**self._ask("put", study_key, trial, name, data))

    def read(self, artifact: ArtifactRow | NewArtifact) -> bytes:
        bare = NewArtifact(artifact.name, artifact.path, artifact.sha256, artifact.size)
        data: bytes = self._ask("read", dataclasses.asdict(bare))
        return data

    def put_checkpoint(self, study_key: str, trial: int, iteration: int, data: bytes) -> str:
        return str(self._ask("put_checkpoint", study_key, trial, iteration, data))

    def newest_checkpoint(self, study_key: str, trial: int) -> tuple[int, bytes] | None:
        found: tuple[int, bytes] | None = self._ask("newest_checkpoint", study_key, trial)
        return found

    def drop_checkpoints(self, study_key: str, trial: int) -> None:
        self._ask("drop_checkpoints", study_key, trial)

    def files(self) -> Iterator[StoredFile]:
        return (StoredFile(**fields) for fields in self._ask("files"))

    def paths(self) -> Iterator[str]:
        return (file.path for file in self.files())

    def remove(self, path: str) -> None:
        self._ask("remove", path)

    def identity(self) -> str:
        return str(self._ask("identity"))

    def owner(self) -> str:
        return str(self._ask("owner"))

    def mark(self, identity: str = "", owner: str = "") -> str:
        return str(self._ask("mark", identity, owner))


def start_keeper(root: str, node: str) -> Keeper:
    """A keeper on this node. It outlives crashes of its process; what was under way is asked again."""
    shaped: Any = ray.remote(KeeperActor)
    return shaped.options(
        num_cpus=0,
        max_concurrency=THREADS,
        max_restarts=-1,
        max_task_retries=-1,
        scheduling_strategy=ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(node, soft=False),
    ).remote(root)


def artifacts_here(root: str, identity: str, keeper: Keeper | None) -> ArtifactStore:
    """The artifacts as a worker reaches them: directly where it sees the very same root, else through the keeper.

    Args:
        root: the artifact root, as the head calls it.
        identity: of the root, as the head read it.
        keeper: the head's end, or None on the head's own host.
    """
    artifacts = open_artifacts(root)
    if keeper is None:
        return artifacts
    try:
        shared = artifacts.identity() == identity
    except StorageUnavailable:
        shared = False  # object storage that only the head can reach
    return artifacts if shared else RelayedArtifacts(keeper, root)
