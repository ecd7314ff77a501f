"""Every adapter of a port, for the suites that all of them have to pass."""

from __future__ import annotations

import itertools
import shutil

import psycopg
import pytest
from store_study import Study

from services.store.open import open_store

_numbers = itertools.count(1)

ENGINES = ["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)]


@pytest.fixture(scope="session")
def postgres_database(postgres_server):
    url = postgres_server.new_database("halma")
    open_store(url).close()
    return url


@pytest.fixture(scope="session")
def sqlite_template(tmp_path_factory):
    path = tmp_path_factory.mktemp("template") / "halma.db"
    open_store(path).close()
    return path


@pytest.fixture(params=ENGINES)
def empty_database(request, tmp_path):
    """URL or path of a database without tables, on each engine in turn."""
    if request.param == "sqlite":
        return str(tmp_path / "halma.db")
    return request.getfixturevalue("postgres_server").new_database(f"halma{next(_numbers)}")


@pytest.fixture(params=ENGINES)
def database(request, tmp_path):
    """URL or path of a database with tables and nothing in them, on each engine in turn."""
    if request.param == "sqlite":
        return str(shutil.copy(request.getfixturevalue("sqlite_template"), tmp_path / "halma.db"))
    url = request.getfixturevalue("postgres_database")
    with psycopg.connect(url) as connection:  # a new database takes a second, this takes milliseconds
        connection.execute("DELETE FROM studies")
        connection.execute("DELETE FROM events")
    return url


@pytest.fixture
def store(database):
    store = open_store(database)
    yield store
    store.close()


@pytest.fixture
def study(store):
    return Study(store)
