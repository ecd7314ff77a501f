"""Which store of artifacts an address means."""

from __future__ import annotations

from pathlib import Path

from services.artifacts.folder import FolderArtifacts
from services.artifacts.objects import ObjectArtifacts
from services.artifacts.port import ArtifactStore


def open_artifacts(url_or_path: str | Path) -> ArtifactStore:
    """The artifact store at a folder, or at an fsspec URL such as `s3://bucket/prefix`."""
    if isinstance(url_or_path, Path) or "://" not in url_or_path:
        return FolderArtifacts(Path(url_or_path))
    if url_or_path.startswith("file://"):
        return FolderArtifacts(Path(url_or_path.removeprefix("file://")))
    return ObjectArtifacts(url_or_path)
