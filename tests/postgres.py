"""A throw-away PostgreSQL server on a Unix socket, for tests that need one."""

from __future__ import annotations

import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psycopg


class NoPostgres(Exception):
    """The server's programs are not installed."""


def programs() -> Path:
    """Folder with `initdb` and `postgres`, the newest version. Raises `NoPostgres`."""
    found = [Path(path).parent for path in [shutil.which("initdb")] if path]
    found += sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: int(path.parent.name))
    if not found or not (found[-1] / "initdb").exists():
        raise NoPostgres("expected initdb on the PATH or under /usr/lib/postgresql/*/bin; install postgresql")
    return found[-1]


@contextmanager
def running_server(*settings: str) -> Iterator[Server]:
    """A server of its own that ends with the block, data and all."""
    # Not pytest's folder: the server runs as another user, who may not look into it, and a socket's path is short.
    folder = Path(tempfile.mkdtemp(prefix="halma-pg-"))
    server = Server(folder, programs(), settings)
    try:
        server.create()
        server.start()
        yield server
    finally:
        server.stop(signal.SIGQUIT)  # at once, writing nothing more of what is deleted next
        shutil.rmtree(folder)


class Server:
    """A server that can be stopped and started again. It refuses root, so root runs it as the user `postgres`."""

    def __init__(self, folder: Path, binaries: Path, settings: tuple[str, ...]) -> None:
        self.folder = folder
        self._binaries = binaries
        # What a crash of the machine would do is the server's business; what a crash of a client does is ours.
        self._settings = ("fsync=off", "full_page_writes=off", "listen_addresses=", *settings)
        self._process: subprocess.Popen[bytes] | None = None
        self._user: dict[str, str | int] = {}
        if os.geteuid() == 0:
            account = pwd.getpwnam("postgres")
            self._user = {"user": account.pw_uid, "group": account.pw_gid}
            os.chown(folder, account.pw_uid, account.pw_gid)

    def create(self, *options: str) -> None:
        """Make the data folder; `options` are those of `initdb`."""
        command = [
            self._binaries / "initdb",
            "-D",
            self.folder / "data",
            "-U",
            "postgres",
            "-A",
            "trust",
            "-N",
            *options,
        ]
        done = subprocess.run(command, capture_output=True, cwd="/", check=False, **self._user)
        assert done.returncode == 0, done.stderr.decode()

    def start(self) -> None:
        """Start it and wait until it answers."""
        command = [self._binaries / "postgres", "-D", self.folder / "data", "-k", self.folder]
        for setting in self._settings:
            command += ["-c", setting]
        with (self.folder / "log").open("ab") as log:
            self._process = subprocess.Popen(command, stdout=log, stderr=log, cwd="/", **self._user)
        for _ in range(300):
            try:
                psycopg.connect(self.url("postgres")).close()
            except psycopg.OperationalError:
                assert self._process.poll() is None, (self.folder / "log").read_text()
                time.sleep(0.1)
            else:
                return
        raise AssertionError((self.folder / "log").read_text())

    def stop(self, how: signal.Signals = signal.SIGINT) -> None:
        """Stop it, ending its connections."""
        if self._process is not None:
            self._process.send_signal(how)
            self._process.wait(timeout=30)
            self._process = None

    @property
    def runs(self) -> bool:
        """Whether it has not ended by itself, as a server does whose disk is full."""
        return self._process is not None and self._process.poll() is None

    def url(self, database: str) -> str:
        """URL of a database on it."""
        return f"postgresql://postgres@/{database}?host={self.folder}"

    def new_database(self, name: str) -> str:
        """Make an empty database. Returns its URL."""
        with psycopg.connect(self.url("postgres"), autocommit=True) as connection:
            connection.execute(f'CREATE DATABASE "{name}"')
        return self.url(name)
