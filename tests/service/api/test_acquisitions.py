"""Acquisitions over HTTP: what is kept, who sees it, what a verification may say of it; and parts of the API that are
left out."""

from __future__ import annotations

import base64
import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
import sqlalchemy as sa
from fastapi.testclient import TestClient
from pydantic import ValidationError

from engine.records.timestamps import check_stamp
from service.acquisitions.endpoints import NewAcquisition
from service.app import make_app
from service.clock import ago
from service.core import Service
from service.db.schema import idempotency as rows
from service.http import idempotency
from service.problems import Problem
from service.settings import OPTIONAL_ROUTERS, Settings
from service.trust import audit
from service.trust.api_keys import check
from service.trust.canonical import canonical, digest
from service.trust.commitments import ACQUISITION_MADE, acquisition_facts
from service.uploads.retention import sweep
from tests.records.test_timestamps import Authority, serving
from tests.service.acquisitions.conftest import answer, sites  # noqa: F401
from tests.service.acquisitions.test_fetching import Sites, warc_records
from tests.service.api.conftest import SMALL, Api, _api
from tests.service.client.driving import do

MODEL = SMALL.read_bytes()
SHA256 = hashlib.sha256(MODEL).hexdigest()


def with_settings(api: Api, **changes: Any) -> Api:
    """The same tenant, served with other settings."""
    service = replace(api.service, settings=api.service.settings.model_copy(update=changes))
    client = TestClient(make_app(service), headers=dict(api.client.headers), raise_server_exceptions=False)
    return Api(client, service)


def facts(acquired: dict[str, Any]) -> dict[str, Any]:
    return acquisition_facts(acquired)


def test_what_is_fetched_is_kept_and_can_be_verified(api: Api, sites: Sites, tmp_path: Path) -> None:  # noqa: F811
    authority = Authority(tmp_path)
    site = sites(answer(MODEL))
    with serving(authority.reply) as tsa:
        open_to_all = with_settings(api, acquisitions_private=True, tsa_url=tsa)
        answered = open_to_all.client.post("/v1/acquisitions", json={"url": site.url("/stolen.ply")})
    assert answered.status_code == 201, answered.text
    made = answered.json()
    assert (made["payload_sha256"], made["bytes"], made["url"]) == (SHA256, len(MODEL), site.url("/stolen.ply"))
    assert made["timestamp_failure"] == ""
    check_stamp(base64.b64decode(made["timestamp"]), canonical(facts(made)), authority.roots)
    assert api.client.get(answered.headers["location"]).json().items() <= made.items()
    warc = api.client.get(f"/v1/acquisitions/{made['id']}/warc")
    assert warc.headers["content-type"] == "application/warc"
    assert hashlib.sha256(warc.content).hexdigest() == made["warc_sha256"]
    assert warc_records(warc.content)[1][1].endswith(MODEL)
    with api.service.db.read() as connection:
        entry = audit.find(connection, ACQUISITION_MADE, made["id"])
    assert entry is not None
    assert entry.payload == {"digest": digest(facts(made))}
    upload = api.client.get(f"/v1/uploads/{made['upload_id']}").json()
    assert (upload["name"], upload["info"]["kind"]) == ("stolen.ply", "model")
    wanted = {"upload_id": made["upload_id"], "acquisition_id": made["id"], "suspect_seen": made["at"][:10]}
    assert api.client.post("/v1/verify", json=wanted).status_code == 202
    later = api.client.post("/v1/verify", json=wanted | {"suspect_seen": "2999-01-01"})
    assert (later.status_code, "suspect_seen" in later.json()["detail"]) == (422, True)
    other = api.upload(MODEL[:-4] + bytes(4))
    assert api.client.post("/v1/verify", json=wanted | {"upload_id": other}).status_code == 409


