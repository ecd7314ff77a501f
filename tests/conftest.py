"""What tests of several rooms need: throw-away servers and a browser."""

from __future__ import annotations

import shutil

import pytest
from lacking import without
from object_storage import s3_root, s3_server  # noqa: F401 - fixtures of all rooms
from playwright.sync_api import sync_playwright
from postgres import NoPostgres, running_server

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]  # fmt: skip


@pytest.fixture(scope="session")
def postgres_server():
    try:
        with running_server() as server:
            yield server
    except NoPostgres as error:
        without(str(error))


@pytest.fixture(scope="session")
def chromium():
    if CHROMIUM is None:
        without("these tests drive a real browser: expected chromium on the PATH, found none; install it")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()
