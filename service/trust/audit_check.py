"""Checking the whole audit log against itself, and the rows that it commits to against the log."""

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Protocol

import sqlalchemy as sa
from sqlalchemy.orm import aliased

from engine.records import merkle
from engine.records.signatures import SignatureFault, verify
from service.db import Database
from service.db.schema import acquisitions, assets, audit_nodes, claims, manifests, uploads
from service.db.schema import audit as log
from service.trust import audit
from service.trust.canonical import canonical
from service.trust.commitments import ASSET_REGISTERED, CLAIM_ISSUED, DELETED, asset_digest, claim_digest
from service.trust.signing import jwks

MOST_FAULTS = 100
_PAGE = 1000


class Stored(Protocol):
    """Stored files: `service.blobs.Blobs`, or those of a backup."""

    def digest_found(self, sha256: str) -> str:
        """SHA-256 of the bytes that lie under that digest; "" where there are none."""


@dataclass(frozen=True)
class Fault:
    """Something that was altered."""

    index: int | None  # in the log; None for a row without an entry
    code: str  # entry, chain, gap, tree, asset, claim, signature or file
    text: str


@dataclass(frozen=True)
class LogReport:
    """What a check of the log found."""

    entries: int
    root: str  # Merkle root over all of them, hex; "" where the tree is broken
    assets: int  # rows compared with the log
    claims: int
    files: int  # stored files compared with their digests
    faults: tuple[Fault, ...]  # in the order of the log, at most MOST_FAULTS

    @property
    def ok(self) -> bool:
        """Whether nothing was altered."""
        return not self.faults

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self) | {"ok": self.ok}

    def text(self) -> str:
        """For people."""
        seen = f"{self.entries} entries, {self.assets} assets, {self.claims} claims, {self.files} files"
        if self.ok:
            return f"The log holds: {seen}. Root {self.root}"
        damaged = all(fault.code == "file" for fault in self.faults)
        lines = [f"{'FILES ARE MISSING OR DAMAGED' if damaged else 'THE LOG WAS ALTERED'} ({seen}):"]
        for fault in self.faults:
            nowhere = "the store" if fault.code == "file" else "no entry"
            where = f"entry {fault.index}" if fault.index is not None else nowhere
            lines.append(f"  {where}: {fault.code}: {fault.text}")
        return "\n".join(lines)


def verify_log(db: Database, blobs: Stored | None = None) -> LogReport:
    """Recompute chain and tree, and compare every asset and claim with what the log says of it; with the store given,
    every file that a row names with its digest.

    What it cannot see: a log cut short together with the rows its last entries spoke of. The root in any
    claim handed out since shows that.
    """
    keys = jwks(db)
    with db.read() as connection:
        # Taken before the log, so that a row committed meanwhile does not seem to be missing from the log.
        known = [(ASSET_REGISTERED, name) for name in connection.execute(sa.select(assets.c.id)).scalars()]
        known += [(CLAIM_ISSUED, name) for name in connection.execute(sa.select(claims.c.id)).scalars()]
        size = audit.size(connection)
        faults, events = _check_chain(connection, size)
        broken = _check_tree(connection, size)
        faults += broken
        root = "" if broken else audit.root(connection, size)
        claim_fault = partial(_claim_fault, connection, keys, bool(root))
        faults += _check_rows(connection, events, ASSET_REGISTERED, assets, _asset_fault)
        faults += _check_rows(connection, events, CLAIM_ISSUED, claims, claim_fault)
    for event, subject in known:
        if (event, subject) not in events:
            faults.append(Fault(None, event.split(".")[0], f"the log does not know {subject}"))
    files, damaged = _check_files(db, blobs) if blobs is not None else (0, [])
    faults += damaged
    faults.sort(key=lambda fault: size if fault.index is None else fault.index)
    registered, issued = (sum(event == name for event, _ in known) for name in (ASSET_REGISTERED, CLAIM_ISSUED))
    return LogReport(size, root, registered, issued, files, tuple(faults[:MOST_FAULTS]))


Events = dict[tuple[str, str], tuple[int, str]]
"""(event, subject) -> (index, digest): what the log commits to."""


def _check_chain(connection: sa.Connection, size: int) -> tuple[list[Fault], Events]:
    """Every entry against its own hash and the one before it, and against its leaf of the tree."""
    leaf = sa.and_(audit_nodes.c.level == 0, audit_nodes.c.position == log.c.index)
    query = sa.select(log, audit_nodes.c.hash.label("leaf")).select_from(log.outerjoin(audit_nodes, leaf))
    faults: list[Fault] = []
    events: Events = {}
    previous, expected = audit.NO_PREVIOUS, 0
    for row in _all(connection, query.where(log.c.index < size), log.c.index):
        *columns, leaf_hash = list(row)
        index, _, _, event, subject, payload, found = columns
        if index != expected:
            faults.append(Fault(expected, "gap", f"entries {expected} to {index - 1} are missing"))
        fault = _entry_fault(columns, previous)
        if fault is None and leaf_hash != found:
            fault = "the tree holds another hash for it"
        if fault is not None:
            faults.append(Fault(index, "entry", fault))
        if event in (ASSET_REGISTERED, CLAIM_ISSUED, *DELETED.values()):
            with suppress(ValueError, AttributeError):
                events[event, subject] = (index, str(json.loads(payload).get("digest")))
        previous, expected = found, index + 1
    return faults, events


def _entry_fault(columns: list[Any], previous: str) -> str | None:
    try:
        entry = audit.entry_of(columns, previous)
        if canonical(entry.payload).decode() != columns[5]:
            return "its payload is not in canonical form"
        return None if entry.hash == columns[6] else "it does not give its hash, or does not follow the one before"
    except (ValueError, TypeError) as error:
        return f"it cannot be read: {error}"