def test_a_page_is_kept_though_it_is_no_suspect(api: Api, sites: Sites) -> None:  # noqa: F811
    site = sites(answer(b"<!doctype html><title>My model</title>"))
    made = (
        with_settings(api, acquisitions_private=True).client.post("/v1/acquisitions", json={"url": site.url()}).json()
    )
    assert (made["upload_id"], made["timestamp"]) == (None, None)
    assert made["timestamp_failure"]
    assert api.client.get("/v1/uploads").json()["items"] == []


def test_what_was_saved_is_taken_and_outlives_its_upload(api: Api) -> None:
    slot = api.upload(MODEL, "saved.ply")
    made = api.client.post("/v1/acquisitions", json={"upload_id": slot}).json()
    assert (made["url"], made["payload_sha256"], made["upload_id"]) == (None, SHA256, slot)
    api.client.delete(f"/v1/uploads/{slot}")
    at_once = with_settings(api, upload_hours=1e-9).service
    sweep(at_once)
    warc = api.client.get(f"/v1/acquisitions/{made['id']}/warc")
    assert warc_records(warc.content)[1][1] == MODEL
    assert [each["id"] for each in api.client.get("/v1/acquisitions").json()["items"]] == [made["id"]]
    assert api.client.delete(f"/v1/acquisitions/{made['id']}").status_code == 204
    assert api.client.get(f"/v1/acquisitions/{made['id']}").status_code == 404
    sweep(at_once)
    with pytest.raises(Problem, match="gone"):
        api.service.blobs.read(made["warc_sha256"])


@pytest.mark.parametrize(
    "url", ["http://127.0.0.1:1/", "http://[::1]:1/", "http://169.254.169.254/latest", "http://[::ffff:7f00:1]:1/"]
)
def test_no_address_of_the_operators_network(api: Api, url: str) -> None:
    refused = api.client.post("/v1/acquisitions", json={"url": url})
    assert (refused.status_code, refused.json()["type"]) == (502, "urn:mark3dgs:problem:not-fetched")
    assert api.client.get("/v1/acquisitions").json()["items"] == []


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"url": "https://a.example/", "upload_id": "up_1"},
        {"url": "file:///etc/passwd"},
        {"url": "https://u:p@a.example/"},
    ],
)
def test_what_is_not_asked_rightly(api: Api, body: dict[str, str]) -> None:
    assert api.client.post("/v1/acquisitions", json=body).status_code == 422


def test_limits(api: Api, sites: Sites) -> None:  # noqa: F811
    site = sites(answer(bytes(2000)))
    small = with_settings(api, acquisitions_private=True, max_upload_bytes=1999, acquisitions_per_hour=2)
    statuses = [small.client.post("/v1/acquisitions", json={"url": site.url()}).status_code for _ in range(3)]
    assert statuses == [413, 413, 429]
    nearly = with_settings(api, acquisitions_private=True, tenant_bytes=1000)
    assert nearly.client.post("/v1/acquisitions", json={"url": site.url()}).status_code == 413
    full = with_settings(api, tenant_bytes=len(MODEL) + 100)
    slot = full.upload(MODEL)
    assert full.client.post("/v1/acquisitions", json={"upload_id": slot}).json()["type"].endswith("quota-exceeded")


def test_scopes(service: Service) -> None:
    tenant = "tenant of acquisitions"
    verifier, other, reader, embedder = (_api(service, tenant, [s]) for s in ("verify", "verify", "read", "embed"))
    slot = verifier.upload(MODEL)
    path = f"/v1/acquisitions/{verifier.client.post('/v1/acquisitions', json={'upload_id': slot}).json()['id']}"
    for address in (path, f"{path}/warc"):
        found = [api.client.get(address).status_code for api in (verifier, reader, other, embedder)]
        assert found == [200, 200, 404, 403]
    assert [api.client.get("/v1/acquisitions").status_code for api in (reader, verifier)] == [200, 403]
    for api in (reader, embedder):
        assert api.client.post("/v1/acquisitions", json={"upload_id": slot}).status_code == 403
    assert verifier.client.delete(path).status_code == 403


