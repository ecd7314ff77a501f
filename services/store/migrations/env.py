"""What Alembic runs: the migrations, on the connection (and in the transaction) that it is handed."""

from alembic import context

from services.store.schema import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    render_as_batch=True,  # SQLite can change a table only by copying it
    transactional_ddl=True,  # SQLite's DDL is, though Alembic takes it not to be
)
with context.begin_transaction():
    context.run_migrations()
