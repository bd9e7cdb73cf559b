"""What the audit log commits to: the row of each asset and the document of each claim, by digest."""

from collections.abc import Mapping
from hashlib import sha256
from typing import Any

import sqlalchemy as sa

from service.db import Database, missing
from service.db.schema import assets
from service.problems import Problem
from service.trust import audit
from service.trust.audit import Entry
from service.trust.canonical import digest

ASSET_REGISTERED = "asset.registered"
CLAIM_ISSUED = "claim.issued"
ACQUISITION_MADE = "acquisition.made"
DELETED = {"acquisitions": "acquisition.deleted", "assets": "asset.deleted", "claims": "claim.deleted"}
"""Tombstones, by table."""


def asset_digest(row: Mapping[str, Any]) -> str:
    """Digest of a whole row of the table `assets`."""
    return digest({column.name: row[column.name] for column in assets.columns})


def commit_asset(connection: sa.Connection, row: Mapping[str, Any], drawn: str = "", at: str = "") -> Entry:
    """Log the registration of an asset, in the transaction that inserts its row (every column of it).

    `drawn` is what was drawn for the record's plan; the log keeps its digest. `at` is the time that the caller
    wrote into the row, now and under the log's lock: an asset has one.
    """
    payload = {name: row[name] for name in ("original_sha256", "record_id", "record_sha256")}
    payload["digest"] = asset_digest(row)
    if drawn:
        payload["drawn_sha256"] = sha256(drawn.encode()).hexdigest()
    return audit.append(connection, row["tenant"], ASSET_REGISTERED, payload, row["id"], at)


def acquisition_facts(row: Mapping[str, Any]) -> dict[str, str | None]:
    """What the log and a time stamp say of an acquisition, by the digest of its canonical form."""
    return {name: row[name] for name in ("id", "url", "at", "payload_sha256", "warc_sha256")}


def forget(db: Database, table: sa.Table, tenant: str, row_id: str) -> None:
    """Delete an asset, a claim or an acquisition for good; the log keeps what it said, and that the row was deleted."""
    with db.exclusive() as connection:
        this = (table.c.id == row_id) & (table.c.tenant == tenant)
        if connection.execute(sa.delete(table).where(this)).rowcount == 0:
            raise missing(table, row_id)
        audit.append(connection, tenant, DELETED[table.name], {}, row_id)


def registration_of(connection: sa.Connection, asset: str) -> Entry:
    """The entry that logged an asset's registration; "internal" if there is none: log or table were altered."""
    entry = audit.find(connection, ASSET_REGISTERED, asset)
    if entry is None:
        raise Problem("internal", f"the audit log does not know the asset {asset!r}")
    return entry


def claim_digest(document: Mapping[str, Any]) -> str:
    """Digest of a claim's document without its member `audit`, which is made after it."""
    return digest({name: value for name, value in document.items() if name != "audit"})


def commit_claim(
    connection: sa.Connection,
    tenant: str,
    document: Mapping[str, Any],
    registration: Entry | None,
    first: Entry | None = None,
    acquisition: Entry | None = None,
) -> dict[str, Any]:
    """Log a claim, and return its member `audit`: the entry, and the proof that it is in the log.

    The registration of the asset, the `first` of its original, and the `acquisition` of the suspect are proven under
    the same root, so that a reader sees which came first. The log right after the registration, whose root the record's
    attestation has, and that right after the claim before are proven to be the beginning of this one.
    """
    ends = {None if registration is None else registration.index, audit.last(connection, CLAIM_ISSUED)}
    payload = {"asset": document["asset"], "digest": claim_digest(document)}
    entry = audit.append(connection, tenant, CLAIM_ISSUED, payload, document["claim_id"])
    size = entry.index + 1

    def proven(logged: Entry) -> dict[str, Any]:
        return {"entry": logged.to_json(), "proof": audit.inclusion_proof(connection, logged.index, size)}

    def begun(first: int) -> dict[str, int | str | list[str]]:
        proof = audit.consistency_proof(connection, first, size)
        return {"size": first, "root": audit.root(connection, first), "proof": proof}

    place = {"index": entry.index, **audit.proven(connection, entry)}
    place["earlier"] = [begun(index + 1) for index in sorted(index for index in ends if index is not None)]
    named = {"registration": registration, "first_registration": first, "acquisition": acquisition}
    return place | {name: proven(logged) if logged is not None else None for name, logged in named.items()}
