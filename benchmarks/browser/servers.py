"""The two servers that are measured, each in a process of its own, and what a process costs."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import httpx

TOKEN = "a-token-for-benchmarks"
TICKS = os.sysconf("SC_CLK_TCK")
PATIENCE = 120.0
"""Seconds a server may take to start on a machine that is busy."""
HALMA = """
import sys, uvicorn
from dashboards.app import create_app
from services.artifacts.open import open_artifacts
from services.store.open import open_store
folder, port, token = sys.argv[1:]
app = create_app(open_store(folder + "/halma.db"), open_artifacts(folder + "/artifacts"), token=token)
uvicorn.run(
    app, host="127.0.0.1", port=int(port), log_level="warning", ws="websockets-sansio", ws_per_message_deflate=False
)
"""


@dataclass(frozen=True)
class Server:
    """A server that runs.

    Args:
        url: where it answers.
        pid: its process.
    """

    url: str
    pid: int

    def cpu_seconds(self) -> float:
        """CPU time so far."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / TICKS

    def memory(self) -> float:
        """Resident memory, MB."""
        return int(Path(f"/proc/{self.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@contextlib.contextmanager
def running(command: Sequence[str], port: int, path: str) -> Iterator[Server]:
    """A server from the start of its process until the block ends."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    server = Server(f"http://127.0.0.1:{port}", process.pid)
    try:
        end = time.monotonic() + PATIENCE
        while True:
            with contextlib.suppress(httpx.HTTPError):
                if httpx.get(server.url + path).status_code == 200:
                    break
            if process.poll() is not None or time.monotonic() > end:
                raise RuntimeError(f"{' '.join(command[:3])} ... does not answer at {server.url}{path}")
            time.sleep(0.1)
        yield server
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def halma(folder: Path) -> contextlib.AbstractContextManager[Server]:
    """Our own, over the database in a folder."""
    port = free_port()
    return running([sys.executable, "-c", HALMA, str(folder), str(port), TOKEN], port, "/healthz")


def optuna_dashboard(database: Path) -> contextlib.AbstractContextManager[Server]:
    """optuna-dashboard over an Optuna database, as its command starts it."""
    port = free_port()
    command = str(Path(sys.executable).parent / "optuna-dashboard")
    return running([command, f"sqlite:///{database}", "--port", str(port), "--quiet"], port, "/dashboard")
