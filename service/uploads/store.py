"""Upload slots: their rows, their parts, and the blob they become; and how much a tenant stores.

A slot's row is the truth: it names the parts that were accepted, each with length and digest. The bytes of a request
are stored under a name of their own first, and count from the one statement on that moves the row's offset from where
the request began (compare and set). A request that loses this race, or dies, leaves at most a file that no row names.
"""

import hashlib
import json
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import sqlalchemy as sa

from engine.formats.image_files import is_picture
from service.clock import now
from service.core import Service
from service.db import missing, own
from service.db.schema import acquisitions, assets, uploads
from service.problems import Problem
from service.settings import Settings
from service.trust.api_keys import Caller

_CHUNK = 4 << 20
_TEXT = 1024  # bytes that tell JSON from numbers
PARTS = "upload"
"""Folder of the store in which the parts of uploads under way lie."""


@dataclass(frozen=True)
class Received:
    """The body of a request: bytes, their digest, and whether it came to its end."""

    length: int
    sha256: str
    whole: bool


def create(service: Service, caller: Caller, name: str, size: int | None, sha256: str | None) -> Any:
    """A new slot, which belongs to the caller's API key."""
    tenant = caller.tenant
    limit, most = service.settings.max_upload_bytes, service.settings.open_uploads
    if size is not None and size > limit:
        raise Problem("too-large", f"an upload of {size} bytes exceeds the limit of {limit}")
    if size is not None and size > service.blobs.free_bytes():
        raise Problem("storage-full", f"there is no room for an upload of {size} bytes")
    upload_id = f"up_{secrets.token_hex(12)}"
    values = {"id": upload_id, "tenant": tenant, "name": name, "size": size, "sha256": sha256, "parts": "[]"}
    values |= {"api_key": caller.key_id, "received": 0, "state": "open", "created_at": now()}
    with service.db.exclusive() as connection:
        check_quota(connection, service.settings, tenant, size or 0)
        if under_way(connection, tenant) >= most:
            raise Problem("budget-exceeded", f"{most} uploads are under way: finish or delete some")
        connection.execute(uploads.insert().values(values))
    return get(service, caller, upload_id)


def under_way(connection: sa.Connection, tenant: str) -> int:
    """How many slots of a tenant wait for bytes."""
    opened = sa.select(sa.func.count()).where((uploads.c.tenant == tenant) & (uploads.c.state == "open"))
    return int(connection.execute(opened).scalar_one())


def get(service: Service, caller: Caller, upload_id: str) -> Any:
    """The row of a slot; not-found where it is not the caller's."""
    row = own(service.db, uploads, caller.tenant, upload_id)
    if not caller.may("admin") and row.api_key != caller.key_id:
        raise missing(uploads, upload_id)
    return row


def of(caller: Caller) -> sa.ColumnElement[bool]:
    """Uploads of the tenant that are the caller's: those of its API key, and all for `admin`."""
    return sa.true() if caller.may("admin") else uploads.c.api_key == caller.key_id


def room(service: Service, row: Any) -> int:
    """Bytes that may still come: as many as were announced, or else as the limits leave."""
    if row.size is not None:
        return int(row.size - row.received)
    return min(service.settings.max_upload_bytes - int(row.received), left(service, row.tenant))


def left(service: Service, tenant: str) -> int:
    """Bytes that a tenant may still store."""
    with service.db.read() as connection:
        return service.settings.tenant_bytes - stored_bytes(connection, tenant)


def add_part(service: Service, row: Any, path: Path, got: Received) -> Any:
    """The row with the bytes from `row.received` on; conflict if another request was faster."""
    name = f"{PARTS}/{row.id}/{row.received:016d}-{secrets.token_hex(8)}"
    service.blobs.put_part(path, name)
    parts = [*json.loads(row.parts), [name, got.length, got.sha256]]
    moved = {"received": row.received + got.length, "parts": json.dumps(parts)}
    if not service.db.change(sa.update(uploads).where(_unchanged(row)).values(moved)):
        service.blobs.remove_part(name)
        _refuse(service, row)
    return _again(service, row)


def complete(service: Service, row: Any, path: Path, got: Received) -> Any:
    """The row once its last bytes have come, and the whole is a blob."""
    parts, total = json.loads(row.parts), row.received + got.length
    with service.blobs.new_file() as whole:
        sha256 = got.sha256
        if parts:
            sha256 = _join(service, row, parts, path, whole)
            path = whole
        if row.sha256 not in (None, sha256):
            text = f"the bytes have SHA-256 {sha256}, announced was {row.sha256}; the upload was dropped"
            _give_up(service, row, Problem("digest-mismatch", text))
        service.blobs.put(path, sha256)
    with service.db.exclusive() as connection:
        if row.size is None:  # its bytes did not count yet, and others may have come meanwhile
            check_quota(connection, service.settings, row.tenant, got.length)
        done = {"received": total, "size": total, "sha256": sha256, "state": "complete", "parts": "[]"}
        first = connection.execute(sa.update(uploads).where(_unchanged(row)).values(done)).rowcount > 0
    if not first:
        _refuse(service, row)
    _remove(service, row)
    return _again(service, row)


def note(service: Service, row: Any, info: Mapping[str, object]) -> Any:
    """What the inspection found."""
    service.db.change(sa.update(uploads).where(uploads.c.id == row.id).values(info=json.dumps(info)))
    return _again(service, row)


