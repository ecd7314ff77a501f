"""Hosts on one machine: each a network, a process table and a name of its own, with a Ray of its own; needs root.

A host that is killed is gone at once with all its processes, as when it loses power. A host that is cut off loses what
is sent to it and hears of nothing: no connection is refused or reset.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from arena import wait_until

PORT = 6399
HEALTH = {"period_ms": 2000, "timeout_ms": 2000, "failure_threshold": 4, "initial_delay_ms": 2000}
"""How Ray finds out that a host is gone, in 10 s rather than 25."""

STARTING = """
mount -t tmpfs tmpfs /dev/shm && mount -t tmpfs tmpfs "$1" && mount -t tmpfs tmpfs "$2" || exit
hostname "$3"; shift 3; exec "$@"
"""
"""What a worker's host does first: no memory, no session and no study folder is shared with the others."""


def ip(*words):
    """The command `ip`, loudly where it fails."""
    done = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, (words, done.stderr)


class Network:
    """A switch and the hosts on it.

    Args:
        folder: for logs.
        environment: of every process of the hosts.
        hidden: a folder that workers' hosts must not see.
    """

    def __init__(self, folder, environment, hidden):
        self._folder, self._hidden = Path(folder), Path(hidden)
        self._tag = f"h{secrets.token_hex(2)}"
        self._switch = f"{self._tag}switch"
        # Of its own: in the usual place, `ray start` leaves word of itself to every Ray program of this machine. And
        # short: there are sockets in it.
        self._rays = Path(f"/tmp/{self._tag}")
        self._made, self._next, self._running = [], 1, {}
        self.workers = set()
        health = {f"RAY_health_check_{name}": str(value) for name, value in HEALTH.items()}
        self.environment = {
            **environment, **health, "RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "token",
            "RAY_AUTH_TOKEN": secrets.token_hex(32),
        }  # fmt: skip

    def __enter__(self):
        self._rays.mkdir()
        ip("netns", "add", self._switch)
        ip("-n", self._switch, "link", "add", "bridge", "type", "bridge")
        ip("-n", self._switch, "link", "set", "bridge", "up")
        return self

    def __exit__(self, *_):
        for host in list(self._running):
            self.kill(host)
        for name in [*self._made, self._switch]:
            subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)
        shutil.rmtree(self._rays, ignore_errors=True)

    def add(self):
        """A further host, without anything on it. Returns its name."""
        number, self._next = self._next, self._next + 1
        host = f"{self._tag}n{number}"
        ip("netns", "add", host)
        self._made.append(host)
        ip("-n", self._switch, "link", "add", f"port{number}", "type", "veth", "peer", "name", "eth0", "netns", host)
        ip("-n", self._switch, "link", "set", f"port{number}", "master", "bridge", "up")
        ip("-n", host, "address", "add", f"10.77.0.{number}/24", "dev", "eth0")
        ip("-n", host, "link", "set", "eth0", "up")
        ip("-n", host, "link", "set", "lo", "up")
        return host

    @staticmethod
    def _number(host):
        return host.rpartition("n")[2]

    def address(self, host):
        """Its network address."""
        return f"10.77.0.{self._number(host)}"

    def inside(self, host):
        """What a command on a host is run by."""
        return ("ip", "netns", "exec", host)

    def cut(self, host):
        """Unplug a host: packets are lost, nobody is told."""
        ip("-n", self._switch, "link", "set", f"port{self._number(host)}", "nomaster")

    def heal(self, host):
        """Plug it in again."""
        ip("-n", self._switch, "link", "set", f"port{self._number(host)}", "master", "bridge")

    # -- Ray on the hosts ------------------------------------------------------------------------------------------

    def start_head(self, host):
        """Ray's head, with no core of its own for trainings."""
        # Where the one before it was killed, this says that it still runs.
        (self._rays / "ray_current_cluster").unlink(missing_ok=True)
        self._start(
            host, ["--head", f"--port={PORT}", "--include-dashboard=false", "--num-cpus=0", f"--temp-dir={self._rays}"]
        )

    def start_worker(self, host, head):
        """A host that joins, with one core, which sees nothing of the head's files."""
        self.workers.add(host)
        alone = ("unshare", "--uts", "--pid", "--mount", "--fork", "--kill-child", "--mount-proc")
        first = ("sh", "-c", STARTING, "host", str(self._hidden), str(self._rays), host)
        self._start(host, [f"--address={self.address(head)}:{PORT}", "--num-cpus=1"], (*alone, *first))

    def _start(self, host, options, first=()):
        command = [
            *self.inside(host), *first, sys.executable, "-m", "ray.scripts.scripts", "start", "--block",
            f"--node-ip-address={self.address(host)}", "--object-store-memory=80000000", *options,
        ]  # fmt: skip
        with (self._folder / f"{host}.log").open("ab") as log:
            self._running[host] = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True, cwd="/",
                env={**os.environ, **self.environment},
            )  # fmt: skip

    def pid(self, host):
        """Of the process that a host's Ray was started as."""
        return self._running[host].pid

    def is_up(self, host):
        """Whether a host's Ray has not ended by itself."""
        return host in self._running and self._running[host].poll() is None

    def kill(self, host):
        """The host loses power."""
        process = self._running.pop(host, None)
        if process is None:
            return
        for pid in [process.pid, *self._pids(host)]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.wait()
        wait_until(lambda: not self._pids(host), 20)

    @staticmethod
    def _pids(host):
        done = subprocess.run(["ip", "netns", "pids", host], capture_output=True, text=True, check=True)
        return [int(pid) for pid in done.stdout.split()]
