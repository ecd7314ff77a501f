"""What a study is disturbed with that isn't a process: file systems that are full, a wall clock that jumps."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import struct
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

from postgres import Server, programs

HERE = Path(__file__).resolve().parent


class SmallDisk:
    """A file system of its own, so small that it can be filled; needs root."""

    def __init__(self, folder, megabytes):
        self.folder = Path(folder)
        self._size = megabytes

    def __enter__(self):
        self.folder.mkdir(parents=True)
        options = ["-t", "tmpfs", "-o", f"size={self._size}m,mode=755", "tmpfs", str(self.folder)]
        subprocess.run(["mount", *options], check=True)
        return self.folder

    def __exit__(self, *_):
        subprocess.run(["umount", "--lazy", str(self.folder)], check=True)


def fill_disk(folder, seconds):
    """Fill a file system to its last block, for so long."""
    ballast = Path(folder) / "ballast"
    with ballast.open("wb", buffering=0) as file:  # a buffer would fail once more when it is closed
        for size in (2**20, 4096, 1):
            try:
                while file.write(b"\0" * size):
                    pass
            except OSError as error:
                if error.errno != errno.ENOSPC:
                    raise
    time.sleep(seconds)
    ballast.unlink()


@contextmanager
def server_on_small_disk(folder):
    """A PostgreSQL server whose disk can be filled; small segments, so that a little is enough."""
    # Another user runs the server, and may not look into folders of ours.
    with SmallDisk(f"/tmp/halma-pg-{os.getpid()}-{Path(folder).name}", 96) as disk:
        server = Server(disk, programs(), ("max_wal_size=4MB", "min_wal_size=2MB", "fsync=on"))
        server.create("--wal-segsize=1")
        server.start()
        try:
            yield server
        finally:
            server.stop(signal.SIGQUIT)
    shutil.rmtree(disk)


class FalseClock:
    """The wall clock as the processes of an arena see it; see `false_clock.c`."""

    def __init__(self, folder):
        self._file = Path(folder) / "clock"
        self._library = Path(folder) / "false_clock.so"
        self.set(0)
        command = ["cc", "-shared", "-fPIC", "-O2", "-o", str(self._library), str(HERE / "false_clock.c"), "-ldl"]
        subprocess.run([*command, "-lpthread"], check=True)

    @property
    def environment(self):
        """What a process needs to see it."""
        return {"LD_PRELOAD": str(self._library), "HALMA_FALSE_CLOCK": str(self._file)}

    def set(self, seconds):
        """Let the clock jump to so many seconds before or after the true time."""
        with self._file.open("r+b" if self._file.exists() else "xb") as file:
            file.write(struct.pack("q", seconds))
