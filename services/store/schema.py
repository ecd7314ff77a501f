"""The tables of the trial database. The migrations build them; a test holds both to the same shape.

Conventions, the same on SQLite and PostgreSQL:

- JSON, times and seeds are text. JSON is written by `json.dumps` (key order and every bit of a float survive; JSONB
  would keep neither order nor text), times are ISO 8601 in UTC, seeds are decimal because both engines' integers are
  signed 64-bit and a seed is unsigned.
- Every id is drawn from a sequence that never goes back (AUTOINCREMENT, identity): an id that a late writer still
  holds can't come to mean another row after a deletion.
"""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    CheckConstraint,
    Column,
    Double,
    ForeignKey,
    Identity,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
)

HEAD = "0001"
"""Revision of the schema that this code reads and writes; a test holds it to the newest migration."""

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)

# SQLite counts rows only in a column declared INTEGER, which there holds 64 bits anyway.
ROW_ID = BigInteger().with_variant(Integer(), "sqlite")


def _id() -> Column[int]:
    return Column("id", ROW_ID, Identity(), primary_key=True)


def _parent(name: str, target: str) -> Column[int]:
    return Column(name, ROW_ID, ForeignKey(f"{target}.id", ondelete="CASCADE"), nullable=False)


meta = Table(
    "meta",
    metadata,
    Column("key", String(64), primary_key=True),
    Column("value", Text, nullable=False),
)

studies = Table(
    "studies",
    metadata,
    _id(),
    Column("name", Text, nullable=False, unique=True),
    Column("state", String(16), nullable=False),
    Column("reason", Text, nullable=False, server_default=""),
    Column("wanted", String(16), nullable=False, server_default="run"),
    Column("spec", Text, nullable=False),
    Column("seed", String(20), nullable=False),
    Column("priority", Integer, nullable=False, server_default="0"),
    Column("pool", Text, nullable=False, server_default="default"),
    Column("target_trials", BigInteger),
    Column("target_cost", Double),
    Column("driver_id", Text),
    Column("driver_host", Text),
    Column("driver_pid", BigInteger),
    Column("driver_started", Text),
    Column("driven_since", String(40)),
    Column("drive_token", BigInteger, nullable=False, server_default="0"),
    Column("drive_beat", BigInteger, nullable=False, server_default="0"),
    Column("trial_count", BigInteger, nullable=False, server_default="0"),
    Column("created_at", String(40), nullable=False),
    Column("finished_at", String(40)),
    CheckConstraint("(driver_id IS NULL) = (state <> 'running')", name="running_means_driven"),
    sqlite_autoincrement=True,
)

proposals = Table(
    "proposals",
    metadata,
    _id(),
    _parent("study_id", "studies"),
    Column("strategy", Text, nullable=False),
    Column("history", BigInteger, nullable=False),
    Column("pending", Text, nullable=False),
    Column("rng_key", Text, nullable=False),
    Column("count", Integer, nullable=False),
    Column("seconds", Double, nullable=False),
    Column("info", Text, nullable=False),
    Column("created_at", String(40), nullable=False),
    Index(None, "study_id", "id"),
    sqlite_autoincrement=True,
)

trials = Table(
    "trials",
    metadata,
    _id(),
    _parent("study_id", "studies"),
    Column("number", BigInteger, nullable=False),
    Column("stage", Text, nullable=False),
    Column("state", String(16), nullable=False),
    Column("params", Text, nullable=False),
    Column("z", Double),
    Column("warm_start", BigInteger),
    Column("seed", String(20), nullable=False),
    Column("proposal_id", ROW_ID, ForeignKey("proposals.id", ondelete="SET NULL")),
    Column("info", Text, nullable=False),
    Column("position", BigInteger),
    Column("value", Double),
    Column("features", Text),
    Column("details", Text, nullable=False, server_default="{}"),
    Column("message", Text, nullable=False, server_default=""),
    Column("samples", BigInteger, nullable=False, server_default="0"),
    Column("seconds", Double, nullable=False, server_default="0"),
    Column("iteration", BigInteger, nullable=False, server_default="0"),
    Column("attempts", Integer, nullable=False, server_default="0"),
    Column("retries", Integer, nullable=False, server_default="0"),
    Column("created_at", String(40), nullable=False),
    Column("started_at", String(40)),
    Column("finished_at", String(40)),
    UniqueConstraint("study_id", "number"),
    UniqueConstraint("study_id", "position"),
    CheckConstraint(
        "(position IS NOT NULL) = (state IN ('complete', 'infeasible', 'diverged', 'failed'))",
        name="observed_means_positioned",
    ),
    Index(None, "study_id", "state"),
    Index(None, "proposal_id"),
    sqlite_autoincrement=True,
)

attempts = Table(
    "attempts",
    metadata,
    _id(),
    _parent("trial_id", "trials"),
    Column("number", Integer, nullable=False),
    Column("state", String(16), nullable=False),
    Column("token", BigInteger, nullable=False),
    Column("worker", Text, nullable=False),
    Column("host", Text, nullable=False, server_default=""),
    Column("pid", BigInteger),
    Column("beat", BigInteger, nullable=False, server_default="0"),
    Column("first_iteration", BigInteger, nullable=False, server_default="0"),
    Column("started_at", String(40), nullable=False),
    Column("beat_at", String(40), nullable=False),
    Column("ended_at", String(40)),
    Column("reason", Text, nullable=False, server_default=""),
    UniqueConstraint("trial_id", "number"),
    sqlite_autoincrement=True,
)
# One live attempt a trial, held by the database itself and not only by the transitions.
Index(
    "uq_attempts_live",
    attempts.c.trial_id,
    unique=True,
    sqlite_where=attempts.c.state == "running",
    postgresql_where=attempts.c.state == "running",
)

metrics = Table(
    "metrics",
    metadata,
    Column("trial_id", ROW_ID, ForeignKey("trials.id", ondelete="CASCADE"), primary_key=True),
    Column("iteration", BigInteger, primary_key=True),
    Column("attempt", Integer, nullable=False),
    # All metrics of an iteration in one JSON object: they are written and read together, and one row an iteration
    # keeps a training of 1,000 iterations with 10 metrics at 1,000 rows.
    Column("metrics", Text, nullable=False),
    sqlite_with_rowid=False,
)

artifacts = Table(
    "artifacts",
    metadata,
    _id(),
    _parent("trial_id", "trials"),
    Column("name", Text, nullable=False),
    Column("path", Text, nullable=False),
    Column("sha256", String(64), nullable=False),
    Column("size", BigInteger, nullable=False),
    Column("created_at", String(40), nullable=False),
    UniqueConstraint("trial_id", "name"),
    sqlite_autoincrement=True,
)

events = Table(
    "events",
    metadata,
    _id(),
    # No foreign key: that a study was deleted is itself an event, which outlives the study.
    Column("study_id", ROW_ID),
    Column("trial", BigInteger),
    Column("kind", Text, nullable=False),
    Column("payload", Text, nullable=False),
    Column("at", String(40), nullable=False),
    Index(None, "study_id", "id"),
    sqlite_autoincrement=True,
)
