"""Alembic's entry: runs migrations on the engine it is handed."""

from alembic import context

from service.db.schema import metadata

with context.config.attributes["engine"].begin() as connection:
    context.configure(connection=connection, target_metadata=metadata, render_as_batch=True)
    with context.begin_transaction():
        context.run_migrations()
