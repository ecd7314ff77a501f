"""Files that trials leave: artifacts, named by rows of the trial database, and checkpoints, named by none.

Layout below the root, the same on a folder and on object storage:

    <study id>-<study name>/<trial>/policy-<hash>.safetensors     what `put` wrote
    <study id>-<study name>/<trial>/checkpoints/<iteration>-<hash>.checkpoint
    ... .torn                                                     set aside because content and hash differ

    .halma-artifacts                                              the root's identity, so that it is known again

The SHA-256 is part of every name. So a worker that comes back from the dead can't overwrite what its successor
wrote and a row already names; a file that was cut short is found out without asking the database; and writing
the same bytes twice is no change.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import uuid
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Protocol

import fsspec

from services.errors import ArtifactDamaged, BadInput, HalmaError, StorageUnavailable
from services.store.port import ArtifactRow, NewArtifact

KEPT_CHECKPOINTS = 2
"""The newest, and the one before it should the newest turn out torn."""

_NAME_DIGITS = 16
"""Hex digits of the hash in an artifact's name: enough to keep writers apart; the row holds all 64."""

_CHECKPOINT = re.compile(r"(?P<iteration>\d{8,})-(?P<sha256>[0-9a-f]{64})\.checkpoint")
MARKER = ".halma-artifacts"
"""Holds the identity of a root: the same files under another path, or on another host, have the same."""

_TEMPORARY = ".writing-"
_TORN = ".torn"


def study_key(study_id: int, name: str) -> str:
    """The folder of a study: its id, which no other study ever has, and its name for people."""
    return f"{study_id}-{re.sub(r'[^A-Za-z0-9._-]+', '_', name)}"


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

    def paths(self) -> Iterator[str]:
        """Paths of all files below the root but its marker, in no order, unfinished ones among them."""

    def remove(self, path: str) -> None:
        """Remove a file; one that is gone already is fine. Raises `BadInput` for a path that leaves the root."""

    def identity(self) -> str:
        """What tells this root from every other, wherever it is mounted; empty where it has not been marked."""

    def mark(self) -> str:
        """Give the root an identity where it has none. Returns it."""


def open_artifacts(url_or_path: str | Path) -> ArtifactStore:
    """The artifact store at a folder, or at an fsspec URL such as `s3://bucket/prefix`."""
    if isinstance(url_or_path, Path) or "://" not in url_or_path:
        return FolderArtifacts(Path(url_or_path))
    if url_or_path.startswith("file://"):
        return FolderArtifacts(Path(url_or_path.removeprefix("file://")))
    return ObjectArtifacts(url_or_path)


class _Files(ABC):
    """Names, hashes and checkpoints over six operations on files, which the adapters bring."""

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
    def remove(self, path: str) -> None:
        """Remove a file; one that is gone already is fine."""

    def put(self, study_key: str, trial: int, name: str, data: bytes) -> NewArtifact:
        """Keep a named result of a trial; see the port."""
        digest = hashlib.sha256(data).hexdigest()
        path = str(_trial_folder(study_key, trial) / _hashed(_single("artifact name", name), digest))
        with self._storage("written"):
            self._write(path, data)
        return NewArtifact(name=name, path=path, sha256=digest, size=len(data))

    def read(self, artifact: ArtifactRow | NewArtifact) -> bytes:
        """The content that was recorded; see the port."""
        path = str(_checked(artifact.path))
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
        folder = str(_checkpoints(study_key, trial))
        name = f"{iteration:08d}-{hashlib.sha256(data).hexdigest()}.checkpoint"
        with self._storage("written"):
            self._write(f"{folder}/{name}", data)
            for _, old in self._ranked(folder)[KEPT_CHECKPOINTS:]:
                if old != name:
                    self.remove(f"{folder}/{old}")
        return f"{folder}/{name}"

    def newest_checkpoint(self, study_key: str, trial: int) -> tuple[int, bytes] | None:
        """Iteration and content of the newest intact checkpoint; see the port."""
        folder = str(_checkpoints(study_key, trial))
        with self._storage("read"):
            for iteration, name in self._ranked(folder):
                data = self._read(f"{folder}/{name}")
                if data is None:
                    continue
                if f"-{hashlib.sha256(data).hexdigest()}." in name:
                    return iteration, data
                self._rename(f"{folder}/{name}", name + _TORN)
        return None

    def drop_checkpoints(self, study_key: str, trial: int) -> None:
        """Remove the checkpoints of a trial that is final; see the port."""
        folder = str(_checkpoints(study_key, trial))
        with self._storage("written"):
            for name in self._names(folder):
                self.remove(f"{folder}/{name}")

    def identity(self) -> str:
        """What tells this root from every other; see the port."""
        with self._storage("read"):
            found = self._read(MARKER)
        return "" if found is None else found.decode("ascii", "replace").strip()

    def mark(self) -> str:
        """Give the root an identity where it has none; see the port."""
        found = self.identity()
        if not found:
            found = uuid.uuid4().hex
            with self._storage("written"):
                self._write(MARKER, f"{found}\n".encode())
        return found

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
        found = ((_CHECKPOINT.fullmatch(name), name) for name in self._names(folder))
        return sorted(((int(match["iteration"]), name) for match, name in found if match), reverse=True)


