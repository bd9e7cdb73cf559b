"""Tables of any version brought up to this one: what the schema has and they lack is added, then rows of then are
mended.

The schema only grows, so that one jump leads here from every version. A new table, or a column with a server default,
needs the next VERSION; what has to be done about rows of before is a step of `_STEPS`.
"""

import json

import sqlalchemy as sa

from engine.errors import InputError
from service.db.schema import claims, metadata, uploads

VERSION = "0011"
_versions = sa.Table("alembic_version", sa.MetaData(), sa.Column("version_num", sa.String(32), primary_key=True))
"""One row; it is called after the tool that the first versions used."""


def version_of(connection: sa.Connection) -> str:
    """Version of the tables; "" where there are none."""
    if not sa.inspect(connection).has_table(_versions.name):
        return ""
    return connection.execute(sa.select(_versions.c.version_num)).scalar_one_or_none() or ""


def bring_up_to_date(connection: sa.Connection) -> None:
    """Make the tables, or add to them; InputError where a later version of this program made them."""
    found = version_of(connection)
    if found > VERSION:
        raise InputError("a later version of this program has changed this database: use that one")
    if found == VERSION:
        return
    _versions.create(connection, checkfirst=True)
    if found:
        _add_columns(connection)
    metadata.create_all(connection)
    for version, step in _STEPS:
        if "" < found < version:
            step(connection)
    connection.execute(sa.delete(_versions))
    connection.execute(sa.insert(_versions).values(version_num=VERSION))


def _add_columns(connection: sa.Connection) -> None:
    there, name_of = sa.inspect(connection), connection.dialect.identifier_preparer.format_table
    for table in filter(lambda each: there.has_table(each.name), metadata.sorted_tables):
        known = {column["name"] for column in there.get_columns(table.name)}
        for column in (each for each in table.columns if each.name not in known):
            added = sa.schema.CreateColumn(column).compile(dialect=connection.dialect)
            connection.exec_driver_sql(f"ALTER TABLE {name_of(table)} ADD COLUMN {added}")


def _note_verdicts(connection: sa.Connection) -> None:
    """They follow from the documents; names of suspects' files are not known any more."""
    for row in connection.execute(sa.select(claims.c.id, claims.c.document)).all():
        verdict = json.loads(row.document).get("verdict", "")
        connection.execute(sa.update(claims).where(claims.c.id == row.id).values(verdict=verdict))


def _restart_uploads(connection: sa.Connection) -> None:
    """Uploads under way start again: of their parts no digest is known. Complete ones are seen by `admin` alone."""
    connection.execute(sa.delete(uploads).where(uploads.c.state == "open"))
    connection.execute(sa.update(uploads).values(parts="[]"))


_STEPS = (("0003", _note_verdicts), ("0008", _restart_uploads))
"""By the version that needed it first."""
