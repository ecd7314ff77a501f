"""Opening a database of either engine: empty, of this schema, of an older one, of a newer one, of somebody else."""

from __future__ import annotations

import shutil
import threading

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.config import Config

from services.errors import DatabaseUnavailable
from services.store import upgrade as upgrading
from services.store.engine import connect, resolve
from services.store.open import open_store, upgrade
from services.store.port import Driver, NewTrial
from services.store.schema import metadata

SECOND = '''"""A schema to come."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade():
    with op.batch_alter_table("studies") as table:
        table.add_column(sa.Column("note", sa.Text, nullable=False, server_default="none yet"))
        table.alter_column("pool", new_column_name="worker_pool")
'''


@pytest.fixture
def raw(empty_database):
    """A way in beside the store."""
    engine = connect(resolve(empty_database))
    yield engine
    engine.dispose()


@pytest.fixture
def next_schema(tmp_path, monkeypatch):
    """A halma whose newest schema is 0002, which changes a table that others refer to."""
    migrations = tmp_path / "migrations"
    shutil.copytree(upgrading.MIGRATIONS, migrations, ignore=shutil.ignore_patterns("__pycache__"))
    (migrations / "versions" / "v0002_next.py").write_text(SECOND)
    monkeypatch.setattr(upgrading, "MIGRATIONS", migrations)
    monkeypatch.setattr(upgrading, "HEAD", "0002")


def fill(database):
    store = open_store(database)
    with store.transaction() as change:
        study = change.create_study("jump", {"a": 1}, seed=1)
        token = change.drive("jump", Driver("me", "here", 1))
        (trial,) = change.propose(
            study.id, token, strategy="s", history=0, pending=[], rng_key=[], seconds=0.0, trials=[NewTrial({}, seed=0)]
        )
        change.start(trial.id, token, worker="w")
    history = store.history_id()
    store.close()
    return history


def content(engine, table):
    with engine.connect() as connection:
        return connection.exec_driver_sql(f"SELECT * FROM {table}").mappings().all()


COLUMNS = """SELECT table_name, ordinal_position, column_name, data_type, character_maximum_length, is_nullable,
    column_default, is_identity FROM information_schema.columns WHERE table_schema = 'public'"""
CONSTRAINTS = """SELECT conrelid::regclass::text, conname, pg_get_constraintdef(oid) FROM pg_constraint
    WHERE connamespace = 'public'::regnamespace"""
INDEXES = "SELECT indexdef FROM pg_indexes WHERE schemaname = 'public'"


def shape(engine):
    """Everything that the engine knows of its tables, in its own words; constraints in any order."""
    with engine.connect() as connection:
        if engine.dialect.name == "sqlite":
            texts = connection.exec_driver_sql("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL").scalars()
            rows = [[line.strip(" ,\t") for line in text.splitlines()] for text in texts]
            rows = [[row[0], *sorted(row[1:])] for row in rows]
        else:
            rows = [list(row) for query in (COLUMNS, CONSTRAINTS, INDEXES) for row in connection.exec_driver_sql(query)]
    return sorted(str(row) for row in rows if "alembic_version" not in str(row))


def test_the_migrations_build_what_the_schema_says(empty_database, raw):
    open_store(empty_database).close()
    migrated = shape(raw)
    with raw.begin() as connection:
        metadata.drop_all(connection)
        metadata.create_all(connection)
    assert shape(raw) == migrated
    assert len(migrated) >= 14


def test_the_first_migration_can_be_undone(empty_database, raw):
    open_store(empty_database).close()
    config = Config()
    config.set_main_option("script_location", str(upgrading.MIGRATIONS))
    with raw.begin() as connection:
        config.attributes["connection"] = connection
        command.downgrade(config, "base")
    assert sa.inspect(raw).get_table_names() == ["alembic_version"]


