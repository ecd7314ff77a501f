from __future__ import annotations

import shutil

import pytest
from fastapi.testclient import TestClient

from services.api.assembly import create_api
from services.api.submission import submit_to
from services.artifacts.open import open_artifacts
from services.auth import Gatekeeper
from services.store.open import open_store
from tests.record import Record

TOKEN = "a-token-for-tests-only"


@pytest.fixture(scope="session")
def empty_database(tmp_path_factory):
    """Making the tables takes half a second, copying a file nothing."""
    path = tmp_path_factory.mktemp("template") / "halma.db"
    open_store(path).close()
    return path


@pytest.fixture
def store(tmp_path, empty_database):
    opened = open_store(shutil.copy(empty_database, tmp_path / "halma.db"))
    yield opened
    opened.close()


@pytest.fixture
def artifacts(tmp_path):
    return open_artifacts(tmp_path / "artifacts")


@pytest.fixture
def record(store, artifacts):
    return Record(store, artifacts, "jump").begin()


@pytest.fixture
def changes():
    """What the API said to the driver."""
    return []


@pytest.fixture
def app(store, artifacts, changes):
    return create_api(
        store,
        artifacts,
        gate=Gatekeeper(TOKEN),
        submit=submit_to(store),
        on_change=lambda: changes.append("changed"),
        hosts=["halma.example"],
    )


@pytest.fixture
def anyone(app):
    """A client without a token."""
    with TestClient(app, base_url="http://localhost:8642") as client:
        yield client


@pytest.fixture
def client(anyone):
    """A client with the token."""
    anyone.headers["authorization"] = f"Bearer {TOKEN}"
    return anyone
