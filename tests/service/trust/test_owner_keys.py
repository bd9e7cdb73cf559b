"""Owner keys: sealed to their place, never listed, really erased."""

from __future__ import annotations

from pathlib import Path

import pytest
import sqlalchemy as sa

from engine.watermark.keys import OwnerKey
from service.db import Database
from service.db.schema import audit, owner_keys
from service.problems import Problem
from service.trust import owner_keys as keys
from service.trust.master import MasterKey

KEY = OwnerKey(bytes(range(32)))


def test_a_stored_key_opens_and_never_shows(db: Database, master: MasterKey) -> None:
    info = keys.store(db, master, "acme", KEY, "studio")
    assert keys.open_key(db, master, "acme", info.id) == KEY
    assert [row.id for row in keys.list_keys(db, "acme")] == [info.id]
    assert (info.fingerprint, info.label) == (KEY.fingerprint, "studio")
    with db.read() as connection:
        everything = [value for t in (owner_keys, audit) for row in connection.execute(t.select()) for value in row]
    assert not [value for value in everything if isinstance(value, bytes) and KEY.secret[:8] in value]
    assert not [value for value in everything if isinstance(value, str) and KEY.secret[:8].hex() in value]


def is_gone(db: Database, master: MasterKey, tenant: str, key: str) -> None:
    for act in (lambda: keys.open_key(db, master, tenant, key), lambda: keys.delete(db, tenant, key)):
        with pytest.raises(Problem) as caught:
            act()
        assert caught.value.kind == "not-found"


def test_other_tenants_find_nothing(db: Database, master: MasterKey) -> None:
    info = keys.store(db, master, "acme", KEY)
    assert keys.list_keys(db, "other") == []
    is_gone(db, master, "other", info.id)
    assert keys.open_key(db, master, "acme", info.id) == KEY


def test_a_sealed_key_moved_to_another_row_does_not_open(db: Database, master: MasterKey) -> None:
    mine, theirs = keys.store(db, master, "me", KEY), keys.store(db, master, "them", OwnerKey.generate())
    with db.write() as connection:
        sealed = connection.execute(sa.select(owner_keys.c.sealed).where(owner_keys.c.id == theirs.id)).scalar_one()
        connection.execute(owner_keys.update().where(owner_keys.c.id == mine.id).values(sealed=sealed))
    with pytest.raises(Problem, match="altered, or moved"):
        keys.open_key(db, master, "me", mine.id)


def test_deleting_erases(db: Database, master: MasterKey) -> None:
    info = keys.store(db, master, "acme", KEY)
    keys.delete(db, "acme", info.id)
    assert keys.list_keys(db, "acme") == []
    is_gone(db, master, "acme", info.id)
    with db.read() as connection:
        assert connection.execute(sa.select(owner_keys.c.sealed)).scalar_one() is None


def test_the_same_key_is_kept_once_and_comes_back_under_its_id(db: Database, master: MasterKey) -> None:
    info = keys.store(db, master, "acme", KEY)
    with pytest.raises(Problem, match="is here already") as caught:
        keys.store(db, master, "acme", KEY)
    assert caught.value.kind == "conflict"
    assert keys.store(db, master, "other", KEY).id != info.id
    keys.delete(db, "acme", info.id)
    assert keys.store(db, master, "acme", KEY, "again").id == info.id
    assert keys.open_key(db, master, "acme", info.id) == KEY


def test_keys_are_read_from_digits_and_from_key_files(tmp_path: Path) -> None:
    assert keys.parse_key(KEY.secret.hex()) == KEY
    assert keys.parse_key(f"  {KEY.secret.hex().upper()}\n") == KEY
    KEY.write(tmp_path / "owner.key")
    assert keys.parse_key((tmp_path / "owner.key").read_text()) == KEY


@pytest.mark.parametrize(
    "text", ["", "ab", "ab" * 31, "abc" * 25, "00" * 32, "é" * 64, "ab" * 4096, "mark3dgs-owner-key 1 0 1", "PRIVATE"]
)
def test_what_is_no_key_is_refused_without_repeating_it(text: str) -> None:
    with pytest.raises(Problem) as caught:
        keys.parse_key(text)
    assert caught.value.kind == "invalid-request"
    assert not text or text not in caught.value.detail or len(text) < 4
