"""What tests of several parts of the service need."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.service.postgres import Postgres


def running_postgres() -> Iterator[Postgres]:
    """A server of PostgreSQL."""
    try:
        server = Postgres()
    except Exception as error:
        pytest.skip(f"PostgreSQL does not start here: {error}")
    yield server
    server.close()


postgres = pytest.fixture(scope="session", name="postgres")(running_postgres)
"""One for the session; a test that stops it starts one of its own."""