class FolderArtifacts(_Files):
    """Artifacts in a folder. What was put survives a power failure: file, rename and folders are all flushed."""

    def __init__(self, root: Path) -> None:
        self._root = root.expanduser().absolute()
        self.url = str(self._root)

    def _inside(self, path: str) -> Path:
        """Where a path lies once all links are followed. Raises `BadInput` where that is not below the root."""
        real = (self._root / _checked(path)).resolve()
        if not real.is_relative_to(self._root.resolve()):
            raise BadInput(
                f"artifact path {path!r}: expected a place below {self._root}, found that links lead to {real}; "
                "remove the link"
            )
        return real

    def _write(self, path: str, data: bytes) -> None:
        target = self._inside(path)
        _make_folder(target.parent)
        temporary = target.with_name(f"{_TEMPORARY}{uuid.uuid4().hex}")
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

    def paths(self) -> Iterator[str]:
        """Paths of all files below the root; links are not followed."""
        for folder, _, names in os.walk(self._root):
            for name in names:
                path = (Path(folder) / name).relative_to(self._root).as_posix()
                if path != MARKER:
                    yield path

    def remove(self, path: str) -> None:
        """Remove a file, of a link the link; one that is gone already is fine."""
        checked = _checked(path)
        (self._inside(str(checked.parent)) if len(checked.parts) > 1 else self._root).joinpath(checked.name).unlink(
            missing_ok=True
        )


class ObjectArtifacts(_Files):
    """Artifacts on anything that fsspec reaches and that makes an object visible only when it is whole (S3 does)."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._files, root = fsspec.core.url_to_fs(url)
        self._root = str(root).rstrip("/")

    def _place(self, path: str) -> str:
        return f"{self._root}/{_checked(path)}"

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

    def paths(self) -> Iterator[str]:
        """Paths of all objects below the root."""
        self._files.invalidate_cache()
        for place in self._files.find(self._root):
            path = str(place).removeprefix(self._root + "/")
            if path != MARKER:
                yield path

    def remove(self, path: str) -> None:
        """Remove an object; one that is gone already is fine."""
        with contextlib.suppress(FileNotFoundError):
            self._files.rm_file(self._place(path))


def _why_not(url: str, done: str, found: str) -> str:
    return f"artifacts {url}: expected files that can be {done}, found: {found}; nothing half-done was left"


def _checked(path: str) -> PurePosixPath:
    """A relative path that stays where it is put. Raises `BadInput`."""
    parts = path.split("/")
    if any(part in {"", ".", ".."} or part.startswith(_TEMPORARY) for part in parts) or re.search(r"[\\\0:]", path):
        raise BadInput(
            f"artifact path {path!r}: expected names joined by single slashes, without '..', '\\' or ':' and not "
            "absolute, so that it can't leave its folder"
        )
    return PurePosixPath(path)


def _single(what: str, name: str) -> str:
    """A name that is no path. Raises `BadInput`."""
    if len(_checked(name).parts) != 1:
        raise BadInput(f"{what} {name!r}: expected a single name, found a path; leave the folders out")
    return name


def _trial_folder(study_key: str, trial: int) -> PurePosixPath:
    return PurePosixPath(_single("study key", study_key)) / f"{trial:06d}"


def _checkpoints(study_key: str, trial: int) -> PurePosixPath:
    return _trial_folder(study_key, trial) / "checkpoints"


def _hashed(name: str, digest: str) -> str:
    """`policy.safetensors` -> `policy-0123456789abcdef.safetensors`."""
    stem, dot, suffix = name.partition(".")
    return f"{stem}-{digest[:_NAME_DIGITS]}{dot}{suffix}"


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
