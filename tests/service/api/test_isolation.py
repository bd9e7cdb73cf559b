"""Tenants never see one another: every route of the API, with another tenant's ids, answers 404."""

from __future__ import annotations

import json
import re
import secrets
from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.clock import now
from service.core import Service
from service.db.schema import assets, claims
from service.jobs.port import Job, State
from tests.service.api.conftest import SMALL, Api
from tests.service.rows import add_asset

SHARED = {"/shared/{token}", "/shared/{token}/annex", "/shared/{token}/claim.json", "/shared/{token}/pack"}
PUBLIC = {
    *("/healthz", "/readyz", "/.well-known/jwks.json"),
    # what was let out with a file, for who has the id that is in it (test_credentials)
    *("/v1/matches/byBinding", "/v1/manifests/{manifest_id}", "/v1/services/supportedAlgorithms"),
} | SHARED


def _rows(service: Service, tenant: str, job: str) -> tuple[str, str]:
    """An asset and a claim of a tenant, as a worker would have left them."""
    asset_id, claim_id = (f"{kind}_{secrets.token_hex(12)}" for kind in ("as", "cl"))
    digest = "a" * 64
    digests = {column.name: digest for column in assets.columns if column.name.endswith("sha256")}
    add_asset(service.db, id=asset_id, tenant=tenant, job=job, **digests)
    with service.db.write() as connection:
        of_it = {"id": claim_id, "tenant": tenant, "job": job, "asset": asset_id, "created_at": now()}
        connection.execute(claims.insert().values(**of_it, document="{}", jws="a.b.c", pictures="{}"))
    return asset_id, claim_id


@pytest.fixture
def ids(api: Api) -> dict[str, str]:
    """One thing of every kind, of `api`'s tenant."""
    upload, key = api.upload(SMALL.read_bytes()), api.key()
    job = api.client.post("/v1/embed", json={"upload_id": upload, "key_id": key}).json()["id"]
    tenant = api.client.get(f"/v1/jobs/{job}").json()["id"] and "owner of everything"
    with api.service.db.read() as connection:
        from service.db.schema import jobs

        tenant = connection.execute(jobs.select().where(jobs.c.id == job)).one().tenant
    asset, claim = _rows(api.service, tenant, job)
    dispute = _dispute(api.service, tenant, asset)
    share = api.client.post(f"/v1/claims/{claim}/share", json={}).json()
    hook = api.client.post("/v1/webhooks", json={"url": "https://hooks.example/"}).json()["id"]
    acquired = api.client.post("/v1/acquisitions", json={"upload_id": upload}).json()["id"]
    named = {
        "acquisition_id": acquired,
        "upload_id": upload,
        "webhook_id": hook,
        "key_id": key,
        "api_key_id": api.client.post("/v1/api-keys", json={"scopes": ["read"]}).json()["id"],
        "job_id": job,
        "asset_id": asset,
        "claim_id": claim,
    }
    return {**named, "dispute_id": dispute, "share_id": share["id"], "token": share["url"].rpartition("/")[2]}


def _dispute(service: Service, tenant: str, asset: str) -> str:
    """A settled dispute about a tenant's asset."""
    from service.db.schema import jobs

    job = Job(f"job_{secrets.token_hex(12)}", tenant, "x", "dispute", State.QUEUED, {"assets": [asset, "as_x"]})
    service.jobs.submit(job)
    with service.db.write() as connection:
        ended = {"state": "succeeded", "result": json.dumps({"document": {}, "jws": "a.b.c"})}
        connection.execute(jobs.update().where(jobs.c.id == job.id).values(**ended))
    return "di_" + job.id.removeprefix("job_")


def _operations(client: TestClient) -> list[tuple[str, str, dict[str, Any]]]:
    document = client.app.openapi()  # type: ignore[attr-defined]
    return [
        (method.upper(), path, operation)
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    ]


