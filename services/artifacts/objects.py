"""Artifacts on object storage."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from datetime import datetime
from pathlib import PurePosixPath
from typing import Any

import fsspec

from services.artifacts.named import NamedFiles
from services.artifacts.names import MARKER, checked
from services.artifacts.port import StoredFile


class ObjectArtifacts(NamedFiles):
    """Artifacts on anything that fsspec reaches and that makes an object visible only when it is whole (S3 does)."""

    client = True

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
