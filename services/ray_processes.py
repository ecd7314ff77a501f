"""The processes of a Ray that was started here, watched: without them a run would stand still and say nothing.

Ray itself notices that its own processes are gone after a minute or more, and then aborts the whole process.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ESSENTIAL = ("gcs_server", "raylet")
"""Names of the processes without which nothing goes on."""

LOOK_SECONDS = 2.0
"""How often the family is looked at. Reading the process table takes some milliseconds."""


@dataclass(slots=True)
class LocalRay:
    """The processes that a local Ray has started, this process being their parent.

    Args:
        essential: process id and name of those that must live.
        ended: whether they have been ended by force.
    """

    essential: dict[int, str]
    ended: bool = False
    _family: set[int] = field(default_factory=set)
    _due: float = 0.0

    @classmethod
    def of_this_process(cls) -> LocalRay:
        """Those that live now."""
        names = {pid: _name(pid) for pid in _descendants(os.getpid())}
        return cls({pid: name for pid, name in names.items() if name in ESSENTIAL})

    def lost(self) -> str:
        """Which of the essential processes has ended, in words; empty while all live."""
        gone = [f"{name} (process {pid})" for pid, name in self.essential.items() if _name(pid) != name]
        now = time.monotonic()
        if not gone and now >= self._due:
            self._due = now + LOOK_SECONDS
            self._family |= set(_descendants(os.getpid()))
        return " and ".join(gone)

    def end(self, exit_code: int) -> None:
        """End all of it by force, and let this process exit without asking it: it would wait for what is gone."""
        self.ended = True
        for pid in {*self._family, *_descendants(os.getpid())}:
            if _name(pid) == "" or not _is_rays(pid):
                continue  # it has ended, and its number may be somebody else's by now
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        # Of the functions that run at the exit the last one registered comes first: before Ray's own.
        atexit.register(_leave, exit_code)


def _leave(exit_code: int) -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(exit_code)


def _descendants(of: int) -> Iterator[int]:
    """Processes that a process has started, and those that these have."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, IndexError):  # it has just ended
            parent = int(entry.read_text("ascii", "replace").rpartition(")")[2].split()[1])
            children.setdefault(parent, []).append(int(entry.parent.name))
    new = children.get(of, [])
    while new:
        yield from new
        new = [child for pid in new for child in children.get(pid, [])]


def _name(pid: int) -> str:
    """Name of a process that lives; empty where it has ended, be it reaped or not."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text("ascii", "replace")
    except OSError:
        return ""
    head, _, tail = stat.rpartition(")")
    return "" if tail.split()[0] == "Z" else head.partition("(")[2]


def _is_rays(pid: int) -> bool:
    """Whether a process is one of Ray's, by how it was started."""
    try:
        started = Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False
    return b"ray" in started
