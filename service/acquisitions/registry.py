"""Acquisitions as they are kept: a WARC file, a row, and a time stamp and a log entry of what the row says."""

import base64
import secrets
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import httpx

from engine.records.timestamps import stamp
from service.acquisitions.archive import write_warc
from service.acquisitions.fetching import Exchange
from service.clock import now
from service.core import Service
from service.db import own
from service.db.schema import acquisitions
from service.problems import Problem
from service.processes import task_folder
from service.trust import audit
from service.trust.api_keys import Caller
from service.trust.canonical import canonical, digest
from service.trust.commitments import ACQUISITION_MADE, acquisition_facts
from service.uploads import ingest, store
from service.uploads.store import Received


def keep_fetched(
    service: Service, caller: Caller, url: str, body: Path, got: Received, exchanges: Sequence[Exchange]
) -> tuple[Any, str]:
    """The row of what was fetched, and why it has no time stamp, if it has none. A suspect becomes an upload, too."""
    with service.blobs.new_file() as warc:
        write_warc(warc, body, exchanges, "", exchanges[-1].at)
        name = PurePosixPath(httpx.URL(exchanges[-1].url).path).name[:200]
        row = store.create(service, caller, name, got.length or None, None)
        row = store.complete(service, row, body, got)
        upload: str | None = row.id
        try:
            ingest.inspect(service, [row])
        except Problem as problem:
            if problem.status >= 500:
                raise
            upload = None  # a page, say: it is evidence all the same
        return _keep(service, caller, warc, url=url, at=exchanges[-1].at, got=got, upload=upload)


def keep_upload(service: Service, caller: Caller, upload_id: str) -> tuple[Any, str]:
    """As `keep_fetched`, of a file that the caller uploaded."""
    row = ingest.complete_upload(service, caller, upload_id)
    at = now()
    with service.blobs.new_file() as warc, task_folder(service.settings) as folder:
        write_warc(warc, service.blobs.local(row.sha256, folder), [], row.name, at)
        got = Received(row.size, row.sha256, whole=True)
        return _keep(service, caller, warc, url=None, at=at, got=got, upload=row.id)


def _keep(
    service: Service, caller: Caller, warc: Path, *, url: str | None, at: str, got: Received, upload: str | None
) -> tuple[Any, str]:
    size = warc.stat().st_size
    acquisition = f"aq_{secrets.token_hex(12)}"
    values: dict[str, str | None] = {"id": acquisition, "url": url, "at": at}
    values |= {"payload_sha256": got.sha256, "warc_sha256": service.blobs.put(warc)}
    facts = acquisition_facts(values)
    token, failure = None, "this service uses no time-stamping service"
    if service.settings.tsa_url:
        stamped = stamp(service.settings.tsa_url, canonical(facts))
        token, failure = stamped.token, stamped.failure
    values |= {"tenant": caller.tenant, "api_key": caller.key_id, "created_at": now(), "upload": upload}
    with service.db.exclusive() as connection:
        store.check_quota(connection, service.settings, caller.tenant, size)
        row = values | {"bytes": got.length, "warc_bytes": size, "timestamp": token}
        connection.execute(acquisitions.insert().values(row))
        audit.append(connection, caller.tenant, ACQUISITION_MADE, {"digest": digest(facts)}, acquisition)
    return own(service.db, acquisitions, caller.tenant, acquisition), failure


def encoded(token: bytes | None) -> str | None:
    """A time stamp in JSON."""
    return None if token is None else base64.b64encode(token).decode()
