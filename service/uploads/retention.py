"""What is no longer needed: uploads never finished or never used, and blobs that no row names."""

import json
from datetime import UTC, datetime, timedelta
from itertools import chain

import obstore
import sqlalchemy as sa

from service.clock import ago
from service.core import Service
from service.db.schema import acquisitions, assets, claims, conversions, jobs, manifests, uploads
from service.jobs.port import FINAL
from service.uploads import store


def sweep(service: Service) -> tuple[int, int]:
    """Drop uploads and blobs; how many of each.

    A blob goes only if it is older than an upload may be, so that none goes which a running request has just put.
    """
    hours = service.settings.upload_hours
    unfinished = (uploads.c.state == "open") & (uploads.c.created_at < ago(hours))
    unused = (uploads.c.state == "complete") & (uploads.c.created_at < ago(24 * service.settings.suspect_days))
    rows = service.db.query(sa.select(uploads).where(unfinished | unused)).all()
    for row in rows:
        store.drop(service, row)
    return len(rows), _sweep_blobs(service, hours)


def _sweep_blobs(service: Service, hours: float) -> int:
    old = datetime.now(UTC) - timedelta(hours=hours)
    stored = (
        entry
        for kind in ("blob", store.PARTS)
        for entry in chain.from_iterable(obstore.list(service.blobs.store, kind))
    )
    candidates = [entry["path"] for entry in stored if entry["last_modified"] < old]
    named = _named(service)  # after the listing: what was put since is named, or too young
    gone = [path for path in candidates if path not in named and path.rsplit("/", 1)[-1] not in named]
    for path in gone:
        if obstore.head(service.blobs.store, path)["last_modified"] < old:  # put again meanwhile: it stays
            service.blobs.remove_part(path)
    return len(gone)


def _named(service: Service) -> set[str]:
    """Digests that some row names, and names of the parts of uploads under way."""
    of_assets = [assets.c[f"{name}_sha256"] for name in ("original", "model", "record", "preview", "sketch")]
    found: set[str] = set()
    with service.db.read() as connection:
        of_manifests = (manifests.c.file_sha256, manifests.c.sha256)
        kept = (uploads.c.sha256, conversions.c.sha256, acquisitions.c.warc_sha256)
        for column in (*kept, *of_manifests, *of_assets):
            found.update(digest for (digest,) in connection.execute(sa.select(column)) if digest)
        for (parts,) in connection.execute(sa.select(uploads.c.parts)):
            found.update(store.part_names(parts))
        for (pictures,) in connection.execute(sa.select(claims.c.pictures)):
            found.update(json.loads(pictures).values())
        running = jobs.c.state.not_in([state.value for state in FINAL])
        for (text,) in connection.execute(sa.select(jobs.c.request).where(running)):
            request = json.loads(text)
            found.update(filter(None, [request.get("model"), request.get("cameras"), *request.get("images", [])]))
    return found
