"""Content Credentials (C2PA) of delivered models, where the operator has set a certificate: signed once, and kept.

Only files that this service has written are signed, in a process of their own. No uploaded manifest is
ever looked at, here or elsewhere in the service.
"""

import asyncio
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from engine.credentials.signer import Signer, read_signer
from engine.errors import InputError
from service.assets.conversions import CONVERTING_SECONDS, once
from service.assets.publishing import published_of
from service.clock import now
from service.core import Service
from service.db.schema import assets, manifests, published
from service.problems import Problem
from service.processes import run_within, task_folder
from service.settings import Settings

SIGNED = ("sog", "glb")
"""Formats that are delivered with credentials."""
STATES = "glb"
"""The format that states rights, and where its manifest is."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Delivery:
    """A file to deliver, and what its response says about its manifest."""

    sha256: str
    headers: dict[str, str]


def signer_of(settings: Settings) -> Signer | None:
    """The signer, None where the operator configured none; InputError that says what is wrong with the files."""
    chain, key = settings.credentials_certificates, settings.credentials_key
    if not chain and not key:
        return None
    if not chain or not key:
        raise InputError("MARK3DGS_CREDENTIALS_CERTIFICATES and MARK3DGS_CREDENTIALS_KEY go together")
    return read_signer(Path(chain), Path(key))


async def delivered(service: Service, row: Any, sha256: str, kind: str) -> Delivery:
    """A marked model of an asset, with its credentials where there are to be any.

    Where they cannot be made it is delivered without, which the operator's log says: an owner gets the own model also
    when a certificate has expired.
    """
    bare = Delivery(sha256, {})
    if kind not in SIGNED:
        return bare
    try:
        signer = await asyncio.to_thread(signer_of, service.settings)
        if signer is None:
            return bare
        rights = (await asyncio.to_thread(published_of, service, row.id)).rights if kind == STATES else ""
        query = _query(row.id, sha256, signer, rights)
        made = (await asyncio.to_thread(service.db.query, query)).first()
        if made is None:
            this = (sha256, f"credentials {row.id} {signer.fingerprint} {rights}")
            await once(service, row.tenant, this, lambda: _sign(service, row, sha256, kind, signer, rights))
            made = (await asyncio.to_thread(service.db.query, query)).first()
    except InputError as error:
        _log.error("no Content Credentials for %s: %s", row.id, error)
        return bare
    except Problem as problem:
        if problem.kind in ("budget-exceeded", "unavailable"):
            raise
        _log.error("no Content Credentials for %s: %s", row.id, problem.detail)
        return bare
    if made is None:  # the asset was deleted meanwhile
        return bare
    address = f"{service.public_url()}/v1/manifests/{made.id}"
    return Delivery(made.file_sha256, {"Link": f'<{address}>; rel="c2pa-manifest"'})


def forget_manifests(service: Service, asset: str) -> None:
    """They are no longer served; delivered files keep theirs."""
    service.db.change(sa.delete(manifests).where(manifests.c.asset == asset))
    service.db.change(sa.delete(published).where(published.c.asset == asset))


def _query(asset: str, sha256: str, signer: Signer, rights: str) -> sa.Select[Any]:
    """The row of what was signed of this very file by this signer, with this statement of rights."""
    same = (manifests.c.source_sha256 == sha256) & (manifests.c.signer == signer.fingerprint)
    return sa.select(manifests).where((manifests.c.asset == asset) & same & (manifests.c.rights == rights))


def _sign(service: Service, row: Any, sha256: str, kind: str, signer: Signer, rights: str) -> str:
    """Sign it, in a process of its own; the manifest's id."""
    with task_folder(service.settings) as folder:
        request = {
            "model": str(service.blobs.local(sha256, folder)),
            "format": kind,
            "record_id": row.record_id,
            "rights": rights,
            "public_url": service.public_url(),
            "certificates": signer.chain.decode(),
            "key": signer.key.decode(),
        }
        reply = run_within(service.settings, "sign", request, folder, CONVERTING_SECONDS, row.tenant, "signing")
        kept = {name: service.blobs.put(folder / file) for name, file in reply["files"].items()}
    made = {
        "id": reply["manifest_id"],
        "asset": row.id,
        "binding": row.record_id,
        "signer": signer.fingerprint,
        "source_sha256": sha256,
        "file_sha256": kept.get("model", sha256),
        "sha256": kept["manifest"],
        "created_at": now(),
        "rights": rights,
    }
    with service.db.exclusive() as connection:
        there = connection.execute(sa.select(assets.c.id).where(assets.c.id == row.id)).first()
        if there and connection.execute(_query(row.id, sha256, signer, rights)).first() is None:  # no other was faster
            connection.execute(manifests.insert().values(**made))
    return str(made["id"])
