"""Many real processes of the command, cheaply: one process imports everything and forks for each.

What a fork runs is the command itself (`services.cli.run_command`) with the arguments and the environment it was
given; it can be killed, stopped and waited for as any process. Started with `python forks.py`, told in JSON lines.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

WHOLE = (
    "torch", "optuna", "alembic.command", "services.cli.app", "services.running", "services.spec_check",
    "services.store.migrations", "search.registry", "search.baselines.optuna", "workers.run",
)  # fmt: skip
"""What a command imports on its way, so that forks have it."""

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]


class Forks:
    """The other end: starts the forking process and asks it for commands.

    Args:
        folder: where it runs.
        environment: what it is given beside ours.
    """

    def __init__(self, folder, **environment):
        path = os.pathsep.join([str(HERE / "hooks"), str(HERE), str(ROOT)])
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__))],
            env={**os.environ, "HALMA_CHAOS_PLAN": "", "PYTHONPATH": path, **environment},
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def start(self, *arguments, output, **environment):
        """Start the command; returns its process id."""
        return self._ask({"start": arguments, "output": str(output), "environment": environment})

    def wait(self, pid, seconds=120.0):
        """Exit status of a command, negative for a signal; None where it has not ended in time."""
        end = time.monotonic() + seconds
        while True:
            status = self._ask({"poll": pid})
            if status is not None or time.monotonic() > end:
                return status
            time.sleep(0.01)

    def close(self):
        self._process.stdin.close()
        self._process.wait(timeout=30)
        self._process.stdout.close()

    def _ask(self, request):
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        assert answer, "the forking process has ended"
        return json.loads(answer)


def serve():
    """Be the forking process."""
    for name in WHOLE:
        importlib.import_module(name)

    answers = os.fdopen(os.dup(1), "w", buffering=1)
    ended = {}
    for line in sys.stdin:
        request = json.loads(line)
        if "start" in request:
            pid = os.fork()
            if pid == 0:
                _become(request)
            answers.write(f"{pid}\n")
        else:
            pid = request["poll"]
            if pid not in ended:
                found, status = os.waitpid(pid, os.WNOHANG)
                if found:
                    ended[pid] = os.waitstatus_to_exitcode(status)
            answers.write(json.dumps(ended.get(pid)) + "\n")


def _become(request):
    os.setsid()
    output = os.open(request["output"], os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.environ.update(request["environment"])
    from services.cli import run_command

    code = 1
    try:
        code = run_command(request["start"])
    except BaseException:  # noqa: BLE001 - a bug of the product: its traceback belongs into the output
        import traceback

        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    serve()
