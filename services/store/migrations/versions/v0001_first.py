"""The first tables."""

from __future__ import annotations

import uuid

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

ROW_ID = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Make the tables, and the identity of the history that they will hold."""
    op.create_table(
        "events",
        sa.Column("id", ROW_ID, sa.Identity(always=False), nullable=False),
        sa.Column("study_id", ROW_ID, nullable=True),
        sa.Column("trial", sa.BigInteger(), nullable=True),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("payload", sa.Text(), nullable=False),
        sa.Column("at", sa.String(length=40), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_events")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_events_study_id_id"), "events", ["study_id", "id"], unique=False)
    op.create_table(
        "meta",
        sa.Column("key", sa.String(length=64), nullable=False),
        sa.Column("value", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("key", name=op.f("pk_meta")),
    )
    op.create_table(
        "studies",
        sa.Column("id", ROW_ID, sa.Identity(always=False), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("reason", sa.Text(), server_default="", nullable=False),
        sa.Column("wanted", sa.String(length=16), server_default="run", nullable=False),
        sa.Column("spec", sa.Text(), nullable=False),
        sa.Column("seed", sa.String(length=20), nullable=False),
        sa.Column("priority", sa.Integer(), server_default="0", nullable=False),
        sa.Column("pool", sa.Text(), server_default="default", nullable=False),
        sa.Column("target_trials", sa.BigInteger(), nullable=True),
        sa.Column("target_cost", sa.Double(), nullable=True),
        sa.Column("driver_id", sa.Text(), nullable=True),
        sa.Column("driver_host", sa.Text(), nullable=True),
        sa.Column("driver_pid", sa.BigInteger(), nullable=True),
        sa.Column("driver_started", sa.Text(), nullable=True),
        sa.Column("driven_since", sa.String(length=40), nullable=True),
        sa.Column("drive_token", sa.BigInteger(), server_default="0", nullable=False),
        sa.Column("drive_beat", sa.BigInteger(), server_default="0", nullable=False),
        sa.Column("trial_count", sa.BigInteger(), server_default="0", nullable=False),
        sa.Column("created_at", sa.String(length=40), nullable=False),
        sa.Column("finished_at", sa.String(length=40), nullable=True),
        sa.CheckConstraint("(driver_id IS NULL) = (state <> 'running')", name=op.f("ck_studies_running_means_driven")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_studies")),
        sa.UniqueConstraint("name", name=op.f("uq_studies_name")),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "proposals",
        sa.Column("id", ROW_ID, sa.Identity(always=False), nullable=False),
        sa.Column("study_id", ROW_ID, nullable=False),
        sa.Column("strategy", sa.Text(), nullable=False),
        sa.Column("history", sa.BigInteger(), nullable=False),
        sa.Column("pending", sa.Text(), nullable=False),
        sa.Column("rng_key", sa.Text(), nullable=False),
        sa.Column("count", sa.Integer(), nullable=False),
        sa.Column("seconds", sa.Double(), nullable=False),
        sa.Column("info", sa.Text(), nullable=False),
        sa.Column("created_at", sa.String(length=40), nullable=False),
        sa.ForeignKeyConstraint(["study_id"], ["studies.id"], name=op.f("fk_proposals_study_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_proposals")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_proposals_study_id_id"), "proposals", ["study_id", "id"], unique=False)
    op.create_table(
        "trials",
        sa.Column("id", ROW_ID, sa.Identity(always=False), nullable=False),
        sa.Column("study_id", ROW_ID, nullable=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
        sa.Column("stage", sa.Text(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("params", sa.Text(), nullable=False),
        sa.Column("z", sa.Double(), nullable=True),
        sa.Column("warm_start", sa.BigInteger(), nullable=True),
        sa.Column("seed", sa.String(length=20), nullable=False),
        sa.Column("proposal_id", ROW_ID, nullable=True),
        sa.Column("info", sa.Text(), nullable=False),
        sa.Column("position", sa.BigInteger(), nullable=True),
        sa.Column("value", sa.Double(), nullable=True),
        sa.Column("features", sa.Text(), nullable=True),
        sa.Column("details", sa.Text(), server_default="{}", nullable=False),
        sa.Column("message", sa.Text(), server_default="", nullable=False),
        sa.Column("samples", sa.BigInteger(), server_default="0", nullable=False),
        sa.Column("seconds", sa.Double(), server_default="0", nullable=False),
        sa.Column("iteration", sa.BigInteger(), server_default="0", nullable=False),
        sa.Column("attempts", sa.Integer(), server_default="0", nullable=False),
        sa.Column("retries", sa.Integer(), server_default="0", nullable=False),
        sa.Column("created_at", sa.String(length=40), nullable=False),
        sa.Column("started_at", sa.String(length=40), nullable=True),
        sa.Column("finished_at", sa.String(length=40), nullable=True),
        sa.CheckConstraint(
            "(position IS NOT NULL) = (state IN ('complete', 'infeasible', 'diverged', 'failed'))",
            name=op.f("ck_trials_observed_means_positioned"),
        ),
        sa.ForeignKeyConstraint(
            ["proposal_id"], ["proposals.id"], name=op.f("fk_trials_proposal_id"), ondelete="SET NULL"
        ),
        sa.ForeignKeyConstraint(["study_id"], ["studies.id"], name=op.f("fk_trials_study_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_trials")),
        sa.UniqueConstraint("study_id", "number", name=op.f("uq_trials_study_id_number")),
        sa.UniqueConstraint("study_id", "position", name=op.f("uq_trials_study_id_position")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_trials_proposal_id"), "trials", ["proposal_id"], unique=False)
    op.create_index(op.f("ix_trials_study_id_state"), "trials", ["study_id", "state"], unique=False)
    op.create_table(
        "artifacts",
        sa.Column("id", ROW_ID, sa.Identity(always=False), nullable=False),
        sa.Column("trial_id", ROW_ID, nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("path", sa.Text(), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("size", sa.BigInteger(), nullable=False),
        sa.Column("created_at", sa.String(length=40), nullable=False),
        sa.ForeignKeyConstraint(["trial_id"], ["trials.id"], name=op.f("fk_artifacts_trial_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_artifacts")),
        sa.UniqueConstraint("trial_id", "name", name=op.f("uq_artifacts_trial_id_name")),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "attempts",
        sa.Column("id", ROW_ID, sa.Identity(always=False), nullable=False),
        sa.Column("trial_id", ROW_ID, nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("token", sa.BigInteger(), nullable=False),
        sa.Column("worker", sa.Text(), nullable=False),
        sa.Column("host", sa.Text(), server_default="", nullable=False),
        sa.Column("pid", sa.BigInteger(), nullable=True),
        sa.Column("beat", sa.BigInteger(), server_default="0", nullable=False),
        sa.Column("first_iteration", sa.BigInteger(), server_default="0", nullable=False),
        sa.Column("started_at", sa.String(length=40), nullable=False),
        sa.Column("beat_at", sa.String(length=40), nullable=False),
        sa.Column("ended_at", sa.String(length=40), nullable=True),
        sa.Column("reason", sa.Text(), server_default="", nullable=False),
        sa.ForeignKeyConstraint(["trial_id"], ["trials.id"], name=op.f("fk_attempts_trial_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_attempts")),
        sa.UniqueConstraint("trial_id", "number", name=op.f("uq_attempts_trial_id_number")),
        sqlite_autoincrement=True,
    )
    op.create_index(
        "uq_attempts_live",
        "attempts",
        ["trial_id"],
        unique=True,
        sqlite_where=sa.text("state = 'running'"),
        postgresql_where=sa.text("state = 'running'"),
    )
    op.create_table(
        "metrics",
        sa.Column("trial_id", ROW_ID, nullable=False),
        sa.Column("iteration", sa.BigInteger(), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("metrics", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["trial_id"], ["trials.id"], name=op.f("fk_metrics_trial_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("trial_id", "iteration", name=op.f("pk_metrics")),
        sqlite_with_rowid=False,
    )
    history = sa.table("meta", sa.column("key"), sa.column("value"))
    op.bulk_insert(history, [{"key": "history_id", "value": uuid.uuid4().hex}])


def downgrade() -> None:
    """Drop the tables with all that they hold."""
    op.drop_table("metrics")
    op.drop_index(
        "uq_attempts_live",
        table_name="attempts",
        sqlite_where=sa.text("state = 'running'"),
        postgresql_where=sa.text("state = 'running'"),
    )
    op.drop_table("attempts")
    op.drop_table("artifacts")
    op.drop_index(op.f("ix_trials_study_id_state"), table_name="trials")
    op.drop_index(op.f("ix_trials_proposal_id"), table_name="trials")
    op.drop_table("trials")
    op.drop_index(op.f("ix_proposals_study_id_id"), table_name="proposals")
    op.drop_table("proposals")
    op.drop_table("studies")
    op.drop_table("meta")
    op.drop_index(op.f("ix_events_study_id_id"), table_name="events")
    op.drop_table("events")
