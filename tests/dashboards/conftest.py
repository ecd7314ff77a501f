from __future__ import annotations

import shutil
import socket
import sqlite3
import threading
import time
import uuid

import pytest
import uvicorn
from playwright.sync_api import expect

from dashboards.app import create_app
from services.api.submission import submit_to
from services.artifacts.open import open_artifacts
from services.auth import COOKIE, Gatekeeper
from services.store.open import open_store

TOKEN = "a-token-for-tests-only"


# Limits for a machine that is busy with other things; what is waited for comes in tens of milliseconds on an idle one.
expect.set_options(timeout=30_000)
NAVIGATION_MS = 120_000


class Service:
    """A real server over a real database, on a free port of this machine."""

    def __init__(self, folder, template=None, artifacts="artifacts"):
        self.folder = folder
        self.template = template
        self.artifacts = open_artifacts(folder / artifacts)
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"

    def start(self, database="halma.db"):
        file = self.folder / database
        if self.template and not file.exists():
            shutil.copy(self.template, file)
            # A copied database would have a copied history.
            with sqlite3.connect(file) as copied:
                copied.execute("UPDATE meta SET value = ? WHERE key = 'history_id'", (uuid.uuid4().hex,))
            copied.close()
        self.store = open_store(file)
        app = create_app(self.store, self.artifacts, token=TOKEN, submit=submit_to(self.store))
        config = uvicorn.Config(app, host="127.0.0.1", port=self.port, log_level="warning", ws="websockets-sansio")
        self.server = uvicorn.Server(config)
        self.thread = threading.Thread(target=self.server.run, daemon=True)
        self.thread.start()
        while not self.server.started:
            assert self.thread.is_alive()
            time.sleep(0.01)
        return self

    def stop(self):
        self.server.should_exit = True
        self.thread.join(20)
        assert not self.thread.is_alive()
        self.store.close()


@pytest.fixture(scope="session")
def empty_database(tmp_path_factory):
    """Making the tables takes half a second, copying a file nothing."""
    path = tmp_path_factory.mktemp("template") / "halma.db"
    open_store(path).close()
    return path


@pytest.fixture
def service(tmp_path, empty_database):
    running = Service(tmp_path, empty_database).start()
    yield running
    running.stop()


class Watched:
    """A page whose console, errors and requests are kept."""

    def __init__(self, context, url):
        self.url = url
        context.set_default_timeout(NAVIGATION_MS)
        self.page = context.new_page()
        self.requests = []
        self.complaints = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("websocket", lambda socket: self.requests.append(socket.url))
        self.page.on(
            "console", lambda message: message.type in {"error", "warning"} and self.complaints.append(message.text)
        )
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))

    def open(self, path):
        self.page.goto(self.url + path)
        return self.page

    def assert_calm(self, but=()):
        """Nothing was asked of another host, and the console is empty (so no violation of the policy either)."""
        own = self.url.removeprefix("http://")
        foreign = [
            url for url in self.requests if not url.startswith((f"http://{own}/", f"ws://{own}/", "data:", "blob:"))
        ]
        assert foreign == []
        assert [text for text in self.complaints if not any(part in text for part in but)] == []


@pytest.fixture
def anyone(service, chromium):
    """A browser that is not logged in."""
    context = chromium.new_context(viewport={"width": 1280, "height": 900}, color_scheme="light")
    yield Watched(context, service.url)
    context.close()


def log_in(watched):
    watched.open("/login")
    watched.page.fill("#token", TOKEN)
    watched.page.click("button[type=submit]")
    watched.page.wait_for_selector("#studies, #nothing:not([hidden])", state="attached")


@pytest.fixture
def browser(anyone):
    """A browser that is logged in."""
    anyone.page.context.add_cookies(
        [
            {
                "name": COOKIE,
                "value": Gatekeeper(TOKEN).new_session(),
                "url": anyone.url,
                "httpOnly": True,
                "sameSite": "Strict",
            }
        ]
    )
    return anyone


def until(done, seconds=10.0):
    """Wait for something that the document doesn't show. (Waiting inside the page needs eval, which it forbids.)"""
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end
        time.sleep(0.05)
