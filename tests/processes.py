"""The command as people run it: a process of its own, a home of its own."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
START = "import sys; sys.argv[0] = 'halma'; from services.cli import main; main()"


class Home:
    """A halma home in a folder, and the command on it."""

    def __init__(self, folder):
        self.folder = folder
        self.env = {**os.environ, "HALMA_HOME": str(folder), "PYTHONPATH": str(ROOT), "COLUMNS": "200"}
        self.env.pop("HALMA_DB", None)

    def start(self, *arguments):
        return subprocess.Popen(
            [sys.executable, "-c", START, *arguments],
            env=self.env,
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def run(self, *arguments, expect=0):
        process = self.start(*arguments)
        output, _ = process.communicate(timeout=900)
        assert process.returncode == expect, output
        return output

    def trials(self, study):
        return json.loads(self.run("trials", study, "--json"))

    def write(self, name, text):
        path = self.folder / name
        path.write_text(text, encoding="utf-8")
        return str(path)


def family(pid):
    """A process and all its descendants."""
    children = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has just ended
        if fields[0] != "Z":
            children.setdefault(int(fields[1]), []).append(int(entry.parent.name))
    found, new = [], [pid]
    while new:
        found += new
        new = [child for parent in new for child in children.get(parent, [])]
    return found


def alive(pids):
    """Those that still run; a zombie has ended."""
    left = []
    for pid in pids:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            continue
        if state != "Z":
            left.append(pid)
    return left


def kill_all(pids):
    for pid in pids:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue  # an earlier one took it along


def wait_for(condition, seconds=400, every=0.1):
    """Wait until something is so; fails loudly where it never is."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(every)
    raise AssertionError(f"it was not so within {seconds} s")
