"""Who drives a study, and whether a driver of this machine still lives."""

from __future__ import annotations

import os
import socket
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from services.store.port import Driver, Store, StudyRow

LEASE_SECONDS = 15.0
"""A driver on another host whose beat has not moved for so long counts as dead."""


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


def driving_words(row: StudyRow) -> str:
    """Who drives a study, where, since when: `process 41 on here, since 2026-11-25 17:40:11 UTC`."""
    driver = row.driver
    if driver is None:
        return "nobody"
    since = "" if row.driven_since is None else f", since {row.driven_since.strftime('%Y-%m-%d %H:%M:%S')} UTC"
    return f"process {driver.pid} on {driver.host}{since}"


@dataclass(slots=True)
class DriverWatch:
    """Tells whether drivers are gone: seen at once on this host, by their still beat on another.

    Args:
        store: the trial database.
        clock: monotonic seconds of this process; no clock of another machine counts.
        sleep: waits some seconds.
    """

    store: Store
    clock: Callable[[], float]
    sleep: Callable[[float], None]
    _watched: dict[int, tuple[tuple[int, int], float]] = field(default_factory=dict)

    def is_dead(self, name: str) -> bool:
        """Whether a study's driver is gone, watching for as long as it takes."""
        while True:
            row = self.store.study(name)
            dead = self.looks_dead(row)
            if dead is not None:
                return dead
            self.sleep(0.2)

    def looks_dead(self, row: StudyRow) -> bool | None:
        """Whether a study's driver is gone; None while its beat has to be watched for longer."""
        if row.driver is None:
            return False
        alive = lives(row.driver)
        if alive is not None:
            return not alive
        now = self.clock()
        beat = (row.drive_token, row.drive_beat)
        watched = self._watched.get(row.id)
        if watched is None or watched[0][0] != row.drive_token:
            self._watched[row.id] = (beat, now)
            return None
        if watched[0] != beat:
            self._watched[row.id] = (beat, now)
            return False
        return True if now - watched[1] > LEASE_SECONDS else None
