"""What was deleted leaves a tombstone; what is missing or damaged in the store is named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from service.blobs import Blobs, blob_name
from service.db import Database
from service.db.schema import assets, audit, claims, uploads
from service.problems import Problem
from service.trust import signing
from service.trust.audit_check import verify_log
from service.trust.canonical import canonical
from service.trust.commitments import commit_claim, forget, registration_of
from service.trust.master import MasterKey
from tests.service.rows import add_asset, put

FILES = ("original", "model", "record", "preview", "sketch")


@pytest.fixture
def blobs(tmp_path: Path) -> Blobs:
    return Blobs("", tmp_path / "blobs", tmp_path / "scratch")


@pytest.fixture
def filled(db: Database, master: MasterKey, blobs: Blobs) -> Database:
    """An asset "a" and a claim "c" about it, with files, and an upload."""
    signing.ensure_key(db, master)
    files = {f"{name}_sha256": put(blobs, name.encode()) for name in FILES}
    add_asset(db, commit=True, id="a", tenant="acme", **files)
    with db.write() as connection:
        document: dict[str, Any] = {"claim_id": "c", "asset": "a", "z": 1.0}
        document["audit"] = commit_claim(connection, "acme", document, registration_of(connection, "a"))
        payload = canonical(document)
        claim = {"id": "c", "tenant": "acme", "job": "j", "asset": "a", "document": payload.decode()}
        claim |= {"pictures": canonical({"suspect": put(blobs, b"picture")}).decode()}
        claim |= {"jws": signing.sign(connection, master, payload), "created_at": "now"}
        connection.execute(claims.insert().values(claim))
        upload = {"id": "up", "tenant": "acme", "created_at": "now", "name": "", "parts": "[]", "state": "complete"}
        upload |= {"received": 6, "size": 6}
        connection.execute(uploads.insert().values(upload | {"sha256": put(blobs, b"upload")}))
    return db


@pytest.mark.parametrize(("table", "name"), [(assets, "a"), (claims, "c")])
def test_a_tombstone(filled: Database, table: sa.Table, name: str) -> None:
    with filled.read() as connection:
        row = connection.execute(table.select()).one()._asdict()
    with pytest.raises(Problem, match="there is no"):
        forget(filled, table, "other", name)
    forget(filled, table, "acme", name)
    with pytest.raises(Problem, match="there is no"):
        forget(filled, table, "acme", name)
    report = verify_log(filled)
    assert report.ok, report.text()
    with filled.write() as connection:
        connection.execute(table.insert().values(row))
    assert "was deleted by this entry, and its row is there" in verify_log(filled).text()


def test_a_row_that_is_gone_without_a_tombstone_is_a_fault(filled: Database) -> None:
    with filled.write() as connection:
        connection.execute(sa.delete(claims))
    assert "the row of c is gone" in verify_log(filled).text()
    forget(filled, assets, "acme", "a")
    report = verify_log(filled)
    assert [fault.code for fault in report.faults] == ["claim"], "a tombstone speaks for one row"
    with filled.read() as connection:
        events = connection.execute(sa.select(audit.c.event).order_by(audit.c.index)).scalars().all()
    assert events[-1] == "asset.deleted"


def test_a_whole_store_holds(filled: Database, blobs: Blobs) -> None:
    report = verify_log(filled, blobs)
    assert report.ok, report.text()
    assert report.files == 7


@pytest.mark.parametrize("what", [*FILES, "picture", "upload"])
@pytest.mark.parametrize("how", ["missing", "damaged"])
def test_a_file_that_is_missing_or_damaged_is_named(filled: Database, blobs: Blobs, what: str, how: str) -> None:
    digest = put(blobs, what.encode())
    path = blobs.folder / blob_name(digest)  # type: ignore[operator]
    if how == "missing":
        path.unlink()
    else:
        data = bytearray(path.read_bytes())
        data[2] ^= 1
        path.write_bytes(data)
    report = verify_log(filled, blobs)
    assert not report.ok
    (fault,) = report.faults
    assert (fault.code, fault.index) == ("file", None)
    owner = {"picture": "the picture suspect of c (acme)", "upload": "the upload up (acme)"}
    assert owner.get(what, f"the {what} of a (acme)") in fault.text
    assert fault.text.endswith(f"{digest} is {how}")
    assert report.text().startswith("FILES ARE MISSING OR DAMAGED")
    assert verify_log(filled).ok, "the log itself holds"
