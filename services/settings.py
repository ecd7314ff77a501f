"""Where things are: the home folder, the trial database, the artifacts, the running server's address and token."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from services.errors import BadInput

SQLITE_PREFIX = "sqlite:///"


@dataclass(frozen=True, slots=True)
class Settings:
    """The places this process works with.

    Args:
        home: `HALMA_HOME`, default `~/.halma`.
        database: URL of the trial database, or path of its SQLite file.
        artifacts: root of the files that trials leave, a folder or a URL that fsspec knows. Each database has its own.
    """

    home: Path
    database: str
    artifacts: str

    @property
    def token_file(self) -> Path:
        """The API token; readable by its owner only."""
        return self.home / "token"

    @property
    def reports(self) -> Path:
        """Folder of the pictures that reports draw: beside the artifacts, so that databases don't mix them up."""
        if "://" in self.artifacts:
            return self.home / "reports"
        return Path(self.artifacts).with_suffix(".reports")

    @property
    def server_file(self) -> Path:
        """Address of the running server, JSON."""
        return self.home / "server.json"


def find_settings(
    database: str | None = None, environ: Mapping[str, str] = os.environ, artifact_root: str | None = None
) -> Settings:
    """The places, from what was typed and the environment (`HALMA_HOME`, `HALMA_DB`, `HALMA_ARTIFACTS`).

    Args:
        database: `--db`.
        environ: the environment.
        artifact_root: `--artifacts`.

    Raises:
        BadInput: a value that can't be a place.
    """
    home = Path(environ.get("HALMA_HOME") or "~/.halma").expanduser().absolute()
    if home.exists() and not home.is_dir():
        raise BadInput(f"HALMA_HOME: expected a folder, found the file {home}; name another one")
    given = database if database is not None else environ.get("HALMA_DB", "")
    if database is not None and not database.strip():
        raise BadInput("--db: expected a path or a URL, found nothing; for example --db studies.db")
    if not given:
        url = str(home / "halma.db")
    elif "://" in given:
        url = given
    else:
        url = str(Path(given).expanduser().absolute())
    if artifact_root is not None and not artifact_root.strip():
        raise BadInput(
            "--artifacts: expected a folder or a URL, found nothing; for example --artifacts s3://bucket/halma"
        )
    root = artifact_root or environ.get("HALMA_ARTIFACTS")
    if not root:
        artifacts = str(_artifacts_of(url, home))
    elif "://" in root:
        artifacts = root
    else:
        artifacts = str(Path(root).expanduser().absolute())
    return Settings(home, url, artifacts)


def _artifacts_of(url: str, home: Path) -> Path:
    """Beside a SQLite file; in the home folder for a server's database, under a name that tells databases apart."""
    if url.startswith(SQLITE_PREFIX) or "://" not in url:
        file = Path(url.removeprefix(SQLITE_PREFIX)).expanduser().absolute()
        return file.with_name(f"{file.stem}.artifacts")
    # The password may change, and must not show in a path.
    where = re.sub(r"^[^:]+://([^@/]*@)?", "", url).partition("?")[0]
    readable = re.sub(r"[^A-Za-z0-9_.-]+", "-", where).strip("-")
    return home / "artifacts" / f"{readable}-{hashlib.sha256(where.encode()).hexdigest()[:8]}"
