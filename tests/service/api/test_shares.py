"""Shared reports: shown to all with the address, until it expires or is revoked; of the address nothing is kept."""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from typing import Any

import httpx
import pytest
import sqlalchemy as sa
from fastapi.testclient import TestClient

from service import worker
from service.claims import shares as sharing
from service.claims.offline import verify_report
from service.client import Client
from service.clock import ago
from service.core import Service
from service.db.schema import audit, claims, jobs, shares
from service.jobs.port import Job, State
from service.trust.audit_check import verify_log
from service.trust.signing import jwks
from tests.service.api.conftest import Api, _api
from tests.service.api.test_lists import tenant_of
from tests.service.api.test_pack import NUMBERS, claim_of
from tests.service.claims.cases import nothing, reply


@pytest.fixture
def claim(service: Service, api: Api) -> str:
    number = next(NUMBERS)
    return claim_of(service, api, number, reply(asset=f"as_pack{number}"))


@pytest.fixture
def anybody(api: Api) -> TestClient:
    """Without an API key."""
    return TestClient(api.client.app, raise_server_exceptions=False)


def made(api: Api, claim: str, **body: Any) -> dict[str, str]:
    answer = api.client.post(f"/v1/claims/{claim}/share", json=body)
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


def at(share: dict[str, str], *more: str) -> str:
    """The path of an address."""
    return httpx.URL(share["url"]).path + "".join(more)


def test_whoever_has_the_address_sees_the_report(service: Service, api: Api, anybody: TestClient, claim: str) -> None:
    share = made(api, claim)
    page = anybody.get(at(share))
    assert page.status_code == 200
    assert page.content == api.client.get(f"/v1/claims/{claim}/report").content
    assert verify_report(page.content, jwks(service.db)).valid, "saved unaltered, it is checked like any other"
    plain, pack = anybody.get(at(share, "/claim.json")), anybody.get(at(share, "/pack"))
    assert plain.json() == api.client.get(f"/v1/claims/{claim}").json()
    assert pack.content == api.client.get(f"/v1/claims/{claim}/pack").content
    rates, same = anybody.get(at(share, "/annex")), api.client.get(f"/v1/claims/{claim}/annex")
    assert "How often the method errs" in rates.text
    assert (rates.content, same.headers["content-type"]) == (same.content, page.headers["content-type"])
    assert same.headers["content-security-policy"] == page.headers["content-security-policy"], (
        "it has a style of its own"
    )
    forged = anybody.get(at(share, "/pack"), params={"note": "the owner says so", "copy_url": "https://a.example"})
    assert forged.content == pack.content, "a stranger's words are no owner's"
    for answer in (page, plain, pack, rates, anybody.head(at(share))):
        assert answer.headers["cache-control"] == "no-store"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["x-robots-tag"] == "noindex"
        assert answer.headers["content-security-policy"].startswith("default-src 'none'")
    assert anybody.post(at(share)).status_code == 405


def test_nothing_on_the_page_needs_an_api_key(api: Api, anybody: TestClient, claim: str) -> None:
    page = anybody.get(at(made(api, claim))).text
    assert "href=" not in page
    assert "<form" not in page
    assert "<script" not in page


def test_the_days_count(api: Api, claim: str) -> None:
    for body, days in (({}, 14), ({"days": 1}, 1), ({"days": 90.0}, 90)):
        left = datetime.fromisoformat(made(api, claim, **body)["expires_at"]) - datetime.now(UTC)
        assert timedelta(days=days, minutes=-1) < left <= timedelta(days=days)
    assert api.client.post(f"/v1/claims/{claim}/share").status_code == 201, "nothing said is 14 days, too"
    for wrong in (0, 91, 1.5, "14", None, True):
        answer = api.client.post(f"/v1/claims/{claim}/share", json={"days": wrong})
        assert answer.status_code == 422, wrong


def test_unknown_expired_revoked_and_deleted_look_alike(
    service: Service, api: Api, anybody: TestClient, claim: str
) -> None:
    other = next(NUMBERS)
    deleted = claim_of(service, api, other, reply(asset=f"as_pack{other}"))
    expired, revoked, orphan, standing = (made(api, each) for each in (claim, claim, deleted, claim))
    with service.db.write() as connection:
        connection.execute(sa.update(shares).where(shares.c.id == expired["id"]).values(expires_at=ago(0)))
    assert api.client.delete(f"/v1/shares/{revoked['id']}").status_code == 204
    assert api.client.delete(f"/v1/shares/{revoked['id']}").status_code == 404
    assert api.client.delete(f"/v1/claims/{deleted}").status_code == 204
    assert anybody.get(at(standing)).status_code == 200
    unknown = {"url": "http://t/shared/" + "A" * 43}
    said = set()
    for share in (unknown, expired, revoked, orphan):
        for more in ("", "/claim.json", "/pack"):
            answer = anybody.get(at(share, more))
            assert answer.status_code == 404
            assert answer.headers["cache-control"] == "no-store"
            said.add(json.dumps({name: text for name, text in answer.json().items() if name != "request_id"}))
    assert len(said) == 1
    listed = api.client.get(f"/v1/claims/{claim}/shares").json()["items"]
    assert [each["id"] for each in listed] == [standing["id"]]
    assert sharing.sweep(service.db) == 2, "the expired one, and that of the claim that is gone"
    with service.db.read() as connection:
        left = set(connection.execute(sa.select(shares.c.id)).scalars())
    assert {standing["id"]} == left & {each["id"] for each in (expired, revoked, orphan, standing)}


