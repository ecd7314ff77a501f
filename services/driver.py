"""Who drives a study, and whether a driver of this machine still lives."""

from __future__ import annotations

import os
import socket
import uuid
from pathlib import Path

from services.store.port import Driver


def _start_time(pid: int) -> str:
    """Start time of a process in clock ticks since boot, as Linux tells it; empty where it can't be known."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
    # The command name is in parentheses and may itself hold spaces and parentheses; fields count from behind it.
    return stat.rpartition(")")[2].split()[19]


def _is_zombie(pid: int) -> bool:
    """Whether the process has ended and only waits to be reaped: it can't write any more."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] == "Z"


def this_process() -> Driver:
    """A driver identity for this process, new at each call: two drives of one process are two drivers."""
    pid = os.getpid()
    return Driver(id=uuid.uuid4().hex, host=socket.gethostname(), pid=pid, started=_start_time(pid))


def lives(driver: Driver) -> bool | None:
    """Whether a driver's process lives: True or False on this host, None where it can't be seen from here."""
    if driver.host != socket.gethostname():
        return None
    try:
        os.kill(driver.pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    if _is_zombie(driver.pid):
        return False
    started = _start_time(driver.pid)
    return not (driver.started and started) or driver.started == started