def _check_tree(connection: sa.Connection, size: int) -> list[Fault]:
    """Every inner node against the two below it; leaves were compared with the entries."""
    upper, left, right = audit_nodes, aliased(audit_nodes), aliased(audit_nodes)

    def child(side: Any, offset: int) -> sa.ColumnElement[bool]:
        return sa.and_(side.c.level == upper.c.level - 1, side.c.position == 2 * upper.c.position + offset)

    joined = upper.outerjoin(left, child(left, 0)).outerjoin(right, child(right, 1))
    query = sa.select(upper.c.position, upper.c.hash, left.c.hash, right.c.hash).select_from(joined)
    faults = []
    for level in range(1, size.bit_length()):
        expected = 0
        here = query.where(upper.c.level == level, upper.c.position < size >> level)
        for position, found, *below in (list(row) for row in _all(connection, here, upper.c.position)):
            if position != expected:
                faults.append(_lost(level, expected))
            elif None in below or merkle.node_hash(*map(bytes.fromhex, below)).hex() != found:
                text = f"the subtree of 2^{level} entries that ends here is not the hash of its halves"
                faults.append(Fault((position + 1 << level) - 1, "tree", text))
            expected = position + 1
        if expected < size >> level:
            faults.append(_lost(level, expected))
    return faults


def _check_files(db: Database, blobs: Stored) -> tuple[int, list[Fault]]:
    """Every stored file that a row needs, hashed; what is missing or damaged is named by what it is."""
    named: dict[str, list[str]] = {}
    with db.read() as connection:
        for row in _all(connection, assets.select(), assets.c.id):
            for name in ("original", "model", "record", "preview", "sketch"):
                named.setdefault(getattr(row, f"{name}_sha256"), []).append(f"the {name} of {row.id} ({row.tenant})")
        for row in _all(connection, claims.select(), claims.c.id):
            for name, digest in json.loads(row.pictures).items():
                named.setdefault(digest, []).append(f"the picture {name} of {row.id} ({row.tenant})")
        for row in _all(connection, acquisitions.select(), acquisitions.c.id):
            named.setdefault(row.warc_sha256, []).append(f"the acquisition {row.id} ({row.tenant})")
        for row in _all(connection, manifests.select(), manifests.c.id):
            named.setdefault(row.sha256, []).append(f"the manifest {row.id} of {row.asset}")
        for row in _all(connection, uploads.select().where(uploads.c.state == "complete"), uploads.c.id):
            named.setdefault(row.sha256, []).append(f"the upload {row.id} ({row.tenant})")
    faults = []
    for digest, whose in named.items():
        if (found := blobs.digest_found(digest)) != digest:
            text = f"{', '.join(whose)}: the file {digest} is {'damaged' if found else 'missing'}"
            faults.append(Fault(None, "file", text))
    return len(named), faults


def _lost(level: int, position: int) -> Fault:
    return Fault(position << level, "tree", f"the subtree of 2^{level} entries that begins here is missing")


def _check_rows(
    connection: sa.Connection,
    events: Events,
    event: str,
    table: sa.Table,
    fault_of: Callable[[sa.Row[Any], int, str], tuple[str, str] | None],
) -> list[Fault]:
    """Every row of a table against what the log says of it, and what the log knows and the table does not."""
    faults, seen, tombstone = [], set(), DELETED[table.name]
    for row in _all(connection, table.select(), table.c.id):
        seen.add(row.id)
        if (grave := events.get((tombstone, row.id))) is not None:
            text = f"{row.id} was deleted by this entry, and its row is there"
            faults.append(Fault(grave[0], event.split(".")[0], text))
        index, digest = events.get((event, row.id), (None, ""))
        if index is not None and (found := fault_of(row, index, digest)) is not None:
            faults.append(Fault(index, *found))
    gone = [(index, name) for (kind, name), (index, _) in events.items() if kind == event and name not in seen]
    gone = [(index, name) for index, name in gone if (tombstone, name) not in events]
    return faults + [Fault(index, event.split(".")[0], f"the row of {name} is gone") for index, name in gone]


def _asset_fault(row: sa.Row[Any], index: int, digest: str) -> tuple[str, str] | None:
    same = asset_digest(row._asdict()) == digest
    return None if same else ("asset", f"the row of {row.id} is not the one that was registered")


def _claim_fault(
    connection: sa.Connection, keys: dict[str, Any], tree_holds: bool, row: sa.Row[Any], index: int, digest: str
) -> tuple[str, str] | None:
    try:
        document = json.loads(row.document)
        if claim_digest(document) != digest or document["claim_id"] != row.id:
            return "claim", f"the document of {row.id} is not the one that was issued"
        if verify(row.jws, keys)[0] != row.document.encode():
            return "signature", f"what is signed as {row.id} is not its document"
        if tree_holds and audit.root(connection, index + 1) != document["audit"]["root"]:
            return "claim", f"{row.id} was handed out with another root of this log"
    except SignatureFault as error:
        return "signature", f"{row.id}: {error}"
    except (ValueError, KeyError, TypeError) as error:
        return "claim", f"the document of {row.id} cannot be read: {error}"
    return None


def _all(connection: sa.Connection, query: sa.Select[Any], key: sa.Column[Any]) -> Iterator[sa.Row[Any]]:
    """All rows in the order of a unique column, a page at a time: no long cursor, little memory."""
    page = query.order_by(key).limit(_PAGE)
    rows = connection.execute(page).all()
    while rows:
        yield from rows
        rows = connection.execute(page.where(key > rows[-1]._mapping[key])).all()
