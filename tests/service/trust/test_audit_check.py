"""Whatever is altered is found, and the first broken entry is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
import sqlalchemy as sa

from service.db import Database
from service.db.schema import assets, audit_nodes, claims
from service.db.schema import audit as log
from service.trust import audit, signing
from service.trust.audit_check import verify_log
from service.trust.canonical import canonical
from service.trust.commitments import commit_asset, commit_claim, registration_of
from service.trust.master import MasterKey


def asset_row(name: str) -> dict[str, Any]:
    row: dict[str, Any] = {column.name: f"{column.name} of {name}" for column in assets.columns}
    return row | {"id": name, "tenant": "acme", "gaussians": 5}


@pytest.fixture
def filled(db: Database, master: MasterKey) -> Database:
    """Entries: 0 signing key, 1 asset a, 2-8 others, 9 asset b, 10 claim."""
    signing.ensure_key(db, master)
    for name in ("a", "b"):
        with db.write() as connection:
            connection.execute(assets.insert().values(asset_row(name)))
            commit_asset(connection, asset_row(name))
        for number in range(7 if name == "a" else 0):
            with db.write() as connection:
                audit.append(connection, "acme", "test", {"number": number})
    with db.write() as connection:
        document: dict[str, Any] = {"claim_id": "c", "asset": "a", "z": 1.0}
        document["audit"] = commit_claim(connection, "acme", document, registration_of(connection, "a"))
        payload = canonical(document)
        row = {"id": "c", "tenant": "acme", "job": "j", "asset": "a", "document": payload.decode(), "pictures": "{}"}
        row |= {"jws": signing.sign(connection, master, payload), "created_at": "now"}
        connection.execute(claims.insert().values(row))
    return db


def test_a_whole_log_holds(filled: Database) -> None:
    report = verify_log(filled)
    assert report.ok, report.text()
    assert (report.entries, report.assets, report.claims) == (11, 2, 1)
    with filled.read() as connection:
        assert report.root == audit.root(connection, 11)
    assert report.to_json()["ok"] is True
    assert report.root in report.text()


Alter = Callable[[sa.Connection], Any]


def update(table: sa.Table, where: sa.ColumnElement[bool], **values: Any) -> Alter:
    return lambda connection: connection.execute(table.update().where(where).values(values))


def delete(table: sa.Table, where: sa.ColumnElement[bool]) -> Alter:
    return lambda connection: connection.execute(table.delete().where(where))


def node(level: int, position: int) -> sa.ColumnElement[bool]:
    return (audit_nodes.c.level == level) & (audit_nodes.c.position == position)


def forge_entry(connection: sa.Connection) -> None:
    """Rewrites entry 4 with a hash that fits: only its successor and the tree can tell."""
    row = connection.execute(log.select().where(log.c.index == 4)).one()
    before = connection.execute(sa.select(log.c.hash).where(log.c.index == 3)).scalar_one()
    forged = audit.entry_of([*row[:5], '{"number":99}', ""], before)
    connection.execute(log.update().where(log.c.index == 4).values(payload='{"number":99}', hash=forged.hash))


def forge_claim(connection: sa.Connection) -> None:
    row = connection.execute(claims.select()).one()
    document = json.loads(row.document) | {"z": 2.0}
    connection.execute(claims.update().values(document=canonical(document).decode()))


def swap_signature(connection: sa.Connection) -> None:
    row = connection.execute(claims.select()).one()
    connection.execute(claims.update().values(jws=row.jws[:-5] + "AAAAA"))


ALTERATIONS: list[tuple[str, Alter, int | None, str]] = [
    ("payload", update(log, log.c.index == 5, payload='{"number":9}'), 5, "entry"),
    ("layout", update(log, log.c.index == 5, payload='{"number": 3}'), 5, "entry"),
    ("no JSON", update(log, log.c.index == 5, payload="{"), 5, "entry"),
    ("time", update(log, log.c.index == 0, at="2020"), 0, "entry"),
    ("tenant", update(log, log.c.index == 3, tenant="other"), 3, "entry"),
    ("event", update(log, log.c.index == 2, event="other"), 2, "entry"),
    ("subject", update(log, log.c.index == 2, subject="other"), 2, "entry"),
    ("hash", update(log, log.c.index == 6, hash="00" * 32), 6, "entry"),
    ("forged entry", forge_entry, 4, "entry"),
    ("lost entry", delete(log, log.c.index == 7), 7, "gap"),
    ("lost first entry", delete(log, log.c.index == 0), 0, "gap"),
    ("leaf", update(audit_nodes, node(0, 8), hash="11" * 32), 8, "entry"),
    ("node", update(audit_nodes, node(2, 1), hash="11" * 32), 7, "tree"),
    ("lost node", delete(audit_nodes, node(1, 2)), 4, "tree"),
    ("lost top", delete(audit_nodes, audit_nodes.c.level == 3), 0, "tree"),
    ("asset", update(assets, assets.c.id == "b", message="other"), 9, "asset"),
    ("asset's owner", update(assets, assets.c.id == "a", tenant="other"), 1, "asset"),
    ("lost asset", delete(assets, assets.c.id == "a"), 1, "asset"),
    ("claim", forge_claim, 10, "claim"),
    ("unreadable claim", update(claims, claims.c.id == "c", document="{"), 10, "claim"),
    ("signature", swap_signature, 10, "signature"),
    ("lost claim", delete(claims, claims.c.id == "c"), 10, "claim"),
    ("cut short", delete(log, log.c.index == 10), None, "claim"),
]


@pytest.mark.parametrize(("alter", "index", "code"), [a[1:] for a in ALTERATIONS], ids=[a[0] for a in ALTERATIONS])
@pytest.mark.parametrize("settings", ["sqlite"], indirect=True)
def test_alterations_are_found(filled: Database, alter: Alter, index: int | None, code: str) -> None:
    with filled.write() as connection:
        alter(connection)
    report = verify_log(filled)
    assert not report.ok
    assert (report.faults[0].index, report.faults[0].code) == (index, code), report.text()
    assert "ALTERED" in report.text()


@pytest.mark.parametrize("settings", ["sqlite"], indirect=True)
def test_rows_that_the_log_never_heard_of_are_found(filled: Database) -> None:
    with filled.write() as connection:
        connection.execute(assets.insert().values(asset_row("smuggled")))
    (fault,) = verify_log(filled).faults
    assert fault.code == "asset"
    assert "does not know smuggled" in fault.text


@pytest.mark.parametrize("settings", ["sqlite"], indirect=True)
def test_a_claim_under_another_root_is_found(filled: Database, master: MasterKey) -> None:
    """A service that rebuilt its log cannot pass off the claims it had signed before."""
    with filled.write() as connection:
        row = connection.execute(claims.select()).one()
        document = json.loads(row.document)
        document["audit"]["root"] = "22" * 32
        payload = canonical(document)
        jws = signing.sign(connection, master, payload)
        connection.execute(claims.update().values(document=payload.decode(), jws=jws))
    (fault,) = verify_log(filled).faults
    assert (fault.index, fault.code) == (10, "claim")
    assert "another root" in fault.text
