"""Connections to SQLite and PostgreSQL, set up so that a commit is durable and writers come one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Engine, create_engine, event
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, DatabaseError, InterfaceError, NoSuchModuleError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeout

from services.errors import DatabaseUnavailable

BUSY_SECONDS = 30.0
"""How long a writer waits for another one. The longest transaction of ours takes milliseconds; a backup, seconds."""

WRITERS = 0x68616C6D61
"""Key of PostgreSQL's advisory lock that write transactions hold ("halma" in ASCII)."""


def resolve(url_or_path: str | Path) -> URL:
    """The URL of a database given by URL or by path of a SQLite file.

    `postgresql://` and `postgres://` are driven by psycopg 3. Raises `DatabaseUnavailable` for other engines.
    """
    if isinstance(url_or_path, Path) or "://" not in url_or_path:
        return URL.create("sqlite", database=str(Path(url_or_path).expanduser().absolute()))
    try:
        # SQLAlchemy only knows the longer name of the two that libpq accepts.
        url = make_url(url_or_path.replace("postgres://", "postgresql://", 1))
    except ArgumentError as error:
        raise DatabaseUnavailable(
            f"database: expected a file or a URL such as postgresql://user@host/halma, found {url_or_path!r}"
        ) from error
    backend = url.get_backend_name()
    if backend == "postgresql":
        return url.set(drivername="postgresql+psycopg") if url.drivername == "postgresql" else url
    if backend == "sqlite":
        if not url.database or url.database == ":memory:" or url.query:
            raise DatabaseUnavailable(
                f"database {shown(url)}: expected a SQLite file, because several processes use it together; "
                "give a path or sqlite:///path"
            )
        return URL.create("sqlite", database=str(Path(url.database).expanduser().absolute()))
    raise DatabaseUnavailable(
        f"database {shown(url)}: expected SQLite (a path) or PostgreSQL (postgresql://...), found {backend!r}"
    )


def shown(url: URL) -> str:
    """The database as messages name it: a path, or a URL without its password."""
    if url.get_backend_name() == "sqlite" and url.database:
        return url.database
    if url.drivername == "postgresql+psycopg":
        url = url.set(drivername="postgresql")
    return url.render_as_string(hide_password=True)


def connect(url: URL) -> Engine:
    """An engine for a resolved URL; nothing is contacted yet. Raises `DatabaseUnavailable` without a driver."""
    try:
        if url.get_backend_name() == "sqlite":
            engine = create_engine(url, connect_args={"timeout": BUSY_SECONDS, "check_same_thread": False})
            event.listen(engine, "connect", _prepare_sqlite)
            return engine
        # A server that was restarted leaves dead connections in the pool: look before use.
        return create_engine(url, pool_pre_ping=True, connect_args={"connect_timeout": 10})
    except (ModuleNotFoundError, NoSuchModuleError) as error:
        raise DatabaseUnavailable(
            f"database {shown(url)}: the driver of {url.drivername!r} is not installed ({error}); "
            "use postgresql://, which takes psycopg 3"
        ) from error


def _prepare_sqlite(connection: Any, _record: object) -> None:
    # Without this the driver opens transactions by itself, deferred ones, which fail with "database is locked"
    # when two of them want to write; `begin_write` opens them instead.
    connection.isolation_level = None
    for pragma in (
        "journal_mode = WAL",  # readers never wait for the writer
        "synchronous = FULL",  # in WAL mode NORMAL may lose the last commits when the power fails
        "foreign_keys = ON",
    ):
        connection.execute(f"PRAGMA {pragma}")


def begin_write(connection: Connection) -> None:
    """Wait for other writers and begin a transaction whose view nobody can change until it ends.

    On PostgreSQL, too, all write transactions come one after the other. Every one of them appends events, and
    a sequence hands out event ids before the commit: of two concurrent transactions the one with the higher
    ids could commit first, a reader would move its cursor beyond the lower ids, and never see them. The lock is
    taken first of all, because taken later it could deadlock with a row lock, and PostgreSQL lets go of it only
    when the commit is visible.
    """
    if connection.dialect.name == "sqlite":
        connection.exec_driver_sql("BEGIN IMMEDIATE")
    else:
        connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({WRITERS})")


@contextmanager
def translated(url: URL) -> Iterator[None]:
    """Turn a database that is gone, locked, full, read-only or damaged into `DatabaseUnavailable`.

    A broken promise of ours (a constraint, wrong SQL) stays what it is: a bug, to be seen as one.
    """
    try:
        yield
    except DatabaseError as error:
        # The bare class is how SQLite says "file is not a database" and "disk image is malformed".
        if not isinstance(error, OperationalError) and type(error) is not DatabaseError:
            raise
        raise unavailable(url, error.orig or error) from error
    except (InterfaceError, PoolTimeout) as error:
        raise unavailable(url, error) from error


def unavailable(url: URL, cause: BaseException) -> DatabaseUnavailable:
    """What was expected of the database, what was found and what to do."""
    found = " ".join(str(cause).split()) or type(cause).__name__
    if url.get_backend_name() != "sqlite":
        return DatabaseUnavailable(
            f"database {shown(url)}: expected a PostgreSQL server that lets us in, found: {found}; "
            "check that it runs, and the host, port, user and database of the URL"
        )
    advice = next((advice for sign, advice in _SQLITE_ADVICE if sign in found), "check the path and its permissions")
    return DatabaseUnavailable(f"database {shown(url)}: expected a SQLite file we can write, found: {found}; {advice}")


_SQLITE_ADVICE = (
    ("not a database", "this is some other file: give another path"),
    ("malformed", "the file is damaged: restore it from a backup"),
    ("locked", "another process holds it: see which one with `fuser`, and end it if it hangs"),
    ("full", "the disk is full: free some space, nothing was written"),
    ("readonly", "we may not write there: change its owner or permissions, or give another path"),
)
