"""The command in processes of its own: interrupted, killed, and in front of a running service."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from services.states import StudyState
from services.store.open import open_store

ROOT = Path(__file__).parents[3]
HALMA = "from services.cli import main; main()"
SERVICE = """
import contextlib
from services.serving import serve
from services.settings import find_settings
serve(find_settings(), start_coordinator=contextlib.nullcontext, say=print, port=0)
"""
LATE = """
import os, signal
from services import cli

set_handler = signal.signal

def late(number, handler):
    if handler is signal.SIG_IGN:
        os.kill(os.getpid(), signal.SIGTERM)
    return set_handler(number, handler)

signal.signal = late
cli.main()
"""
"""A command that is asked to end when it is about to, of its own."""
PATIENCE = 120.0
"""Seconds. A busy machine takes its time to start Python."""


def start(code, *arguments):
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{Path(__file__).parent}", "PYTHONUNBUFFERED": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )


def wait_for(condition):
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        if found := condition():
            return found
        time.sleep(0.05)
    pytest.fail("waited in vain")


@pytest.fixture(params=[12])
def slow_run(request, shell, hill):
    """`halma run` on so many trials that take 0.2 s each, with at least two of them finished."""
    shell.write("slow.yaml", hill.replace(":hill", ":trek").replace("trials: 4", f"trials: {request.param}"))
    process = start(HALMA, "run", "slow.yaml", "--inline")
    store = None
    try:
        wait_for(lambda: (shell.home / "halma.db").exists() and "hill" in shell.study_names())
        store = open_store(shell.home / "halma.db")
        wait_for(lambda: store.study("hill").counts.get("complete", 0) >= 2)
        yield process
    finally:
        if store is not None:
            store.close()
        process.kill()
        process.communicate()


def finished_trials(shell):
    return [trial for trial in shell("trials", "hill", "--json").json if trial["state"] == "complete"]


def test_ctrl_c_exits_with_130_and_says_how_to_go_on(shell, slow_run):
    slow_run.send_signal(signal.SIGINT)
    _, err = slow_run.communicate(timeout=PATIENCE)
    assert slow_run.returncode == 130
    assert err == "Interrupted; nothing that was finished is lost. Go on: halma resume hill\n"
    before = finished_trials(shell)
    assert shell("show", "hill", "--json").json["state"] == "paused"
    assert shell("run", "slow.yaml", "--inline").code == 0
    after = finished_trials(shell)
    assert after[: len(before)] == before
    assert len(after) == 12


def test_ctrl_c_when_all_is_said_changes_nothing():
    process = start(LATE, "--version")
    out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, err) == (0, "")
    assert out.startswith("halma ")


@pytest.mark.parametrize("pause", [0.02, 0.2, 0.4])
def test_ctrl_c_twice_ends_at_once_and_loses_nothing(shell, slow_run, pause):
    # Where the second one falls depends on the machine: before the next checkpoint, or while the command is leaving.
    slow_run.send_signal(signal.SIGINT)
    time.sleep(pause)
    slow_run.send_signal(signal.SIGTERM)
    _, err = slow_run.communicate(timeout=PATIENCE)
    assert slow_run.returncode == 130
    assert err in {
        "Interrupted at once; what had finished is on record. Go on: halma resume hill\n",
        "Interrupted; nothing that was finished is lost. Go on: halma resume hill\n",  # it was just about to end
    }
    before = finished_trials(shell)
    assert shell("resume", "hill", "--inline").code == 0
    after = finished_trials(shell)
    assert after[: len(before)] == before
    assert len(after) == 12


def test_a_killed_run_is_resumed_and_nothing_finished_is_run_twice(shell, slow_run):
    slow_run.kill()
    slow_run.communicate()
    before = finished_trials(shell)
    assert shell("show", "hill", "--json").json["state"] == "running", "nobody could say that it ended"
    typed = shell("resume", "hill", "--inline")
    assert typed.code == 0, typed.err
    after = finished_trials(shell)
    assert after[: len(before)] == before
    assert [trial["number"] for trial in after] == list(range(12))
    assert [trial["attempts"] for trial in before] == [1] * len(before)


@pytest.mark.parametrize("slow_run", [1000], indirect=True, ids=["long"])
def test_a_second_resume_says_who_drives_and_take_over_fences_the_first_off(shell, slow_run):
    refused = shell("resume", "hill", "--inline")
    assert (refused.code, refused.out) == (2, "")
    assert re.fullmatch(
        r"study 'hill': expected that nobody drives it, "
        rf"found process {slow_run.pid} on {re.escape(socket.gethostname())}, "
        r"since \d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC; follow it: halma watch hill; stop it: halma pause hill; "
        r"or take it over: halma resume hill --take-over\n",
        refused.err,
    )
    before = finished_trials(shell)
    second = start(HALMA, "resume", "hill", "--inline", "--take-over")
    try:
        _, said = slow_run.communicate(timeout=PATIENCE)
        assert slow_run.returncode == 1
        assert re.match(rf"Study hill was taken over by process {second.pid} on .*; this process has stopped", said)
        handed_over = len(finished_trials(shell))
        wait_for(lambda: len(finished_trials(shell)) > handed_over + 2)
        second.send_signal(signal.SIGTERM)
        _, err = second.communicate(timeout=PATIENCE)
    finally:
        second.kill()
    assert second.returncode == 130, "SIGTERM is the same as Ctrl-C"
    assert err == "Interrupted; nothing that was finished is lost. Go on: halma resume hill\n"
    after = finished_trials(shell)
    assert after[: len(before)] == before
    store = open_store(shell.home / "halma.db")
    events = store.events(study_id=store.study("hill").id, limit=100_000)
    store.close()
    assert [event.payload["pid"] for event in events if event.kind == "driven"] == [slow_run.pid, second.pid]
    assert [event.payload["reason"] for event in events if event.kind in {"driver_fenced", "refused"}], (
        "what the first one still wanted to write was refused, or it saw that it was fenced; and that is on record"
    )
    finished = [event.trial for event in events if event.kind == "finished"]
    assert sorted(finished) == [trial["number"] for trial in after], "no trial ended twice"


@pytest.fixture
def service(shell):
    """A service without a coordinator: it takes studies, nobody runs them."""
    process = start(SERVICE)
    try:
        wait_for(lambda: (shell.home / "server.json").exists() or process.poll() is not None)
        assert process.poll() is None, process.communicate()[1]
        yield json.loads((shell.home / "server.json").read_text(encoding="utf-8"))["url"]
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE)


def test_a_study_is_submitted_to_the_service_of_this_home(shell, hill, service):
    typed = shell("submit", "hill.yaml", "--name", "sent")
    assert (typed.code, typed.out) == (0, f"Submitted sent to {service}. Follow it: halma watch sent\n")
    assert shell.study_names() == ["sent"]
    assert shell("show", "sent", "--json").json["spec"]["seed"] == 7

    again = shell("submit", "hill.yaml", "--name", "sent")
    assert again.code == 2
    assert again.err.startswith(
        '--set name="sent": name: expected the name of a new study, found sent, which exists; '
        "look at it with `halma show sent`, go on with `halma resume sent`"
    )

    shell.write("a.yaml", hill.replace("random", "radnom"))
    refused = shell("submit", "a.yaml")
    assert refused.code == 2
    assert refused.err.startswith("a.yaml:8: search.strategy: expected a strategy among random, ")
    assert shell.study_names() == ["sent"]

    resumed = shell("resume", "sent")
    assert resumed.out == f"The service at {service} goes on with sent. Follow it: halma watch sent\n"
    assert StudyState(shell("show", "sent", "--json").json["state"]) is StudyState.QUEUED


def test_a_port_in_use_is_bad_input(shell):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        typed = shell("serve", "--port", str(port))
    assert (typed.code, typed.out) == (2, "")
    assert typed.err == (
        f"--port {port}: expected a free port on 127.0.0.1, found it used by another program; "
        f"find it with `ss -ltnp '( sport = :{port} )'`, or take another (--port)\n"
    )
    assert shell.study_names() == []


@pytest.mark.parametrize("pool", ["gpu", "gpu=0", "gpu=x", "=2"])
def test_a_pool_that_is_none_is_bad_input(shell, pool):
    typed = shell("serve", "--pool", pool)
    assert (typed.code, typed.err) == (2, f"--pool: expected NAME=CORES such as default=4, found {pool}\n")


def test_a_reader_that_goes_away_leaves_no_traceback(shell, hill):
    assert shell("run", "hill.yaml", "--inline").code == 0
    process = start(HALMA, "trials", "hill", "--json")
    process.stdout.close()
    _, err = process.communicate(timeout=PATIENCE)
    assert "Traceback" not in err
