"""Studies as people run them, with Ray and all their processes, disturbed while they run.

One start of Ray serves many faults: worker, strategy and coordinator processes are replaced by the product itself;
after faults that take the driver or Ray along, the study is resumed in a new process, as a person would.
"""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import time
from collections import Counter
from pathlib import Path

import psycopg
from arena import NAME, Arena, wait_until
from invariants import what_counts
from processes import alive, family

PATIENCE = 90.0
"""Seconds after a fault in which a study must have gone on: leases are shortened to a tenth."""

LEASE = 3.0
"""A worker's lease in seconds, shortened like this."""


class Stuck(Exception):
    """A study did not go on after a fault."""


class RayGame:
    """One study, and the faults that it goes through.

    Args:
        arena: where; with leases a tenth as long as usual.
        rng: `numpy.random.Generator` of this game.
        expected: what the undisturbed study comes to, where one trial runs at a time.
        say: told each fault.
    """

    def __init__(self, arena: Arena, rng, expected=None, say=lambda _: None):
        self.arena, self.rng, self.expected, self.say = arena, rng, expected, say
        self.process = None
        self.faults, self.repeated, self.starts = Counter(), Counter(), 0
        self._left = set()

    # -- running ---------------------------------------------------------------------------------------------------

    def play(self, kinds, enough):
        """Disturb the study by these kinds in random order until `enough` faults have been or it has ended; judge."""
        try:
            while sum(self.faults.values()) < enough and not self.over():
                self._running()
                if self.wait_for_work(1 + int(self.rng.integers(0, 3))):
                    kind = str(self.rng.choice(kinds))
                    self._one(kind)
            return self.to_the_end()
        finally:
            self.clear_away()

    def _one(self, kind):
        self.arena.look()
        before = self._repeated()
        if not KINDS[kind](self):
            return
        self.faults[kind] += 1
        self.say(f"{kind} ({sum(self.faults.values())})")
        if not self.over():
            self._running()
            if not self.wait_for_work(2) and not self.over():
                raise Stuck(f"no iteration began within {PATIENCE:g} s of: {kind}\n{self.arena.said()[-3000:]}")
        self.repeated[kind] += self._repeated() - before

    def to_the_end(self):
        """Let the study come to its end, and judge it."""
        for _ in range(6):
            if self.over():
                break
            self._running()
            if wait_until(lambda: self.process.poll() is not None, 240) is None:
                raise Stuck(f"the study did not end\n{self.arena.said()[-3000:]}")
        wait_until(lambda: self.process is None or self.process.poll() is not None, 60)
        verdict = self.arena.judge()
        if self.expected is not None:
            same = what_counts(self.arena.record()) == self.expected
            verdict.expect(same, "the study is not what it would have been undisturbed")
        return verdict

    def over(self):
        """Whether the study has come to its end."""
        study = self.arena.record().study
        return study is not None and study["state"] == "complete"

    def _running(self):
        """See to it that somebody drives the study."""
        if self.process is not None and self.process.poll() is None:
            return
        if self.over():
            return
        self.clear_away()
        exists = self.arena.record().study is not None
        self.process = self.arena.command(*(("resume", NAME) if exists else ("run", str(self.arena.file))))
        self.starts += 1

    def wait_for_work(self, more):
        """Whether so many more iterations have begun, before the patience or the study was at its end."""
        had = self.arena.iterations_begun()

        def moved():
            if self.process.poll() is not None and not self.over():
                self._running()
            return self.arena.iterations_begun() >= had + more or self.over()

        return bool(wait_until(moved, PATIENCE)) and not self.over()

    def clear_away(self):
        """End what a killed command has left; a machine that lost its driver would be restarted."""
        if self.process is not None:
            self._left |= set(family(self.process.pid))
            self.process.poll()
        for pid in alive(self._left):
            send(pid, signal.SIGKILL)
        wait_until(lambda: not alive(self._left), 20)
        self._left = set()
        if self.process is not None:
            self.process.wait(timeout=20)

    def _repeated(self):
        begun = Counter(line.rsplit(" ", 1)[0] for line in self.arena.work.read_text().splitlines())
        return sum(count - 1 for count in begun.values())

    # -- whom it hits ----------------------------------------------------------------------------------------------

    def processes(self, title):
        """Process ids of this study's processes by (a part of) their command line."""
        self._left |= set(family(self.process.pid))
        return [pid for pid in family(self.process.pid) if title in command_line(pid)]

    def one_of(self, title):
        """One of them, or None."""
        found = self.processes(title)
        return None if not found else int(self.rng.choice(found))