def test_a_worker_sweeps(service: Service, api: Api, claim: str, monkeypatch: pytest.MonkeyPatch) -> None:
    share, naps = made(api, claim), [None]
    with service.db.write() as connection:
        connection.execute(sa.update(shares).where(shares.c.id == share["id"]).values(expires_at=ago(0)))
    monkeypatch.setattr(time, "sleep", lambda _: naps.pop())  # the second time there is none left
    with pytest.raises(IndexError):
        worker._tidy(service)
    with service.db.read() as connection:
        assert connection.execute(sa.select(shares).where(shares.c.id == share["id"])).first() is None


def test_of_an_address_only_the_digest_is_kept(service: Service, api: Api, claim: str) -> None:
    share = made(api, claim)
    token = share["url"].rpartition("/")[2]
    assert len(token) == 43, "32 random bytes"
    with service.db.read() as connection:
        row = connection.execute(sa.select(shares).where(shares.c.id == share["id"])).one()
    assert row.digest == sha256(token.encode()).hexdigest()
    for path in service.settings.data_dir.glob("*.sqlite*"):
        assert token.encode() not in path.read_bytes(), path


def test_the_log_says_who_shared_what(service: Service, api: Api, claim: str) -> None:
    share = made(api, claim)
    api.client.delete(f"/v1/shares/{share['id']}")
    with service.db.read() as connection:
        rows = connection.execute(sa.select(audit).where(audit.c.subject == claim).order_by(audit.c.index)).all()
    key = api.client.get("/v1/me").json()["key"]["id"]
    events = [(row.event, json.loads(row.payload)) for row in rows][1:]
    assert events == [
        ("claim.shared", {"share": share["id"], "api_key": key, "expires_at": share["expires_at"]}),
        ("claim.share_revoked", {"share": share["id"], "api_key": key}),
    ]
    assert not [fault for fault in verify_log(service.db).faults if claim in fault.text]


def test_a_report_that_shows_the_unmarked_original_is_not_shared(service: Service, api: Api, claim: str) -> None:
    """As those of earlier versions do."""
    with service.db.write() as connection:
        row = connection.execute(sa.select(claims).where(claims.c.id == claim)).one()
        before = json.dumps({"reference": json.loads(row.pictures)["asset"]})
        connection.execute(sa.update(claims).where(claims.c.id == claim).values(pictures=before))
    answer = api.client.post(f"/v1/claims/{claim}/share", json={})
    assert (answer.status_code, answer.json()["type"]) == (409, "urn:mark3dgs:problem:conflict")


def test_a_claim_that_recognised_nothing_has_a_page_and_no_pack(
    service: Service, api: Api, anybody: TestClient
) -> None:
    share = made(api, claim_of(service, api, next(NUMBERS), nothing()))
    assert anybody.get(at(share)).status_code == 200
    assert anybody.get(at(share, "/pack")).status_code == 409


def test_so_many_addresses_of_one_claim(api: Api, claim: str) -> None:
    first = made(api, claim)
    for _ in range(sharing.MOST - 1):
        made(api, claim)
    assert api.client.post(f"/v1/claims/{claim}/share", json={}).status_code == 429
    api.client.delete(f"/v1/shares/{first['id']}")
    made(api, claim)


def test_who_may_share(service: Service, api: Api, stranger: Api, claim: str) -> None:
    """Keys that may make claims, of those that they see."""
    tenant = tenant_of(api)
    mine, other, both = (_api(service, tenant, list(scopes)) for scopes in (["verify"], ["verify"], ["read", "verify"]))
    key = mine.client.get("/v1/me").json()["key"]["id"]
    job = Job(f"job_share{next(NUMBERS)}", tenant, key, "verify", State.QUEUED, {})
    service.jobs.submit(job)
    with service.db.write() as connection:
        connection.execute(sa.update(claims).where(claims.c.id == claim).values(job=job.id))
    path = f"/v1/claims/{claim}/share"
    for who, status in (
        (stranger, 404),
        (other, 404),
        (_api(service, tenant, ["read"]), 403),
        (both, 201),
        (mine, 201),
    ):
        assert who.client.post(path, json={}).status_code == status
    share = made(api, claim)
    for who, status in ((stranger, 404), (other, 404), (_api(service, tenant, ["read"]), 403), (mine, 204)):
        assert who.client.delete(f"/v1/shares/{share['id']}").status_code == status
    assert stranger.client.get(f"{path}s").status_code == 404
    with service.db.write() as connection:
        connection.execute(sa.delete(jobs).where(jobs.c.id == job.id))


def test_the_address_is_that_of_the_service(service: Service, api: Api, claim: str, monkeypatch: Any) -> None:
    api.client.headers["Host"] = "evil.example"
    assert made(api, claim)["url"].startswith("/shared/"), "a Host header is anybody's word"
    monkeypatch.setattr(service.settings, "public_url", "https://marks.example/")
    assert made(api, claim)["url"].startswith("https://marks.example/shared/")


def test_the_client_shares(api: Api, anybody: TestClient, claim: str) -> None:
    token = api.client.headers["authorization"].removeprefix("Bearer ")
    with Client("http://testserver", token, transport=api.client._transport) as client:
        share = client.share(claim, days=3)
        assert share.url is not None
        assert anybody.get(httpx.URL(share.url).path).status_code == 200
        assert [(each.id, each.url) for each in client.shares(claim)] == [(share.id, None)]
        client.revoke_share(share.id)
        assert client.shares(claim) == []
        assert anybody.get(httpx.URL(share.url).path).status_code == 404
