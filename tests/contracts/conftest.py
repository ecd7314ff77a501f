"""Every adapter of a port, for the suites that all of them have to pass."""

from __future__ import annotations

import itertools

import pytest
from postgres import NoPostgres, running_server

from services.store.open import open_store

_numbers = itertools.count(1)


@pytest.fixture(scope="session")
def postgres_server():
    try:
        with running_server() as server:
            yield server
    except NoPostgres as error:
        pytest.skip(str(error))


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)])
def database(request, tmp_path):
    """URL or path of an empty database, on each engine in turn."""
    if request.param == "sqlite":
        return str(tmp_path / "halma.db")
    return request.getfixturevalue("postgres_server").new_database(f"halma{next(_numbers)}")


@pytest.fixture
def store(database):
    store = open_store(database)
    yield store
    store.close()
