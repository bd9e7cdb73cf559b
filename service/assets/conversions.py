"""Files derived from stored ones on request, and kept: made once, also for simultaneous requests."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import sqlalchemy as sa

from service.core import Service
from service.db.schema import conversions
from service.problems import Problem
from service.processes import run_within, task_folder

CONVERTING_SECONDS = 60.0
_threads = ThreadPoolExecutor(32, "convert")
"""Of their own: conversions that wait for their turn keep no request waiting that needs none."""


def kept(service: Service, sha256: str, kind: str) -> str | None:
    """Digest of what was made of a file."""
    known = (conversions.c.model_sha256 == sha256) & (conversions.c.format == kind)
    found: str | None = service.db.query(sa.select(conversions.c.sha256).where(known)).scalar()
    return found


def keep(service: Service, sha256: str, kind: str, digest: str) -> None:
    """Remember it; another process may have been faster."""
    known = (conversions.c.model_sha256 == sha256) & (conversions.c.format == kind)
    with service.db.write() as connection:
        if connection.execute(sa.select(conversions.c.sha256).where(known)).scalar() is None:
            connection.execute(conversions.insert().values(model_sha256=sha256, format=kind, sha256=digest))


def drop(service: Service, *sha256: str) -> None:
    """Forget what was made of these files. Another owner of the same file may have it made again."""
    service.db.change(sa.delete(conversions).where(conversions.c.model_sha256.in_(sha256)))


async def converted(service: Service, tenant: str, sha256: str, kind: str) -> str:
    """Digest of a stored model in another format. A second request for one in the making waits for it.

    budget-exceeded where as many others are being made for this tenant as may be.
    """
    this = (sha256, kind)
    if this not in service.making and (found := await asyncio.to_thread(kept, service, sha256, kind)) is not None:
        return found
    return await once(service, tenant, this, lambda: _convert(service, tenant, sha256, kind))


async def once(service: Service, tenant: str, this: tuple[str, str], make: Callable[[], str]) -> str:
    """What `make` makes of a file, once for all simultaneous requests; budget-exceeded as `converted`."""
    making, work = service.making, service.making.get(this)
    if work is None:
        most = service.settings.conversions_at_once
        if sum(whose == tenant for whose, _ in list(making.values())) >= most:
            text = f"{most} files are being worked on for this tenant: ask again when one is done"
            raise Problem("budget-exceeded", text, headers={"Retry-After": "5"})
        work = making[this] = tenant, _threads.submit(make)
        work[1].add_done_callback(lambda _: making.pop(this, None))  # in its thread, or here if it is done already
    # Shielded: a client that breaks off does not stop the work for the others.
    return await asyncio.shield(asyncio.wrap_future(work[1]))


def _convert(service: Service, tenant: str, sha256: str, kind: str) -> str:
    """Make it, in a process of its own."""
    with task_folder(service.settings) as folder:
        request = {"model": str(service.blobs.local(sha256, folder)), "format": kind}
        reply = run_within(service.settings, "convert", request, folder, CONVERTING_SECONDS, tenant, "converting")
        digest = service.blobs.put(folder / reply["files"]["model"])
    keep(service, sha256, kind, digest)
    return digest
