"""Files that trials leave: artifacts, named by rows of the trial database, and checkpoints, named by none.

The layout below the root (`services.artifacts.names`) is the same on a folder and on object storage. The SHA-256 is
part of every name. So a worker that comes back from the dead can't overwrite what its successor wrote and a row
already names; a file that was cut short is found out without asking the database; and writing the same bytes twice
is no change.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from services.store.port import ArtifactRow, NewArtifact


@dataclass(frozen=True, slots=True)
class StoredFile:
    """A file as storage lists it.

    Args:
        path: below the root.
        size: bytes.
        modified: seconds since 1970 by the clock of the storage; None where it doesn't say.
    """

    path: str
    size: int
    modified: float | None


class ArtifactStore(Protocol):
    """The port to the files of trials. Storage that fails raises `StorageUnavailable`, and nothing stays half done."""

    url: str

    def put(self, study_key: str, trial: int, name: str, data: bytes) -> NewArtifact:
        """Keep a named result of a trial. It is safe on storage when this returns, and can then be recorded.

        Raises `BadInput` for a name that leaves the trial's folder.
        """

    def read(self, artifact: ArtifactRow | NewArtifact) -> bytes:
        """The content that was recorded. Raises `ArtifactDamaged` where it is missing or altered."""

    def put_checkpoint(self, study_key: str, trial: int, iteration: int, data: bytes) -> str:
        """Keep a checkpoint; the last two stay. Returns its path. It is safe on storage when this returns."""

    def newest_checkpoint(self, study_key: str, trial: int) -> tuple[int, bytes] | None:
        """Iteration and content of the newest intact checkpoint. Torn ones are set aside on the way."""

    def drop_checkpoints(self, study_key: str, trial: int) -> None:
        """Remove the checkpoints of a trial that is final, torn ones too."""

    def files(self) -> Iterator[StoredFile]:
        """All files below the root but its marker, in no order, unfinished ones among them."""

    def paths(self) -> Iterator[str]:
        """Their paths."""

    def remove(self, path: str) -> None:
        """Remove a file; one that is gone already is fine. Raises `BadInput` for a path that leaves the root."""

    def identity(self) -> str:
        """What tells this root from every other, wherever it is mounted; empty where it has not been marked."""

    def owner(self) -> str:
        """The history of the trial database that the root belongs to; empty where it has not been told."""

    def mark(self, identity: str = "", owner: str = "") -> str:
        """Mark the root: what is given replaces what its mark says, and one without an identity gets one.

        Returns its identity.
        """
