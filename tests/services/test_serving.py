"""The service's port, its announcement, and how it ends."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys

import httpx
import pytest

from services.errors import BadInput
from services.serving import announced, base_url, is_loopback, listening, load_factory, serve
from services.settings import find_settings

SCRIPT = """
from contextlib import contextmanager
from services.serving import serve
from services.settings import find_settings

def say(text):
    print(text, flush=True)

@contextmanager
def coordinator():
    say("coordinator up")
    yield
    say("coordinator down")

serve(find_settings(), start_coordinator=coordinator, say=say, port=0)
"""


@pytest.fixture
def settings(tmp_path):
    return find_settings(environ={"HALMA_HOME": str(tmp_path / "home")})


@pytest.fixture
def taken():
    """A port that somebody listens on."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        yield other.getsockname()[1]


def nothing():
    raise AssertionError("nothing may be started where the port can't be had")


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGINT])
def test_it_announces_itself_serves_and_ends_cleanly(tmp_path, end):
    home = tmp_path / "home"
    process = subprocess.Popen(
        [sys.executable, "-W", "error", "-c", SCRIPT],
        env={**os.environ, "HALMA_HOME": str(home), "HALMA_DB": "", "HALMA_ARTIFACTS": ""},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        assert process.stdout.readline() == "coordinator up\n"
        url = process.stdout.readline().removeprefix("halma is at ").strip()
        token = process.stdout.readline().rpartition(": ")[2].strip()
        announcement = json.loads((home / "server.json").read_text())
        assert announcement == {"url": url, "pid": process.pid, "database": str(home / "halma.db")}
        headers = {"authorization": f"Bearer {token}"}
        assert httpx.get(f"{url}/api/v1/studies", headers=headers, timeout=60).json()["studies"] == []
        assert httpx.get(f"{url}/login", timeout=60).status_code == 200
        process.send_signal(end)
        rest, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert rest == "Stopping: running trainings come to their next checkpoints.\ncoordinator down\n"
    assert process.returncode == 0
    assert not (home / "server.json").exists()


class TestPort:
    def test_one_that_another_program_has_is_named_with_what_to_do(self, settings, taken):
        message = (
            rf"--port {taken}: expected a free port on 127.0.0.1, found it used by another program; "
            rf"find it with `ss -ltnp '\( sport = :{taken} \)'`, or take another \(--port\)"
        )
        with pytest.raises(BadInput, match=message):
            serve(settings, start_coordinator=nothing, say=print, port=taken)
        assert not settings.token_file.exists()

    def test_one_that_halma_has_is_told_with_its_process(self, settings, taken):
        settings.home.mkdir()
        with announced(settings, f"http://127.0.0.1:{taken}"):
            message = rf"used by halma itself \(process {os.getpid()}\); stop it with `kill {os.getpid()}`"
            with pytest.raises(BadInput, match=message), listening("127.0.0.1", taken, settings):
                pass

    @pytest.mark.parametrize("host", ["192.0.2.1", "no.such.host.invalid"])
    def test_an_address_that_is_none_of_ours_is_refused(self, settings, host):
        with pytest.raises(BadInput, match=f"--host {host}: expected an address of this machine"):
            serve(settings, start_coordinator=nothing, say=print, host=host)

    def test_a_number_that_is_no_port_is_refused(self, settings):
        with pytest.raises(BadInput, match=r"--port 99999: expected a port from 0 \(any free one\) to 65535"):
            serve(settings, start_coordinator=nothing, say=print, port=99999)

    def test_a_second_service_for_the_same_database_is_refused(self, settings, monkeypatch):
        settings.home.mkdir()
        other = {"url": "http://127.0.0.1:1", "pid": os.getppid(), "database": settings.database}
        settings.server_file.write_text(json.dumps(other))
        with pytest.raises(BadInput, match=rf"found one at http://127.0.0.1:1 \(process {os.getppid()}\)"):
            serve(settings, start_coordinator=nothing, say=print)


class TestAnnouncement:
    def test_what_another_service_announced_since_stays(self, settings):
        settings.home.mkdir()
        with announced(settings, "http://127.0.0.1:2"):
            other = json.dumps({"url": "http://127.0.0.1:3", "pid": os.getppid(), "database": ""})
            settings.server_file.write_text(other)
        assert settings.server_file.read_text() == other

    @pytest.mark.parametrize(
        ("host", "url"),
        [
            ("127.0.0.1", "http://127.0.0.1:80"),
            ("0.0.0.0", "http://127.0.0.1:80"),
            ("::", "http://127.0.0.1:80"),
            ("::1", "http://[::1]:80"),
            ("lab.example", "http://lab.example:80"),
        ],
    )
    def test_programs_of_this_machine_find_it(self, host, url):
        assert base_url(host, 80) == url

    @pytest.mark.parametrize(
        ("host", "alone"), [("127.0.0.1", True), ("localhost", True), ("::1", True), ("0.0.0.0", False)]
    )
    def test_who_can_reach_it_is_known(self, host, alone):
        assert is_loopback(host) is alone

    def test_the_application_is_found_by_its_name(self):
        from dashboards.app import create_app

        assert load_factory("dashboards.app:create_app") is create_app
