"""Opening the trial database."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import URL

from services.errors import DatabaseUnavailable
from services.store.engine import connect, resolve, shown, translated
from services.store.port import Store
from services.store.sql import SqlStore
from services.store.upgrade import prepare, upgrade

__all__ = ["open_store", "upgrade"]


def open_store(url_or_path: str | Path) -> Store:
    """Open a trial database, making it (and its folder) where there is none.

    Args:
        url_or_path: path of a SQLite file, `sqlite:///path`, or `postgresql://user:password@host:port/database`.

    Raises:
        DatabaseUnavailable: it can't be opened, is not ours, or has a schema that this code doesn't speak.
    """
    url = resolve(url_or_path)
    if url.get_backend_name() == "sqlite":
        _make_room(url)
    engine = connect(url)
    try:
        prepare(engine)
        with translated(url):
            return SqlStore(engine)
    except BaseException:
        engine.dispose()
        raise


def _make_room(url: URL) -> None:
    path = Path(str(url.database))
    if path.is_dir():
        raise DatabaseUnavailable(f"database {shown(url)}: expected a file, found a directory; add a file name to it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DatabaseUnavailable(
            f"database {shown(url)}: expected a folder we can make at {path.parent}, found: {error.strerror}; "
            "give another path"
        ) from error
