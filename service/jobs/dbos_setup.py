"""How this service uses DBOS: silent, on our database, no services of its maker, values as JSON."""

from __future__ import annotations

import logging
import sqlite3
from typing import TYPE_CHECKING

import sqlalchemy as sa

from service.db.database import POSTGRES_CONNECT

if TYPE_CHECKING:
    from dbos import DBOSClient, DBOSConfig

APPLICATION = "mark3dgs"
VERSION = "1"
"""Workers of every release share the jobs: a job outlives an update of the program."""

QUEUE = "jobs"
WORKFLOW = "job"
SECONDS_BETWEEN_POLLS = 0.2


def _hush() -> None:
    """Keep DBOS off the console: what it has to say goes to the program's log, errors only."""
    log = logging.getLogger("dbos")
    log.setLevel(logging.ERROR)
    if not log.handlers:  # finding one, DBOS adds none of its own
        log.addHandler(logging.NullHandler())


def migrate(url: str) -> None:
    """Bring the tables of the job engine up to date."""
    _hush()
    from dbos import DBOS

    address = sa.make_url(url)
    if address.get_backend_name() == "sqlite":
        connection = sqlite3.connect(str(address.database), timeout=30)
        connection.execute("PRAGMA journal_mode=WAL")  # kept in the file
        connection.close()
    DBOS.migrate(_with_limits(url))


def client(url: str) -> DBOSClient:
    """What an API process needs: it takes jobs on and looks at them, and runs none."""
    _hush()
    from dbos import DBOSClient, DBOSPortableJSONSerializer

    return DBOSClient(
        system_database_url=_with_limits(url),
        serializer=DBOSPortableJSONSerializer(),
        application_name=APPLICATION,
        lazy=True,
        retry_connection_errors=False,  # a request does not wait for a dead database
    )


def configuration(url: str, executor: str) -> DBOSConfig:
    """Of a worker."""
    _hush()
    from dbos import DBOSPortableJSONSerializer

    return {
        "name": APPLICATION,
        "system_database_url": _with_limits(url),
        "application_version": VERSION,
        "executor_id": executor,
        "serializer": DBOSPortableJSONSerializer(),  # the default, pickle, runs what it reads
        "sys_db_pool_size": 5,
        "log_level": "ERROR",
        "enable_otlp": False,
    }


def _with_limits(url: str) -> str:
    """The URL, on PostgreSQL with our limits of patience."""
    address = sa.make_url(url)
    if address.get_backend_name() == "sqlite":
        return url
    limits = {name: str(value) for name, value in POSTGRES_CONNECT.items()}
    return address.update_query_dict(limits).render_as_string(hide_password=False)
