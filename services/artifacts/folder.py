"""Artifacts in a folder."""

from __future__ import annotations

import contextlib
import os
import uuid
from collections.abc import Iterator
from pathlib import Path

from services.artifacts.named import NamedFiles
from services.artifacts.names import MARKER, TEMPORARY, checked
from services.artifacts.port import StoredFile
from services.errors import BadInput


class FolderArtifacts(NamedFiles):
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


def _raise(error: OSError) -> None:
    """A folder that can't be listed is no empty one; one that has just been removed is."""
    if not isinstance(error, FileNotFoundError | NotADirectoryError):
        raise error


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