def test_parts_that_are_left_out_are_nowhere(api: Api) -> None:
    whole = set(api.client.app.openapi()["paths"])  # type: ignore[attr-defined]
    for name in OPTIONAL_ROUTERS:
        rest = ",".join(each for each in OPTIONAL_ROUTERS if each != name)
        client = with_settings(api, routers=rest).client
        gone = whole - set(client.app.openapi()["paths"])  # type: ignore[attr-defined]
        assert gone, name
        for path in gone:
            assert client.post(path, json={}).status_code == 404, path
    bare = set(with_settings(api, routers="").client.app.openapi()["paths"])  # type: ignore[attr-defined]
    assert {"/v1/embed", "/v1/verify", "/v1/claims/{claim_id}"} <= bare
    assert not any("pack" in path or "shared" in path for path in bare)
    with pytest.raises(ValidationError):
        Settings(routers="webhooks,blackmail")


def test_a_request_that_is_sent_again_is_done_once(api: Api, sites: Sites, stranger: Api) -> None:  # noqa: F811
    site, key = sites(answer(MODEL)), {"Idempotency-Key": "k1"}
    open_to_all = with_settings(api, acquisitions_private=True)
    body = {"url": site.url("/a.ply")}
    first, again = (open_to_all.client.post("/v1/acquisitions", json=body, headers=key) for _ in range(2))
    assert (first.status_code, again.status_code) == (201, 201)
    assert first.headers["location"] == again.headers["location"]
    assert again.json().items() >= {k: v for k, v in first.json().items() if k != "timestamp_failure"}.items()
    assert len(api.client.get("/v1/acquisitions").json()["items"]) == 1
    other = open_to_all.client.post("/v1/acquisitions", json={"url": site.url("/b.ply")}, headers=key)
    assert (other.status_code, other.json()["type"]) == (422, "urn:mark3dgs:problem:idempotency-mismatch")
    assert stranger.client.post("/v1/acquisitions", json={"upload_id": "up_1"}, headers=key).status_code == 404
    retried = {"upload_id": stranger.upload(MODEL)}
    assert stranger.client.post("/v1/acquisitions", json=retried, headers=key).status_code == 201, "it had failed"


def test_a_slow_address_is_not_fetched_twice_at_once(api: Api) -> None:
    """For all the time that an address may take, the first request is still at work."""
    slow = with_settings(api, acquire_seconds=600.0)
    body = {"upload_id": api.upload(MODEL)}
    caller = check(api.service.db, api.service.master, api.client.headers["authorization"].removeprefix("Bearer "))
    request = {"acquire": NewAcquisition.model_validate(body).model_dump(mode="json")}
    assert idempotency.begin(api.service.db, caller, "k2", request) is None
    for minutes, status in ((9, 409), (12, 201)):
        began = sa.update(rows).where(rows.c.key.endswith(" k2")).values(created_at=ago(minutes / 60))
        api.service.db.change(began.where(rows.c.tenant == caller.tenant))
        answered = slow.client.post("/v1/acquisitions", json=body, headers={"Idempotency-Key": "k2"})
        assert answered.status_code == status, answered.text


def test_by_the_client(api: Api, sites: Sites, tmp_path: Path) -> None:  # noqa: F811
    served = with_settings(api, acquisitions_private=True).client

    def through(request: httpx.Request) -> httpx.Response:
        headers = {name: value for name, value in request.headers.items() if name != "authorization"}
        path = request.url.raw_path.decode()
        there = served.request(request.method, path, content=request.content, headers=headers)
        return httpx.Response(there.status_code, headers=there.headers, content=there.content)

    fetched = do(through, "acquire", sites(answer(MODEL)).url("/a.ply"))
    handed_in = do(through, "acquire", MODEL)
    assert fetched.payload_sha256 == handed_in.payload_sha256 == SHA256
    assert do(through, "acquisition", fetched.id).url == fetched.url
    assert {each.id for each in do(through, "acquisitions")} == {fetched.id, handed_in.id}
    kept = do(through, "warc", fetched.id, tmp_path / "a.warc.gz")
    assert hashlib.sha256(kept.read_bytes()).hexdigest() == fetched.warc_sha256
