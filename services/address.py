"""Where the running service is: `server.json` in the home folder."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from services.settings import Settings


@dataclass(frozen=True, slots=True)
class Server:
    """A running service.

    Args:
        url: base URL, without a slash at the end.
        pid: its process, or None where it is not on this machine.
        database: what it works on, or empty where that isn't known.
    """

    url: str
    pid: int | None = None
    database: str = ""


def read_server(file: Path) -> Server | None:
    """The service that `server.json` names, if its process lives."""
    try:
        fields: Mapping[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        server = Server(str(fields["url"]).rstrip("/"), int(fields["pid"]), str(fields.get("database", "")))
    except (OSError, ValueError, KeyError, TypeError):
        # A file that is not there, or half of one, names no service.
        return None
    return server if server.pid is not None and _lives(server.pid) else None


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def find_server(settings: Settings) -> Server | None:
    """The service of this home that works on this database, if one runs."""
    server = read_server(settings.server_file)
    return server if server is not None and server.database in {"", settings.database} else None