def test_every_route_with_anothers_ids(api: Api, stranger: Api, ids: dict[str, str]) -> None:
    tried = 0
    for method, path, _ in _operations(api.client):
        names = re.findall(r"{(\w+)}", path)
        if not names or path in PUBLIC:  # for whoever was told the address, or has the id
            continue
        address = path.format(**ids)
        mine = stranger.client.request(method, address)
        assert mine.status_code == 404, f"{method} {path} answered {mine.status_code}"
        assert mine.json()["type"] == "urn:mark3dgs:problem:not-found"
        unknown = stranger.client.request(method, path.format(**dict.fromkeys(names, "nothing")))
        same = [json.loads(re.sub(r"'[^']*'|\w{16}", "", answer.text)) for answer in (mine, unknown)]
        assert same[0]["detail"] == same[1]["detail"], "the answer tells that it exists"
        tried += 1
    assert tried >= 14


def test_every_body_with_anothers_ids(stranger: Api, ids: dict[str, str]) -> None:
    own = stranger.upload(SMALL.read_bytes())
    key = stranger.key()
    for body in (
        {"upload_id": ids["upload_id"], "key_id": key},
        {"upload_id": own, "key_id": ids["key_id"]},
        {"upload_id": own, "key_id": key, "cameras_upload_id": ids["upload_id"]},
    ):
        assert stranger.client.post("/v1/embed", json=body).status_code == 404
    for body in ({"upload_id": ids["upload_id"]}, {"upload_id": own, "asset_id": ids["asset_id"]}):
        assert stranger.client.post("/v1/verify", json=body).status_code == 404
    assert stranger.client.post("/v1/acquisitions", json={"upload_id": ids["upload_id"]}).status_code == 404
    acquired = {"upload_id": own, "acquisition_id": ids["acquisition_id"]}
    assert stranger.client.post("/v1/verify", json=acquired).status_code == 404
    pictures = {"image_upload_ids": [ids["upload_id"]]}
    assert stranger.client.post("/v1/verify", json=pictures).status_code == 404


def test_lists_hold_ones_own(api: Api, stranger: Api, ids: dict[str, str]) -> None:
    kinds = ("keys", "api-keys", "jobs", "assets", "claims", "uploads", "acquisitions", "webhooks")
    for path in (f"/v1/{kind}" for kind in kinds):
        foreign = stranger.client.get(path).text
        assert not any(value in foreign for value in ids.values())
        if path == "/v1/webhooks":  # it has no pages
            continue
        assert stranger.client.get(path, params={"after": ids["job_id"]}).status_code == 422
    assert ids["asset_id"] in api.client.get("/v1/assets").text or api.client.get("/v1/assets").json()["items"] == []


def test_every_route_without_and_with_a_wrong_key(api: Api, ids: dict[str, str]) -> None:
    bare = TestClient(api.client.app)
    for method, path, _ in _operations(api.client):
        if path in PUBLIC:
            continue
        address = path.format(**ids)
        for headers in ({}, {"Authorization": "Bearer mk_0_0"}, {"Authorization": "Basic eDp5"}):
            answer = bare.request(method, address, headers=headers)
            assert answer.status_code == 401, f"{method} {path}"
            assert answer.headers["www-authenticate"].startswith("Bearer")


def test_scopes(reader: Api) -> None:
    """Who may read may not upload, embed, verify, cancel, or make keys."""
    client = reader.client
    assert client.get("/v1/assets").status_code == 200
    for method, path in (
        ("POST", "/v1/keys"),
        ("DELETE", "/v1/keys/x"),
        ("POST", "/v1/uploads"),
        ("PUT", "/v1/uploads/x"),
        ("POST", "/v1/embed"),
        ("POST", "/v1/verify"),
        ("DELETE", "/v1/jobs/x"),
        ("POST", "/v1/claims/x/share"),
        ("DELETE", "/v1/shares/x"),
    ):
        body = {"json": {}} if method == "POST" else {}
        assert client.request(method, path, **body).status_code == 403, path  # type: ignore[arg-type]
