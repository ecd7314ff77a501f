"""A network that is cut while a page is open: nothing comes, nothing goes, and no connection is closed."""

from __future__ import annotations

import contextlib
import socket
import threading
import time

import pytest
from playwright.sync_api import expect

from services.auth import COOKIE, Gatekeeper
from tests.dashboards.conftest import TOKEN, Watched
from tests.record import Record

pytestmark = pytest.mark.browser

CUT_SECONDS = 30.0
"""Longer than any of the page's own patience, and than what a proxy would call a pause."""


class Cable:
    """A proxy in front of a server that can be cut: what is on its way then arrives when it is whole again."""

    def __init__(self, port):
        self.target = port
        self.whole = threading.Event()
        self.whole.set()
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                near, _ = self.listener.accept()
                far = socket.create_connection(("127.0.0.1", self.target))
                for source, sink in ((near, far), (far, near)):
                    threading.Thread(target=self._carry, args=(source, sink), daemon=True).start()

    def _carry(self, source, sink):
        # Each thread reads from its own end, and closes that once the other end has been told.
        with source, contextlib.suppress(OSError):
            while data := source.recv(65536):
                self.whole.wait()
                sink.sendall(data)
            sink.shutdown(socket.SHUT_WR)


def test_a_cut_is_told_and_what_happened_meanwhile_is_there_afterwards(service, chromium):
    record = Record(service.store, service.artifacts, "jump").begin()
    record.one()
    cable = Cable(service.port)
    context = chromium.new_context()
    url = f"http://127.0.0.1:{cable.port}"
    context.add_cookies([{"name": COOKIE, "value": Gatekeeper(TOKEN).new_session(), "url": url}])
    try:
        page = Watched(context, url).open("/studies/jump")
        expect(page.locator("#link")).to_have_attribute("data-state", "live")
        page.evaluate("window.notReloaded = true")
        cable.whole.clear()
        cut = time.monotonic()
        record.one()
        expect(page.locator("#link")).to_have_attribute("data-state", "waiting")
        expect(page.locator("#banner")).to_contain_text("The service does not answer since")
        expect(page.locator("#table tbody tr[data-number]")).to_have_count(1)
        record.one()
        time.sleep(max(0.0, CUT_SECONDS - (time.monotonic() - cut)))
        expect(page.locator("#link")).to_have_attribute("data-state", "waiting")
        cable.whole.set()
        expect(page.locator("#link")).to_have_attribute("data-state", "live")
        expect(page.locator("#banner")).to_be_hidden()
        expect(page.locator("#fact-trials")).to_have_text("3 of 24 done")
        expect(page.locator("#table tbody tr[data-number]")).to_have_count(3)
        assert page.evaluate("window.notReloaded")
    finally:
        cable.whole.set()
        context.close()
        cable.listener.close()