def drop(service: Service, row: Any) -> None:
    """Forget a slot and its parts. Its blob, if nothing else uses it, goes with the next sweep."""
    service.db.change(sa.delete(uploads).where(uploads.c.id == row.id))
    _remove(service, row)


def part_names(parts: str) -> list[str]:
    """Names in the store of the parts that a row's `parts` lists."""
    return [name for name, _, _ in json.loads(parts)]


def kind_of(path: Path, name: str) -> str:
    """model, picture or cameras, by what a file holds; `name` is what its owner calls it."""
    if is_picture(path, name):
        return "picture"
    with path.open("rb") as file:
        text = file.read(_TEXT).lstrip()
        if text[:1] not in (b"{", b"[") or any(byte < 32 and byte not in b"\t\n\r" for byte in text):
            return "model"  # the first number of a .splat may begin with a brace
        file.seek(0)
        whole = file.read()
    listed = text[:1] == b"[" or b'"frames"' in whole  # INRIA's cameras, NeRF's
    return "cameras" if listed and b'"meshes"' not in whole else "model"  # what is no .gltf either, its reader names


def _again(service: Service, row: Any) -> Any:
    return own(service.db, uploads, row.tenant, row.id)


def _unchanged(row: Any) -> sa.ColumnElement[bool]:
    """The compare of compare and set: the slot is as it was read."""
    return sa.and_(uploads.c.id == row.id, uploads.c.received == row.received, uploads.c.state == "open")


def _refuse(service: Service, row: Any) -> NoReturn:
    """Another request was faster: it continued the upload, completed it, or deleted it (not-found)."""
    offset = _again(service, row).received
    raise Problem("conflict", f"another request has continued upload {row.id!r} at byte {row.received}", offset=offset)


def _give_up(service: Service, row: Any, problem: Problem) -> NoReturn:
    """Drop a slot that can never be completed, unless another request was faster."""
    if not service.db.change(sa.delete(uploads).where(_unchanged(row))):
        _refuse(service, row)
    _remove(service, row)
    raise problem


def _remove(service: Service, row: Any) -> None:
    for name in part_names(row.parts):
        service.blobs.remove_part(name)


def _join(service: Service, row: Any, parts: list[tuple[str, int, str]], last: Path, whole: Path) -> str:
    """Write the parts, each held against its length and digest, and the `last` bytes into one file; its digest."""
    digest = hashlib.sha256()
    with whole.open("wb") as file:
        for name, length, sha256 in parts:
            part, begin = hashlib.sha256(), file.tell()
            try:
                for chunk in service.blobs.chunks(name):
                    part.update(chunk)
                    digest.update(chunk)
                    file.write(chunk)
            except Problem:  # it is gone: deleted meanwhile, or damaged
                pass
            if (file.tell() - begin, part.hexdigest()) != (length, sha256):
                text = (
                    f"the stored bytes of upload {row.id!r} are damaged at byte {begin}; it was dropped: send it anew"
                )
                _give_up(service, row, Problem("internal", text))
        with last.open("rb") as rest:
            while chunk := rest.read(_CHUNK):
                digest.update(chunk)
                file.write(chunk)
    return digest.hexdigest()


_BESIDE = 1 << 20
"""Bytes of an asset's preview and entry, which its row does not say."""


def stored_bytes(connection: sa.Connection, tenant: str) -> int:
    """Bytes of a tenant: uploads, open ones as announced, acquisitions, and assets; an original counts once, however
    many copies.

    Counted on request, so deleting helps at once.
    """

    def measured(name: str) -> sa.ColumnElement[int]:
        report = assets.c.report
        plain = sa.type_coerce(report, sa.JSON) if connection.dialect.name == "sqlite" else sa.cast(report, sa.JSON)
        return sa.func.coalesce(sa.cast(plain[name].as_string(), sa.BigInteger), 0)

    mine = assets.c.tenant == tenant
    uploaded = sa.select(uploads.c.sha256).where((uploads.c.tenant == tenant) & (uploads.c.state == "complete"))
    of_uploads = sa.select(sa.func.sum(sa.func.coalesce(uploads.c.size, uploads.c.received)))
    of_copies = sa.select(sa.func.sum(measured("bytes_out") + measured("record_bytes") + _BESIDE)).where(mine)
    originals = sa.select(sa.func.max(measured("bytes_in")).label("bytes")).group_by(assets.c.original_sha256)
    of_originals = sa.select(
        sa.func.sum(originals.where(mine, assets.c.original_sha256.not_in(uploaded)).subquery().c.bytes)
    )
    of_acquisitions = sa.select(sa.func.sum(acquisitions.c.warc_bytes)).where(acquisitions.c.tenant == tenant)
    parts = (of_uploads.where(uploads.c.tenant == tenant), of_copies, of_originals, of_acquisitions)
    return sum(int(connection.execute(part).scalar_one() or 0) for part in parts)


def check_quota(connection: sa.Connection, settings: Settings, tenant: str, more: int) -> None:
    """quota-exceeded where a tenant has no room for so many bytes more."""
    stored, limit = stored_bytes(connection, tenant), settings.tenant_bytes
    if stored + more > limit or stored >= limit:
        text = f"this tenant stores {stored} of {limit} bytes: delete uploads or assets to make room for {more} more"
        raise Problem("quota-exceeded", text, stored=stored, limit=limit)
