"""What all stores of artifacts share: names, hashes, and which checkpoint is the newest whole one."""

from __future__ import annotations

import contextlib
import hashlib
import uuid
from abc import ABC, abstractmethod
from collections.abc import Iterator

from services.artifacts.names import (
    CHECKPOINT,
    MARKER,
    TORN,
    checked,
    checkpoint_name,
    checkpoints_folder,
    hashed,
    single,
    trial_folder,
)
from services.artifacts.port import StoredFile
from services.errors import ArtifactDamaged, HalmaError, StorageUnavailable
from services.store.port import ArtifactRow, NewArtifact

KEPT_CHECKPOINTS = 2
"""The newest, and the one before it should the newest turn out torn."""


class NamedFiles(ABC):
    """Names, hashes and checkpoints over seven operations on files, which the adapters bring."""

    url: str
    client = False
    """Whether somebody else's client does the work, which has errors of its own for a server that is away."""

    @abstractmethod
    def _write(self, path: str, data: bytes) -> None:
        """Make a file appear with all its content, durably, or not at all."""

    @abstractmethod
    def _read(self, path: str) -> bytes | None:
        """Content of a file, None where there is none."""

    @abstractmethod
    def _names(self, folder: str) -> list[str]:
        """Names of the files in a folder, none where there is no folder."""

    @abstractmethod
    def _rename(self, path: str, name: str) -> None:
        """Give a file another name in its folder; one that is gone already is fine."""

    @abstractmethod
    def _remove(self, path: str) -> None:
        """Remove a file; one that is gone already is fine."""

    @abstractmethod
    def _all_files(self) -> Iterator[StoredFile]:
        """All files below the root but its marker."""

    def put(self, study_key: str, trial: int, name: str, data: bytes) -> NewArtifact:
        """Keep a named result of a trial; see the port."""
        digest = hashlib.sha256(data).hexdigest()
        path = str(trial_folder(study_key, trial) / hashed(single("artifact name", name), digest))
        with self._storage("written"):
            self._write(path, data)
        return NewArtifact(name=name, path=path, sha256=digest, size=len(data))

    def read(self, artifact: ArtifactRow | NewArtifact) -> bytes:
        """The content that was recorded; see the port."""
        path = str(checked(artifact.path))
        with self._storage("read"):
            data = self._read(path)
        where = f"artifact {artifact.path} in {self.url}"
        if data is None:
            raise ArtifactDamaged(
                f"{where}: expected {artifact.size} bytes with SHA-256 {artifact.sha256}, found no file; "
                "if the artifacts have moved, name their new place, or restore the file from a backup"
            )
        digest = hashlib.sha256(data).hexdigest()
        if digest != artifact.sha256:
            raise ArtifactDamaged(
                f"{where}: expected {artifact.size} bytes with SHA-256 {artifact.sha256}, found {len(data)} bytes with "
                f"{digest}; restore the file from a backup"
            )
        return data

    def put_checkpoint(self, study_key: str, trial: int, iteration: int, data: bytes) -> str:
        """Keep a checkpoint; see the port."""
        folder = str(checkpoints_folder(study_key, trial))
        name = checkpoint_name(iteration, hashlib.sha256(data).hexdigest())
        with self._storage("written"):
            self._write(f"{folder}/{name}", data)
            for _, old in self._ranked(folder)[KEPT_CHECKPOINTS:]:
                if old != name:
                    self._remove(f"{folder}/{old}")
        return f"{folder}/{name}"

    def newest_checkpoint(self, study_key: str, trial: int) -> tuple[int, bytes] | None:
        """Iteration and content of the newest intact checkpoint; see the port."""
        folder = str(checkpoints_folder(study_key, trial))
        with self._storage("read"):
            for iteration, name in self._ranked(folder):
                data = self._read(f"{folder}/{name}")
                if data is None:
                    continue
                if f"-{hashlib.sha256(data).hexdigest()}." in name:
                    return iteration, data
                self._rename(f"{folder}/{name}", name + TORN)
        return None

    def drop_checkpoints(self, study_key: str, trial: int) -> None:
        """Remove the checkpoints of a trial that is final; see the port."""
        folder = str(checkpoints_folder(study_key, trial))
        with self._storage("written"):
            for name in self._names(folder):
                self._remove(f"{folder}/{name}")

    def identity(self) -> str:
        """What tells this root from every other; see the port."""
        return self._mark()[0]

    def owner(self) -> str:
        """The history of the trial database that the root belongs to; see the port."""
        return self._mark()[1]

    def mark(self, identity: str = "", owner: str = "") -> str:
        """Mark the root; see the port."""
        found = self._mark()
        wanted = (identity or found[0] or uuid.uuid4().hex, owner or found[1])
        if wanted != found:
            with self._storage("written"):
                self._write(MARKER, "".join(f"{line}\n" for line in wanted if line).encode())
        return wanted[0]

    def _mark(self) -> tuple[str, str]:
        """Identity and owner, as the mark says."""
        with self._storage("read"):
            found = self._read(MARKER) or b""
        lines = [*found.decode("ascii", "replace").splitlines(), "", ""]
        return lines[0].strip(), lines[1].strip()

    def files(self) -> Iterator[StoredFile]:
        """All files below the root but its marker; see the port."""
        with self._storage("listed"):
            yield from self._all_files()

    def paths(self) -> Iterator[str]:
        """Paths of all files below the root but its marker; see the port."""
        return (file.path for file in self.files())

    def remove(self, path: str) -> None:
        """Remove a file; see the port."""
        checked(path, unfinished=True)
        with self._storage("removed"):
            self._remove(path)

    @contextlib.contextmanager
    def _storage(self, done: str) -> Iterator[None]:
        """Tell storage that fails from files that are wrong: the one is waited for, the other is not."""
        try:
            yield
        except (HalmaError, ValueError):
            raise
        except OSError as error:
            raise StorageUnavailable(_why_not(self.url, done, error.strerror or str(error))) from error
        except Exception as error:
            if not self.client:
                raise
            raise StorageUnavailable(_why_not(self.url, done, f"{type(error).__name__}: {error}")) from error

    def _ranked(self, folder: str) -> list[tuple[int, str]]:
        """Iteration and name of the checkpoints that a folder claims to hold, newest first."""
        found = ((CHECKPOINT.fullmatch(name), name) for name in self._names(folder))
        return sorted(((int(match["iteration"]), name) for match, name in found if match), reverse=True)


def _why_not(url: str, done: str, found: str) -> str:
    return f"artifacts {url}: expected files that can be {done}, found: {found}; nothing half-done was left"
