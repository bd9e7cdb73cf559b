"""The audit log: append-only, each entry bound to all before it, under one Merkle root (RFC 6962).

An entry's leaf is the canonical JSON of its row with the hash of the entry before it; its hash is the leaf's
hash in the tree. So a chain of hashes and a tree stand on the same numbers: the chain makes order and
completeness plain, the tree proves a single entry to a reader who sees no other.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from engine.records import merkle
from engine.records.merkle import Node
from service.clock import now
from service.db import take_write_lock
from service.db.schema import audit, audit_nodes
from service.trust.canonical import canonical

NO_PREVIOUS = bytes(32).hex()
"""What stands for the hash before the first entry."""


@dataclass(frozen=True)
class Entry:
    """One entry of the log."""

    index: int
    at: str  # UTC, ISO 8601
    tenant: str
    event: str
    subject: str  # id of what it is about
    payload: Mapping[str, Any]  # digests and public facts, never secrets
    previous: str  # hash of the entry before, hex

    def to_json(self) -> dict[str, Any]:
        """What the leaf says."""
        return dict(vars(self))

    @property
    def hash(self) -> str:
        """Hash of the leaf, hex."""
        return merkle.leaf_hash(canonical(self.to_json())).hex()


def append(
    connection: sa.Connection, tenant: str, event: str, payload: Mapping[str, Any], subject: str = "", at: str = ""
) -> Entry:
    """Add an entry of now (`at`: as the caller wrote it into a row); it stands once his transaction is committed.

    Appenders wait for one another until they commit, so append last, where there is a choice. O(log n).
    """
    take_write_lock(connection)
    query = sa.select(audit.c.index, audit.c.hash).order_by(audit.c.index.desc()).limit(1)
    last = connection.execute(query).one_or_none()
    index, previous = (last[0] + 1, last[1]) if last is not None else (0, NO_PREVIOUS)
    entry = Entry(index, at or now(), tenant, event, subject, dict(payload), previous)
    found = entry.hash
    row = entry.to_json() | {"payload": canonical(entry.payload).decode(), "hash": found}
    connection.execute(audit.insert().values({column.name: row[column.name] for column in audit.columns}))
    grown = list(merkle.completed_by(index))
    siblings = _fetch(connection, [(level - 1, 2 * position) for level, position in grown[1:]])
    node, rows = bytes.fromhex(found), []
    for level, position in grown:
        if level:
            node = merkle.node_hash(siblings[level - 1, 2 * position], node)
        rows.append({"level": level, "position": position, "hash": node.hex()})
    connection.execute(audit_nodes.insert(), rows)
    return entry


def size(connection: sa.Connection) -> int:
    """Number of entries."""
    last: int | None = connection.execute(sa.select(sa.func.max(audit.c.index))).scalar_one()
    return 0 if last is None else last + 1


def root(connection: sa.Connection, size: int) -> str:
    """Merkle root of the first `size` entries, hex."""
    return merkle.root(size, lambda nodes: _fetch(connection, nodes)).hex()


def inclusion_proof(connection: sa.Connection, index: int, size: int) -> list[str]:
    """Proof that entry `index` is under the root of the first `size` entries; hex, lowest first."""
    proof = merkle.inclusion_proof(index, size, lambda nodes: _fetch(connection, nodes))
    return [step.hex() for step in proof]


def consistency_proof(connection: sa.Connection, first: int, size: int) -> list[str]:
    """Proof that the log of `first` entries is the beginning of that of `size`; hex, lowest first."""
    proof = merkle.consistency_proof(first, size, lambda nodes: _fetch(connection, nodes))
    return [step.hex() for step in proof]


def proven(connection: sa.Connection, entry: Entry) -> dict[str, Any]:
    """An entry and its proof under the root of the log as it stood then, whatever has come since."""
    size = entry.index + 1
    proof = inclusion_proof(connection, entry.index, size)
    return {"entry": entry.to_json(), "size": size, "root": root(connection, size), "proof": proof}


def find(connection: sa.Connection, event: str, subject: str) -> Entry | None:
    """The first entry of this event about this subject."""
    query = audit.select().where(audit.c.event == event, audit.c.subject == subject)
    row = connection.execute(query.order_by(audit.c.index).limit(1)).one_or_none()
    if row is None:
        return None
    before = sa.select(audit.c.hash).where(audit.c.index == row[0] - 1)
    previous: str | None = connection.execute(before).scalar_one_or_none()
    return entry_of(tuple(row), previous or NO_PREVIOUS)


def last(connection: sa.Connection, event: str) -> int | None:
    """Index of the last entry of this event."""
    query = sa.select(audit.c.index).where(audit.c.event == event).order_by(audit.c.index.desc()).limit(1)
    found: int | None = connection.execute(query).scalar()
    return found


def entry_of(row: Sequence[Any], previous: str) -> Entry:
    """The entry of a row of the table `audit`, after the entry with the hash `previous`."""
    index, at, tenant, event, subject, payload, _ = row
    return Entry(index, at, tenant, event, subject, json.loads(payload), previous)


def _fetch(connection: sa.Connection, nodes: list[Node]) -> dict[Node, bytes]:
    """Hashes of perfect subtrees, all in one query."""
    if not nodes:
        return {}
    wanted = sa.or_(*(sa.and_(audit_nodes.c.level == level, audit_nodes.c.position == place) for level, place in nodes))
    rows = connection.execute(audit_nodes.select().where(wanted)).all()
    found = {(row.level, row.position): bytes.fromhex(row.hash) for row in rows}
    if missing := set(nodes) - set(found):
        raise LookupError(f"the audit log lacks the subtrees {sorted(missing)}")
    return found
