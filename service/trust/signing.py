"""Signatures: Ed25519 keys that sign claims (JWS), and their public halves (JWKS)."""

import json
from typing import Any

import sqlalchemy as sa
from joserfc import jws
from joserfc.jwk import OKPKey

from engine.records.signatures import ALGORITHM, CLAIM
from service.clock import now
from service.db import Database
from service.db.schema import signing_keys
from service.problems import Problem
from service.trust import audit
from service.trust.canonical import canonical
from service.trust.master import MasterKey, bind

TENANT = ""
"""Signing keys belong to the service, not to a tenant."""


def ensure_key(db: Database, master: MasterKey) -> str:
    """Id of the key that signs; the first call makes it."""
    with db.exclusive() as connection:
        row = _active(connection)
        return str(row.kid) if row is not None else _make(connection, master)


def rotate(db: Database, master: MasterKey) -> str:
    """Retire the key that signs and make another; returns its id. What the old one signed stays valid."""
    with db.exclusive() as connection:
        active = signing_keys.c.retired_at.is_(None)
        connection.execute(signing_keys.update().where(active).values(retired_at=now()))
        return _make(connection, master)


def jwks(db: Database) -> dict[str, list[dict[str, str]]]:
    """The public keys, retired ones too, newest first (RFC 7517)."""
    rows = db.query(signing_keys.select().order_by(signing_keys.c.created_at.desc())).all()
    return {"keys": [json.loads(row.public) for row in rows]}


def sign(connection: sa.Connection, master: MasterKey, payload: bytes, kind: str = CLAIM) -> str:
    """Compact JWS of a payload of this kind by the key that signs at present; "internal" where none opens."""
    row = _active(connection)
    if row is None:
        raise Problem("internal", "there is no signing key")
    private = master.unseal(row.sealed, private_seal(row))
    header = {"alg": ALGORITHM, "kid": row.kid, "typ": kind}
    return jws.serialize_compact(header, payload, OKPKey.import_key(json.loads(private)), [ALGORITHM])


def private_seal(row: Any) -> bytes:
    """What the seal of a key's private half is bound to."""
    return bind("signing key", row.kid)


def _active(connection: sa.Connection) -> sa.Row[Any] | None:
    query = signing_keys.select().where(signing_keys.c.retired_at.is_(None))
    return connection.execute(query.order_by(signing_keys.c.created_at.desc()).limit(1)).one_or_none()


def _make(connection: sa.Connection, master: MasterKey) -> str:
    key = OKPKey.generate_key("Ed25519", private=True)
    kid = key.thumbprint()  # RFC 7638: the id says which key it is, to anyone
    public = {**key.as_dict(private=False), "kid": kid, "alg": ALGORITHM, "use": "sig"}
    private = canonical(key.as_dict(private=True))
    row = {"kid": kid, "public": canonical(public).decode(), "created_at": now()}
    connection.execute(signing_keys.insert().values(**row, sealed=master.seal(private, bind("signing key", kid))))
    audit.append(connection, TENANT, "signing_key.made", {"public": public}, kid)
    return kid
