"""Owner keys: what a tenant's marks are made with. Kept sealed, never listed, erased when deleted."""

import re
import secrets
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa

from engine.errors import KeyFileError
from engine.watermark.keys import OwnerKey
from service.clock import now
from service.db import Database
from service.db.schema import owner_keys
from service.problems import Problem
from service.trust import audit
from service.trust.master import VERSION, MasterKey, bind

MOST_TEXT = 4096
"""Characters of an imported key, comments included."""

_HEX = re.compile(r"[0-9a-fA-F\s]+", re.ASCII)


def parse_key(text: str) -> OwnerKey:
    """An owner key from hexadecimal digits (64 or more), or from the text of a key file, which no error repeats."""
    try:
        if len(text) > MOST_TEXT or not text.isascii():
            raise KeyFileError(f"an owner key is at most {MOST_TEXT} ASCII characters")
        if _HEX.fullmatch(text):
            return OwnerKey(bytes.fromhex(text))
        return OwnerKey.from_text(text)
    except KeyFileError as error:
        raise Problem("invalid-request", str(error)) from None
    except ValueError:
        raise Problem("invalid-request", "the key has an odd number of hexadecimal digits") from None


def store(db: Database, master: MasterKey, tenant: str, key: OwnerKey, label: str = "") -> Any:
    """The row of a key that is kept from now on ("conflict" where the tenant has it). One that was deleted comes back
    under its old id, so that its marks can be verified again."""
    with db.exclusive() as connection:
        same = sa.and_(owner_keys.c.tenant == tenant, owner_keys.c.fingerprint == key.fingerprint)
        row = connection.execute(owner_keys.select().where(same)).one_or_none()
        if row is not None and row.deleted_at is None:
            raise Problem("conflict", f"this owner key is here already, as {row.id!r}")
        key_id = row.id if row is not None else secrets.token_hex(16)
        values: dict[str, object] = {
            "version": VERSION,
            "sealed": master.seal(key.secret, _bound(tenant, key_id, VERSION)),
            "label": label,
            "created_at": now(),
            "deleted_at": None,
        }
        if row is not None:
            connection.execute(owner_keys.update().where(owner_keys.c.id == key_id).values(values))
        else:
            values |= {"id": key_id, "tenant": tenant, "fingerprint": key.fingerprint}
            connection.execute(owner_keys.insert().values(values))
        audit.append(connection, tenant, "owner_key.stored", {"fingerprint": key.fingerprint}, key_id)
        return connection.execute(owner_keys.select().where(owner_keys.c.id == key_id)).one()


def open_key(db: Database, master: MasterKey, tenant: str, key_id: str) -> OwnerKey:
    """The key itself; "not-found" where this tenant has no such key (any more)."""
    row = db.query(owner_keys.select().where(_this(tenant, key_id))).one_or_none()
    if row is None:
        raise Problem("not-found", f"there is no owner key {key_id!r}")
    return OwnerKey(master.unseal(row.sealed, seal_of(row)))


def list_keys(db: Database, tenant: str) -> Sequence[Any]:
    """Rows of a tenant's keys, oldest first."""
    query = owner_keys.select().where(owner_keys.c.tenant == tenant, owner_keys.c.deleted_at.is_(None))
    return db.query(query.order_by(owner_keys.c.created_at, owner_keys.c.id)).all()


def delete(db: Database, tenant: str, key_id: str) -> None:
    """Erase a key. What was marked with it can be verified again only once its owner imports it again."""
    with db.exclusive() as connection:
        gone = owner_keys.update().where(_this(tenant, key_id)).values(sealed=None, deleted_at=now())
        if connection.execute(gone).rowcount == 0:
            raise Problem("not-found", f"there is no owner key {key_id!r}")
        audit.append(connection, tenant, "owner_key.deleted", {}, key_id)


def seal_of(row: Any) -> bytes:
    """What the seal of a row's key is bound to."""
    return _bound(row.tenant, row.id, row.version)


def _this(tenant: str, key_id: str) -> sa.ColumnElement[bool]:
    return (owner_keys.c.id == key_id) & (owner_keys.c.tenant == tenant) & owner_keys.c.deleted_at.is_(None)


def _bound(tenant: str, key_id: str, version: int) -> bytes:
    return bind("owner key", tenant, key_id, version)
