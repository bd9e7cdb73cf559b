"""Other formats of a stored model: made once in a process of its own, kept by digest."""

import sqlalchemy as sa

from service.core import Service
from service.db.schema import conversions
from service.jobs.once import run_once, task_folder
from service.problems import Problem

SECONDS = 60.0


def convert(service: Service, sha256: str, kind: str) -> str:
    """Digest of that model in another format."""
    known = (conversions.c.model_sha256 == sha256) & (conversions.c.format == kind)
    with service.db.read() as connection:
        found = connection.execute(sa.select(conversions.c.sha256).where(known)).scalar()
    if found is not None:
        return str(found)
    with task_folder(service.settings) as folder:
        request = {"model": str(service.blobs.local(sha256, folder)), "format": kind}
        reply = run_once(service.settings, "convert", request, folder, SECONDS)
        if reply is None:
            raise Problem("unavailable", f"converting took over {SECONDS:.0f} s", headers={"Retry-After": "60"})
        digest = service.blobs.put(folder / reply["files"]["model"])
    with service.db.write() as connection:
        if connection.execute(sa.select(conversions.c.sha256).where(known)).scalar() is None:
            connection.execute(conversions.insert().values(model_sha256=sha256, format=kind, sha256=digest))
    return digest
