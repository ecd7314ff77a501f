"""Making the tables, and bringing those of an older halma up to date (Alembic, run from here)."""

from __future__ import annotations

import sqlite3
import uuid
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from sqlalchemy import URL, Connection, Engine, inspect

from services.errors import DatabaseUnavailable
from services.store.engine import begin_write, connect, resolve, shown, translated
from services.store.schema import HEAD

MIGRATIONS = Path(__file__).parent / "migrations"


def revision(connection: Connection) -> str | None:
    """Revision of the schema, None for a database without tables. Raises `DatabaseUnavailable` for others' tables."""
    tables = inspect(connection).get_table_names()
    if "alembic_version" in tables and "studies" in tables:
        return str(connection.exec_driver_sql("SELECT version_num FROM alembic_version").scalar_one())
    if tables:
        raise DatabaseUnavailable(
            f"database {shown(connection.engine.url)}: expected a trial database or an empty one, found "
            f"tables of something else ({', '.join(sorted(tables)[:3])}); give another one"
        )
    return None


def prepare(engine: Engine) -> None:
    """Bring a database to the schema of this code, where that is safe to do unasked.

    An empty database gets its tables; an older SQLite file is copied beside itself and upgraded. An older
    PostgreSQL database, which others may be using, and a newer one of either kind raise `DatabaseUnavailable`.
    """
    with translated(engine.url), engine.connect() as connection:
        found = revision(connection)
    if found == HEAD:
        return
    if found is not None:
        _refuse_newer(engine.url, found)
        if engine.dialect.name != "sqlite":
            raise DatabaseUnavailable(
                f"database {shown(engine.url)}: expected schema {HEAD}, found the older {found}; back it up, "
                f"end everything that uses it, and run: halma db upgrade --db {shown(engine.url)}"
            )
    _migrate(engine)


def upgrade(url_or_path: str | Path) -> str:
    """Bring a database to the schema of this code, whatever engine it is on. Returns the revision it had, or ''.

    A SQLite file is copied beside itself first; for PostgreSQL that is the caller's business. Raises
    `DatabaseUnavailable`.
    """
    engine = connect(resolve(url_or_path))
    try:
        with translated(engine.url), engine.connect() as connection:
            found = revision(connection)
        if found is not None and found != HEAD:
            _refuse_newer(engine.url, found)
        if found != HEAD:
            _migrate(engine)
        return found or ""
    finally:
        engine.dispose()


def _refuse_newer(url: URL, found: str) -> None:
    from alembic.script import ScriptDirectory  # noqa: PLC0415 - 0.1 s that an up-to-date database needn't pay

    known = {script.revision for script in ScriptDirectory(str(MIGRATIONS)).walk_revisions()}
    if found not in known:
        raise DatabaseUnavailable(
            f"database {shown(url)}: expected schema {HEAD} or older, found {found}, which a newer halma wrote; "
            "update halma, or give another database"
        )


def _migrate(engine: Engine) -> None:
    """Run what is missing in one transaction, while no other process writes or migrates."""
    from alembic import command  # noqa: PLC0415 - as above
    from alembic.config import Config  # noqa: PLC0415 - as above

    with translated(engine.url), _foreign_keys_off(engine) as connection:
        begin_write(connection)
        found = revision(connection)  # another process may have been faster
        if found == HEAD:
            return
        if found is not None and engine.dialect.name == "sqlite":
            _back_up(Path(str(engine.url.database)), found)
        config = Config()
        config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
        config.attributes["connection"] = connection
        command.upgrade(config, HEAD)
        if engine.dialect.name == "sqlite":
            broken = connection.exec_driver_sql("PRAGMA foreign_key_check").fetchall()
            if broken:
                raise DatabaseUnavailable(
                    f"database {shown(engine.url)}: the upgrade from {found} to {HEAD} would leave {len(broken)} rows "
                    "without their parent; nothing was changed, please report this"
                )
        connection.commit()


@contextmanager
def _foreign_keys_off(engine: Engine) -> Iterator[Connection]:
    # SQLite changes a table by copying and dropping it, and dropping it would cascade to the rows that point to it.
    # The pragma means nothing inside a transaction, so it is set around it.
    with engine.connect() as connection:
        if engine.dialect.name != "sqlite":
            yield connection
            return
        connection.exec_driver_sql("PRAGMA foreign_keys = OFF")
        try:
            yield connection
        finally:
            connection.rollback()
            connection.exec_driver_sql("PRAGMA foreign_keys = ON")


def _back_up(path: Path, found: str) -> Path:
    """Copy a SQLite database beside itself, under a name with its revision that nothing has yet.

    The copy gets a history of its own: should it be put back one day, watchers must notice.
    """
    copy = path.with_name(f"{path.name}.{found}.backup")
    number = 1
    while copy.exists():
        number += 1
        copy = path.with_name(f"{path.name}.{found}.backup{number}")
    with closing(sqlite3.connect(path)) as source, closing(sqlite3.connect(copy)) as target:
        source.backup(target)
        target.execute("UPDATE meta SET value = ? WHERE key = 'history_id'", (uuid.uuid4().hex,))
        target.commit()
    return copy
