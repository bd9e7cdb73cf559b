"""Deleting assets and claims, listing uploads, forgetting ended jobs."""

from __future__ import annotations

import os
import time
from typing import Any

import pytest
import sqlalchemy as sa

from service.assets.conversions import keep, kept
from service.clock import ago, now
from service.core import Service
from service.db.schema import claims, jobs
from service.jobs.port import Job, State
from service.settings import Settings
from service.uploads.retention import sweep
from tests.service.api.conftest import SMALL, Api, _api
from tests.service.rows import add_asset, put

TENANT = "tenant of deleting"


@pytest.fixture
def own(tmp_path: Any) -> Any:
    """A service of this test's own: others' rows are not to be deleted."""
    service = Service.open(Settings(data_dir=tmp_path / "data"))
    yield service
    service.close()


def filled(service: Service) -> dict[str, str]:
    """An asset with files, a conversion of it, and a claim; digests by name."""
    names = ("original", "model", "record", "preview", "sketch", "conversion", "picture")
    digests = {name: put(service.blobs, name.encode()) for name in names}
    add_asset(service.db, commit=True, tenant=TENANT, **{f"{name}_sha256": digests[name] for name in names[:5]})
    keep(service, digests["model"], "spz", digests["conversion"])
    with service.db.write() as connection:
        claim = {"id": "cl_1", "tenant": TENANT, "job": "y", "asset": "as_1", "document": "{}", "jws": "a.b.c"}
        claim |= {"pictures": f'{{"suspect": "{digests["picture"]}"}}', "created_at": now()}
        connection.execute(claims.insert().values(claim))
    return digests


def age(service: Service) -> None:
    """Make the files older than an upload may be."""
    old = time.time() - 3600 * (service.settings.upload_hours + 1)
    for path in (service.blobs.folder or SMALL).rglob("*"):
        os.utime(path, (old, old))


def test_an_asset_and_a_claim(own: Service) -> None:
    digests = filled(own)
    owner = _api(own, TENANT, ["admin"])
    age(own)
    sweep(own)
    assert all(own.blobs.digest_found(digest) == digest for digest in digests.values()), "before, nothing goes"
    for scopes in (["read", "embed", "verify", "originals"], ["operator"]):
        assert _api(own, TENANT, scopes).client.delete("/v1/assets/as_1").status_code == 403
    assert _api(own, "stranger", ["admin"]).client.delete("/v1/assets/as_1").status_code == 404
    assert owner.client.delete("/v1/assets/as_1").status_code == 204
    assert owner.client.get("/v1/assets/as_1").status_code == 404
    assert owner.client.get("/v1/claims/cl_1.jws").status_code == 200, "what was claimed stays"
    assert kept(own, digests["model"], "spz") is None
    sweep(own)
    left = {name for name, digest in digests.items() if own.blobs.digest_found(digest)}
    assert left == {"picture"}, "its files go, conversions too"
    assert owner.client.delete("/v1/claims/cl_1").status_code == 204
    assert owner.client.delete("/v1/claims/cl_1").status_code == 404
    sweep(own)
    assert own.blobs.digest_found(digests["picture"]) == ""


def test_parts_of_uploads_that_no_row_names(own: Service) -> None:
    """As a process that died, or lost a race, leaves them."""
    client = _api(own, TENANT, ["admin"]).client
    slot = client.post("/v1/uploads", json={"size": 20}).json()["id"]
    client.put(f"/v1/uploads/{slot}", content=bytes(10))
    with own.blobs.new_file() as path:
        path.write_bytes(b"lost")
        own.blobs.put_part(path, f"upload/{slot}/0000000000000010-lost")
    sweep(own)
    files = (own.blobs.folder or SMALL) / "upload" / slot
    assert len(list(files.iterdir())) == 2, "too young"
    age(own)
    sweep(own)
    (left,) = files.iterdir()
    assert left.read_bytes() == bytes(10), "what the row names stays"


def test_uploads_are_listed(api: Api, stranger: Api) -> None:
    made = [api.upload(SMALL.read_bytes(), f"{number}.ply") for number in range(3)]
    page = api.client.get("/v1/uploads", params={"limit": 2}).json()
    assert [upload["id"] for upload in page["items"]] == made[:0:-1]
    rest = api.client.get("/v1/uploads", params={"after": page["next"]}).json()
    assert [upload["name"] for upload in rest["items"]] == ["0.ply"]
    assert made[0] not in stranger.client.get("/v1/uploads").text


def test_rows_of_ended_jobs_are_forgotten(own: Service) -> None:
    """Of old ones; never an open one, and no dispute, whose finding is in its row."""
    for name, kind, state, hours in (
        ("old", "verify", "succeeded", 50.0),
        ("cancelled", "verify", "cancelled", 50.0),
        ("young", "verify", "failed", 1.0),
        ("open", "embed", "running", 50.0),
        ("dispute", "dispute", "succeeded", 50.0),
    ):
        own.jobs.submit(Job(name, name, "key", kind, State.QUEUED, {}, created_at=ago(60)))
        ended = {"state": state, "finished_at": None if state == "running" else ago(hours)}
        with own.db.write() as connection:
            connection.execute(jobs.update().where(jobs.c.id == name).values(ended))
    assert own.jobs.prune(24) == 2
    with own.db.read() as connection:
        assert set(connection.execute(sa.select(jobs.c.id)).scalars()) == {"young", "open", "dispute"}
    engine = {each.workflow_id for each in own.jobs.client().list_workflows()}
    assert engine == {"young", "open", "dispute"}, "the engine's tables do not grow either"
