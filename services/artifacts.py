"""Files that trials leave: artifacts, named by rows of the trial database, and checkpoints, named by none.

The layout below the root (`services.artifact_names`) is the same on a folder and on object storage. The SHA-256 is
part of every name. So a worker that comes back from the dead can't overwrite what its successor wrote and a row
already names; a file that was cut short is found out without asking the database; and writing the same bytes twice
is no change.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import uuid
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Any, Protocol

import fsspec

from services.artifact_names import (
    CHECKPOINT,
    MARKER,
    TEMPORARY,
    TORN,
    checked,
    checkpoint_name,
    checkpoints_folder,
    hashed,
    single,
    trial_folder,
)
from services.errors import ArtifactDamaged, BadInput, HalmaError, StorageUnavailable
from services.store.port import ArtifactRow, NewArtifact

KEPT_CHECKPOINTS = 2
"""The newest, and the one before it should the newest turn out torn."""


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


def open_artifacts(url_or_path: str | Path) -> ArtifactStore:
    """The artifact store at a folder, or at an fsspec URL such as `s3://bucket/prefix`."""
    if isinstance(url_or_path, Path) or "://" not in url_or_path:
        return FolderArtifacts(Path(url_or_path))
    if url_or_path.startswith("file://"):
        return FolderArtifacts(Path(url_or_path.removeprefix("file://")))
    return ObjectArtifacts(url_or_path)


class _Files(ABC):
    """Names, hashes and checkpoints over seven operations on files, which the adapters bring."""

    url: str

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
            if isinstance(self, FolderArtifacts):
                raise
            # What an object store's client raises when its server is away is known to that client alone.
            raise StorageUnavailable(_why_not(self.url, done, f"{type(error).__name__}: {error}")) from error

    def _ranked(self, folder: str) -> list[tuple[int, str]]:
        """Iteration and name of the checkpoints that a folder claims to hold, newest first."""
        found = ((CHECKPOINT.fullmatch(name), name) for name in self._names(folder))
        return sorted(((int(match["iteration"]), name) for match, name in found if match), reverse=True)


class FolderArtifacts(_Files):
    """Artifacts in a folder. What was put survives a power failure: file, rename and folders are all flushed."""

    def __init__(self, root: Path) -> None:
        self._root = root.expanduser().absolute()
        self.url = str(self._root)

    def _inside(self, path: str) -> Path:
        """Where a path lies once all links are followed. Raises `BadInput` where that is not below the root."""
        real = (self._root / checked(path)).resolve()
        if not real.is_relative_to(self._root.resolve()):
            raise BadInput(
                f"artifact path {path!r}: expected a place below {self._root}, found that links lead to {real}; "
                "remove the link"
            )
        return real

    def _write(self, path: str, data: bytes) -> None:
        target = self._inside(path)
        _make_folder(target.parent)
        temporary = target.with_name(f"{TEMPORARY}{uuid.uuid4().hex}")
        try:
            with temporary.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(target)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        _flush_folder(target.parent)

    def _read(self, path: str) -> bytes | None:
        try:
            return self._inside(path).read_bytes()
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
            return None

    def _names(self, folder: str) -> list[str]:
        try:
            return [entry.name for entry in self._inside(folder).iterdir()]
        except (FileNotFoundError, NotADirectoryError):
            return []

    def _rename(self, path: str, name: str) -> None:
        source = self._inside(path)
        with contextlib.suppress(FileNotFoundError):
            source.replace(source.with_name(name))

    def _all_files(self) -> Iterator[StoredFile]:
        """Links are listed, and not followed."""
        for folder, _, names in os.walk(self._root, onerror=_raise):
            for name in names:
                file = Path(folder) / name
                path = file.relative_to(self._root).as_posix()
                with contextlib.suppress(FileNotFoundError):  # it was removed or renamed meanwhile
                    if path != MARKER:
                        found = file.lstat()
                        yield StoredFile(path, found.st_size, found.st_mtime)

    def _remove(self, path: str) -> None:
        """Of a link the link; folders that are empty then go with it."""
        parts = checked(path, unfinished=True)
        folder = self._inside(str(parts.parent)) if len(parts.parts) > 1 else self._root.resolve()
        folder.joinpath(parts.name).unlink(missing_ok=True)
        # Whoever makes a file in one of them just now finds it gone, and tries again (`StorageUnavailable`).
        with contextlib.suppress(OSError):
            while folder != self._root.resolve():
                folder.rmdir()
                folder = folder.parent


class ObjectArtifacts(_Files):
    """Artifacts on anything that fsspec reaches and that makes an object visible only when it is whole (S3 does)."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._files, root = fsspec.core.url_to_fs(url)
        self._root = str(root).rstrip("/")

    def _place(self, path: str) -> str:
        return f"{self._root}/{checked(path)}"

    def _write(self, path: str, data: bytes) -> None:
        self._files.pipe_file(self._place(path), data)

    def _read(self, path: str) -> bytes | None:
        try:
            return bytes(self._files.cat_file(self._place(path)))
        except FileNotFoundError:
            return None

    def _names(self, folder: str) -> list[str]:
        self._files.invalidate_cache()  # other machines write there, too
        try:
            entries = self._files.ls(self._place(folder), detail=True)
        except FileNotFoundError:
            return []
        return [PurePosixPath(entry["name"]).name for entry in entries if entry["type"] == "file"]

    def _rename(self, path: str, name: str) -> None:
        source = self._place(path)
        with contextlib.suppress(FileNotFoundError):
            self._files.mv(source, str(PurePosixPath(source).with_name(name)))

    def _all_files(self) -> Iterator[StoredFile]:
        self._files.invalidate_cache()
        for place, found in self._files.find(self._root, detail=True).items():
            path = str(place).removeprefix(self._root + "/")
            if path != MARKER:
                yield StoredFile(path, int(found.get("size") or 0), _moment(found))

    def _remove(self, path: str) -> None:
        with contextlib.suppress(FileNotFoundError):
            self._files.rm_file(f"{self._root}/{checked(path, unfinished=True)}")


def _moment(found: dict[str, Any]) -> float | None:
    """When an object was written, in whatever word its file system has for it."""
    for name in ("LastModified", "last_modified", "mtime", "created"):
        at = found.get(name)
        if isinstance(at, datetime):
            return at.timestamp()
        if isinstance(at, int | float):
            return float(at)
    return None


def _raise(error: OSError) -> None:
    """A folder that can't be listed is no empty one; one that has just been removed is."""
    if not isinstance(error, FileNotFoundError | NotADirectoryError):
        raise error


def _why_not(url: str, done: str, found: str) -> str:
    return f"artifacts {url}: expected files that can be {done}, found: {found}; nothing half-done was left"


def _make_folder(folder: Path) -> None:
    """Make a folder and those above it, each flushed into the one that holds it."""
    if folder.is_dir():
        return
    _make_folder(folder.parent)
    with contextlib.suppress(FileExistsError):  # another worker was faster
        folder.mkdir()
    _flush_folder(folder.parent)


def _flush_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
