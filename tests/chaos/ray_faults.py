"""The kinds of faults that a study with Ray goes through: functions of a game that tell whether it happened."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from urllib.parse import urlsplit

import psycopg
from arena import NAME, wait_until
from places import fill_disk
from processes import family

PATIENCE = 90.0
"""Seconds after a fault in which a study must have gone on: leases are shortened to a tenth."""

LEASE = 3.0
"""A worker's lease in seconds, shortened like this."""


class Stuck(Exception):
    """A study did not go on after a fault."""


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
        game.process = game.start_command("resume", NAME)
        game.starts += 1
        if wait_until(lambda: game.process.poll() is not None, 4) is None or game.over():
            return True
    return exists


def take_over(game):
    """A second command takes the study from the first, which lives and must be fenced off."""
    first = game.process
    game._left |= set(family(first.pid))
    game.process = game.start_command("resume", NAME, "--take-over")
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


def asking(number):
    """Ctrl-C or SIGTERM for the command, which must end in time."""

    def fault(game):
        game._left |= set(family(game.process.pid))
        game.process.send_signal(number)
        if wait_until(lambda: game.process.poll() is not None, PATIENCE) is None:
            raise Stuck("a study did not stop when it was asked to")
        return True

    return fault


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
        game.marks.move(game.arena.iterations_begun(), torn=int(found[-1].parts[-3]))
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
    # Before its query, which may hold the path of a socket.
    name = urlsplit(game.arena.database).path.lstrip("/")
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
        game.marks.move(game.arena.iterations_begun())
        return game.arena.spare() > had

    return fault


def rename_point(when):
    """SIGKILL for a worker right before or after a file appears under its name."""

    def fault(game):
        had = game.arena.spare()
        game.arena.intend(point="rename", when=when, do="kill", n=[int(game.rng.integers(1, 4))])
        wait_until(lambda: not game.arena.plan.exists() or game.over(), 20)
        game.marks.move(game.arena.iterations_begun())
        return game.arena.spare() > had

    return fault


def fill(which):
    """The disk of the artifacts or of the database is full for a while."""

    def fault(game):
        server, seconds = game.arena.postgres, float(game.rng.uniform(0.5, 2.0))
        if which == "artifacts":
            fill_disk(Path(game.arena.artifacts).parent, seconds)
            return True
        had = _times_away(game)
        if server is None:
            fill_disk(Path(game.arena.database).parent, seconds + 1.0)
        else:
            fill_disk(server.folder, seconds + 1.0)
            if not server.runs:
                server.start()  # it ended over it, as servers do; whoever runs one has it started again
        # Room that was there already may have sufficed for so long.
        return bool(wait_until(lambda: _times_away(game) > had or game.over(), 15)) and _times_away(game) > had

    return fault


def _times_away(game):
    return game.arena.record().times_away


def jump_clock(game):
    """The wall clock of every process jumps, by up to a day to and fro."""
    game.arena.clock.set(int(game.rng.integers(-86400, 86400)))
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
    "driver interrupted": asking(signal.SIGINT),
    "driver terminated": asking(signal.SIGTERM),
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
