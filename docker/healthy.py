"""What the health checks of the images ask: exit code 0 where the role given as argument does its work.

head: the service answers that it can work, and so does Ray's head. dashboard: the service does. worker: a raylet runs
here, and the head can be reached. Nothing but the standard library: it starts within a tenth of a second.
"""

from __future__ import annotations

import os
import socket
import sys
import urllib.request
from pathlib import Path

SECONDS = 4.0
PAGES = "http://127.0.0.1:8642/readyz"


def answers(address: str) -> bool:
    """Whether somebody accepts connections at HOST:PORT."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), SECONDS).close()
    except OSError:
        return False
    return True


def is_ready(url: str) -> bool:
    """Whether a service answers with 200."""
    try:
        with urllib.request.urlopen(url, timeout=SECONDS) as answer:  # noqa: S310 - one of the two constants above
            return bool(answer.status == 200)
    except OSError:
        return False


def runs(program: str) -> bool:
    """Whether a process of this program runs in this container."""
    for entry in Path("/proc").glob("[0-9]*/comm"):
        try:
            if entry.read_text(encoding="ascii", errors="replace").strip() == program:
                return True
        except OSError:
            continue  # it has just ended
    return False


CHECKS = {
    "head": lambda: runs("gcs_server") and runs("raylet") and is_ready(PAGES),
    "dashboard": lambda: is_ready(PAGES),
    "worker": lambda: runs("raylet") and answers(os.environ.get("HALMA_HEAD", "head:6379")),
}

if __name__ == "__main__":
    sys.exit(0 if CHECKS[sys.argv[1]]() else 1)