def test_two_that_open_an_empty_database_at_once_make_its_tables_once(empty_database):
    stores, failures = [], []

    def first():
        try:
            stores.append(open_store(empty_database))
        except Exception as error:  # noqa: BLE001 - carried to the assertion below
            failures.append(error)

    threads = [threading.Thread(target=first) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    histories = {store.history_id() for store in stores}
    for store in stores:
        store.close()
    assert failures == []
    assert len(histories) == 1


def test_a_database_of_something_else_is_left_alone(empty_database, raw):
    with raw.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE recipes (name TEXT)")
    with pytest.raises(DatabaseUnavailable, match=r"found tables of something else \(recipes\); give another one"):
        open_store(empty_database)
    assert sa.inspect(raw).get_table_names() == ["recipes"]


def test_a_newer_schema_is_refused(empty_database, raw):
    fill(empty_database)
    with raw.begin() as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '0815'")
    for opening in (open_store, upgrade):
        with pytest.raises(DatabaseUnavailable, match=r"expected schema 0001 or older, found 0815.*; update halma"):
            opening(empty_database)


@pytest.mark.postgres
def test_an_older_postgresql_database_is_refused_with_the_command_to_run(postgres_server, next_schema, monkeypatch):
    url = postgres_server.new_database("older")
    with monkeypatch.context() as patch:
        patch.setattr(upgrading, "HEAD", "0001")
        fill(url)
    with pytest.raises(DatabaseUnavailable, match="expected schema 0002, found the older 0001") as error:
        open_store(url)
    assert "run: halma db upgrade --db postgresql://postgres@/older?host=" in str(error.value)
    assert upgrade(url) == "0001"
    engine = connect(resolve(url))
    (study,) = content(engine, "studies")
    engine.dispose()
    assert (study["name"], study["worker_pool"], study["note"]) == ("jump", "default", "none yet")
    assert upgrade(url) == "0002"


def test_an_older_sqlite_database_is_copied_and_upgraded(tmp_path, next_schema, monkeypatch):
    path = tmp_path / "halma.db"
    with monkeypatch.context() as patch:
        patch.setattr(upgrading, "HEAD", "0001")
        history = fill(path)
    upgrading.prepare(engine := connect(resolve(path)))
    (study,) = content(engine, "studies")
    assert (study["name"], study["worker_pool"], study["note"]) == ("jump", "default", "none yet")
    # The trial points to the study, whose table was copied and dropped on the way.
    assert len(content(engine, "trials")) == len(content(engine, "attempts")) == 1
    with engine.connect() as connection:
        assert connection.exec_driver_sql("PRAGMA foreign_keys").scalar() == 1
    engine.dispose()

    backup = connect(resolve(tmp_path / "halma.db.0001.backup"))
    (study,) = content(backup, "studies")
    assert study["pool"] == "default"
    assert content(backup, "alembic_version") == [{"version_num": "0001"}]
    # A copy that is put back one day is another history.
    assert content(backup, "meta")[0]["value"] != history
    backup.dispose()


def test_a_backup_is_never_overwritten(tmp_path, next_schema, monkeypatch):
    path = tmp_path / "halma.db"
    (tmp_path / "halma.db.0001.backup").write_bytes(b"precious")
    with monkeypatch.context() as patch:
        patch.setattr(upgrading, "HEAD", "0001")
        fill(path)
    assert upgrade(path) == "0001"
    assert (tmp_path / "halma.db.0001.backup").read_bytes() == b"precious"
    assert (tmp_path / "halma.db.0001.backup2").stat().st_size > 0


def test_an_upgrade_that_breaks_changes_nothing(tmp_path, next_schema, monkeypatch):
    path = tmp_path / "halma.db"
    with monkeypatch.context() as patch:
        patch.setattr(upgrading, "HEAD", "0001")
        fill(path)
    script = upgrading.MIGRATIONS / "versions" / "v0002_next.py"
    script.write_text(SECOND + "    raise ZeroDivisionError\n")
    with pytest.raises(ZeroDivisionError):
        upgrade(path)
    with monkeypatch.context() as patch:
        patch.setattr(upgrading, "HEAD", "0001")
        store = open_store(path)
        assert store.study("jump").pool == "default"
        store.close()