def command_line(pid):
    """Of a process, with Ray's titles; empty where it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return ""


def send(pid, number):
    """Whether there was somebody to send a signal to."""
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return False
    return True


# -- the kinds of faults ---------------------------------------------------------------------------------------------


def killing(title):
    """SIGKILL for a process with this title."""

    def fault(game):
        pid = game.one_of(title)
        return pid is not None and send(pid, signal.SIGKILL)

    return fault


def stopping(title, seconds):
    """SIGSTOP for a process with this title, and SIGCONT after some seconds."""

    def fault(game):
        pid = game.one_of(title)
        if pid is None or not send(pid, signal.SIGSTOP):
            return False
        try:
            time.sleep(seconds)
        finally:
            send(pid, signal.SIGCONT)
        return True

    return fault


def kill_driver(game):
    """SIGKILL for the command; what it started may go on for a while, and the study is resumed at once."""
    game._left |= set(family(game.process.pid))
    game.process.kill()
    game.process.wait()
    exists = game.arena.record().study is not None
    end = time.monotonic() + PATIENCE
    while exists and time.monotonic() < end:
        # An orphaned coordinator may live for some seconds and drive on: the command then says so, and ends.
        game.process = game.arena.command("resume", NAME)
        game.starts += 1
        if wait_until(lambda: game.process.poll() is not None, 4) is None or game.over():
            return True
    return exists


def take_over(game):
    """A second command takes the study from the first, which lives and must be fenced off."""
    first = game.process
    game._left |= set(family(first.pid))
    game.process = game.arena.command("resume", NAME, "--take-over")
    game.starts += 1
    if wait_until(lambda: first.poll() is not None, PATIENCE) is None:
        raise Stuck("a driver that was fenced off did not end")
    return True


def stop_driver(game):
    """SIGSTOP and SIGCONT for the command."""
    send(game.process.pid, signal.SIGSTOP)
    time.sleep(1.0)
    return send(game.process.pid, signal.SIGCONT)


def kill_everybody(game):
    """SIGKILL for all processes of the study, as when the machine loses power."""
    for pid in family(game.process.pid):
        send(pid, signal.SIGKILL)
    game.process.wait()
    return True


def interrupt(game):
    """Ctrl-C."""
    game._left |= set(family(game.process.pid))
    game.process.send_signal(signal.SIGINT)
    if wait_until(lambda: game.process.poll() is not None, PATIENCE) is None:
        raise Stuck("a study did not stop when it was asked to")
    return True


def tear(change):
    """The newest checkpoint is torn (`truncate`) or altered (`flip`), and the worker that wrote it killed."""

    def fault(game):
        found = sorted(Path(game.arena.artifacts).glob("*/*/checkpoints/*.checkpoint"), key=_written)
        pid = game.one_of("ray::Worker")
        if not found or pid is None:
            return False
        send(pid, signal.SIGKILL)
        try:
            data = bytearray(found[-1].read_bytes())
        except FileNotFoundError:
            return True
        if change == "truncate":
            del data[len(data) // 2 :]
        else:
            data[len(data) // 2] ^= 0x10
        found[-1].write_bytes(bytes(data))
        return True

    return fault


def _written(path):
    try:
        return path.stat().st_mtime_ns
    except FileNotFoundError:
        return 0


def restart_postgres(game):
    """The database server is killed and comes back after a while."""
    game.arena.postgres.stop(signal.SIGQUIT)
    time.sleep(float(game.rng.uniform(0.2, 2.0)))
    game.arena.postgres.start()
    return True


def cut_connections(game):
    """All connections to the database are cut by the server."""
    name = game.arena.database.rpartition("/")[2].partition("?")[0]
    with psycopg.connect(game.arena.postgres.url("postgres"), autocommit=True) as connection:
        cut = connection.execute(
            "SELECT count(pg_terminate_backend(pid)) FROM pg_stat_activity WHERE datname = %s", (name,)
        ).fetchone()[0]
    return cut > 0


def commit_point(when):
    """SIGKILL for the coordinator right before or after one of its next commits."""

    def fault(game):
        had = game.arena.spare()
        place = int(game.rng.integers(1, 6))
        game.arena.intend(point="commit", when=when, do="kill", n=[place], workers_only=True)
        wait_until(lambda: not game.arena.plan.exists() or game.over(), 20)
        return game.arena.spare() > had

    return fault


def rename_point(when):
    """SIGKILL for a worker right before or after a file appears under its name."""

    def fault(game):
        had = game.arena.spare()
        game.arena.intend(point="rename", when=when, do="kill", n=[int(game.rng.integers(1, 4))])
        wait_until(lambda: not game.arena.plan.exists() or game.over(), 20)
        return game.arena.spare() > had

    return fault


def fill(which):
    """The disk of the artifacts or of the database is full for a while."""

    def fault(game):
        folder = Path(game.arena.artifacts if which == "artifacts" else game.arena.database).parent
        ballast = folder / "ballast"
        with ballast.open("wb", buffering=0) as file:  # a buffer would fail once more when it is closed
            try:
                while True:
                    file.write(b"\0" * 4096)
            except OSError as error:
                if error.errno != errno.ENOSPC:
                    raise
        time.sleep(float(game.rng.uniform(0.5, 2.0)))
        ballast.unlink()
        return True

    return fault


def jump_clock(game):
    """The wall clock of every process jumps, by up to a day to and fro."""
    game.arena.clock.write_text(f"{int(game.rng.integers(-86400, 86400)):+d}\n")
    time.sleep(0.3)
    return True


KINDS = {
    "worker killed": killing("ray::Worker"),
    "worker killed before a file appears": rename_point("before"),
    "worker killed after a file appeared": rename_point("after"),
    "worker stopped for a moment": stopping("ray::Worker", 0.5),
    "worker stopped beyond its lease": stopping("ray::Worker", 2 * LEASE),
    "strategy killed": killing("ray::StrategyActor"),
    "strategy stopped": stopping("ray::StrategyActor", 1.0),
    "coordinator killed": killing("ray::CoordinatorActor"),
    "coordinator killed before a commit": commit_point("before"),
    "coordinator killed after a commit": commit_point("after"),
    "coordinator stopped for a moment": stopping("ray::CoordinatorActor", 0.5),
    "coordinator stopped beyond leases": stopping("ray::CoordinatorActor", 2 * LEASE),
    "raylet killed": killing("/raylet/raylet"),
    "raylet stopped": stopping("/raylet/raylet", 2.0),
    "gcs killed": killing("/gcs/gcs_server"),
    "gcs stopped": stopping("/gcs/gcs_server", 2.0),
    "driver killed": kill_driver,
    "driver stopped": stop_driver,
    "driver interrupted": interrupt,
    "study taken over": take_over,
    "everybody killed": kill_everybody,
    "checkpoint torn": tear("truncate"),
    "checkpoint altered": tear("flip"),
    "database server restarted": restart_postgres,
    "database connections cut": cut_connections,
    "disk of artifacts full": fill("artifacts"),
    "disk of database full": fill("database"),
    "clock jumps": jump_clock,
}


class SmallDisk:
    """A file system of its own, so small that it can be filled; needs root."""

    def __init__(self, folder, megabytes):
        self.folder = Path(folder)
        self._size = megabytes

    def __enter__(self):
        self.folder.mkdir(parents=True)
        options = ["-t", "tmpfs", "-o", f"size={self._size}m", "tmpfs", str(self.folder)]
        subprocess.run(["mount", *options], check=True)
        return self.folder

    def __exit__(self, *_):
        subprocess.run(["umount", "--lazy", str(self.folder)], check=True)
