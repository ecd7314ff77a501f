"""What can be said wrongly about where the database is, and how SQLite is set up once it is found."""

from __future__ import annotations

import sqlite3

import pytest
import sqlalchemy as sa
from alembic.script import ScriptDirectory

from services.errors import DatabaseUnavailable
from services.store import engine as engines
from services.store.engine import resolve, shown
from services.store.open import open_store
from services.store.reads import _EVENTS, _HISTORY, _ONE_STUDY, _STUDY_EVENTS, _TRIAL, _TRIALS
from services.store.schema import HEAD
from services.store.upgrade import MIGRATIONS


def test_the_newest_migration_is_the_one_the_code_speaks():
    assert ScriptDirectory(str(MIGRATIONS)).get_heads() == [HEAD]


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ("postgresql://u:p@h/db", "postgresql+psycopg://u:p@h/db"),
        ("postgres://h/db", "postgresql+psycopg://h/db"),
        ("postgresql+psycopg://h/db", "postgresql+psycopg://h/db"),
        ("sqlite:////a/b.db", "sqlite:////a/b.db"),
        ("/a/b.db", "sqlite:////a/b.db"),
    ],
)
def test_the_ways_to_name_a_database(given, found):
    assert resolve(given).render_as_string(hide_password=False) == found


def test_a_relative_path_is_made_absolute_so_that_other_processes_find_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", "/home/anna")
    assert resolve("b.db").database == str(tmp_path / "b.db")
    assert resolve("sqlite:///b.db").database == str(tmp_path / "b.db")
    assert resolve("~/b.db").database == "/home/anna/b.db"


def test_a_password_is_not_shown():
    assert shown(resolve("postgresql://u:secret@h/db")) == "postgresql://u:***@h/db"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("mysql://h/db", "expected SQLite .* or PostgreSQL .*, found 'mysql'"),
        ("sqlite://", "expected a SQLite file, because several processes use it together"),
        ("sqlite:///:memory:", "expected a SQLite file"),
        ("://nonsense", "expected a file or a URL such as postgresql://user@host/halma, found '://nonsense'"),
        ("postgresql+nosuch://h/db", "the driver of 'postgresql\\+nosuch' is not installed .*; use postgresql://"),
        ("postgresql+pg8000://h/db", "the driver of 'postgresql\\+pg8000' is not installed .*; use postgresql://"),
        (
            "postgresql://u:secret@/db?host=/nowhere",
            r"database postgresql://u:\*\*\*@.*: expected a PostgreSQL server that lets us in, found: .*nowhere.*; c",
        ),
    ],
)
def test_a_database_that_cannot_be_opened_is_told_with_what_to_do(given, message):
    with pytest.raises(DatabaseUnavailable, match=message):
        open_store(given)


def test_a_directory_is_no_database(tmp_path):
    with pytest.raises(DatabaseUnavailable, match="expected a file, found a directory; add a file name"):
        open_store(tmp_path)


def test_a_folder_that_cannot_be_made_is_told(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(DatabaseUnavailable, match=r"expected a folder we can make at .*/file, found: .*; give another"):
        open_store(tmp_path / "file" / "halma.db")


def test_a_file_that_is_no_database_is_left_alone(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("my notes, " * 1000)
    with pytest.raises(DatabaseUnavailable, match="found: file is not a database; this is some other file"):
        open_store(path)
    assert path.read_text() == "my notes, " * 1000


def test_a_damaged_database_is_told(tmp_path):
    path = tmp_path / "halma.db"
    open_store(path).close()
    data = bytearray(path.read_bytes())
    data[4096:] = b"\xff" * (len(data) - 4096)
    path.write_bytes(data)
    with pytest.raises(DatabaseUnavailable, match="malformed; the file is damaged: restore it from a backup"):
        open_store(path).studies()


def test_the_folder_is_made(tmp_path):
    store = open_store(tmp_path / "new" / "deep" / "halma.db")
    assert store.url == f"sqlite:///{tmp_path}/new/deep/halma.db"
    store.close()


def test_a_commit_is_durable_and_readers_do_not_wait(tmp_path):
    store = open_store(tmp_path / "halma.db")
    with store._engine.connect() as connection:
        pragmas = {
            name: connection.exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in ("journal_mode", "synchronous", "foreign_keys", "busy_timeout")
        }
    store.close()
    assert pragmas == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1, "busy_timeout": 30_000}


def test_a_database_that_somebody_holds_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(engines, "BUSY_SECONDS", 0.05)
    store = open_store(tmp_path / "halma.db")
    holder = sqlite3.connect(tmp_path / "halma.db", isolation_level=None)
    holder.execute("BEGIN IMMEDIATE")
    with (
        pytest.raises(DatabaseUnavailable, match=r"found: .*locked.*; another process holds it"),
        store.transaction() as change,
    ):
        change.note("warning")
    holder.execute("ROLLBACK")
    holder.close()
    with store.transaction() as change:
        change.note("warning")
    assert store.last_event() == 1
    store.close()


def test_a_full_disk_is_told_and_nothing_is_written(tmp_path):
    store = open_store(tmp_path / "halma.db")
    with store._engine.connect() as connection:
        pages = connection.exec_driver_sql("PRAGMA page_count").scalar()

    def no_room(connection, _record):
        connection.execute(f"PRAGMA max_page_count = {pages + 1}")

    def write_much():
        with store.transaction() as change:
            change.create_study("jump", {"text": "x" * 100_000}, seed=1)

    sa.event.listen(store._engine, "connect", no_room)
    store._engine.dispose()
    with pytest.raises(DatabaseUnavailable, match="full; the disk is full: free some space, nothing was written"):
        write_much()
    assert store.studies() == []
    assert store.last_event() == 0
    sa.event.remove(store._engine, "connect", no_room)
    store._engine.dispose()
    write_much()
    assert len(store.studies()) == 1
    store.close()


def test_a_database_we_may_not_write_is_told(tmp_path):
    store = open_store(tmp_path / "halma.db")

    def only_read(connection, _record):
        connection.execute("PRAGMA query_only = ON")

    sa.event.listen(store._engine, "connect", only_read)
    store._engine.dispose()
    with (
        pytest.raises(DatabaseUnavailable, match=r"found: .*readonly database; we may not write there"),
        store.transaction() as change,
    ):
        change.note("warning")
    store.close()


@pytest.mark.parametrize(
    ("statement", "index"),
    [
        (_TRIALS, "uq_trials_study_id_number|sqlite_autoindex_trials_1"),
        (_TRIAL, "sqlite_autoindex_trials_1"),
        (_HISTORY, "sqlite_autoindex_trials_2"),
        (_ONE_STUDY, "ix_trials_study_id_state"),
        (_EVENTS, "PRIMARY KEY"),
        (_STUDY_EVENTS, "ix_events_study_id_id"),
    ],
)
def test_what_is_read_often_is_found_by_index_and_not_sorted(tmp_path, statement, index):
    """A window of 50,000 trials must not cost 50,000 trials."""
    store = open_store(tmp_path / "halma.db")
    text = str(statement.compile(store._engine))
    with store._engine.connect() as connection:
        plan = connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {text}", (1,) * text.count("?")).fetchall()
    store.close()
    steps = " / ".join(step[3] for step in plan)
    assert any(name in steps for name in index.split("|")), steps
    assert "SCAN" not in steps
    assert "ORDER BY" not in steps or statement is _ONE_STUDY
