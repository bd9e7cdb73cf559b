"""What an owner enters once: the name in claims, the address of the service; and API keys made with chosen scopes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from service.claims.document import of_what_was_found
from service.claims.issuing import issue
from service.core import Service
from service.db.schema import claims
from service.jobs.port import Job, State
from service.settings import Settings
from service.trust.api_keys import FIRST_TENANT
from service.trust.audit_check import verify_log
from service.trust.signing import ensure_key
from tests.service.api.conftest import Api, _api
from tests.service.api.test_acquisitions import with_settings
from tests.service.claims.cases import nothing

NAME = 'Studio <b>"Nord"</b>, Kiel'
ADDRESS = "https://marks.example"


@pytest.fixture
def fresh(tmp_path: Path) -> Iterator[Service]:
    """A service of this test's own."""
    made = Service.open(Settings(data_dir=tmp_path))
    ensure_key(made.db, made.master)
    yield made
    made.close()


def claim(service: Service, tenant: str, number: int) -> dict[str, Any]:
    """The document of a claim that is made now."""
    job = Job(f"job_{number}", tenant, "key", "verify", State.RUNNING, {"model": "12" * 32, "images": []})
    result = issue(service, job, of_what_was_found(nothing() | {"kept": {}}))
    row = service.db.query(claims.select().where(claims.c.id == result["claim_id"])).one()
    return dict(json.loads(row.document))


def test_later_claims_name_owner_and_address(fresh: Service) -> None:
    owner = _api(fresh, FIRST_TENANT, ["admin"])
    me = owner.client.get("/v1/me").json()
    assert (me["name"], me["is_named"]) == (FIRST_TENANT, False)
    assert (me["service"]["public_url"], me["service"]["may_set_public_url"]) == ("", True)
    assert claim(fresh, FIRST_TENANT, 1)["owner"] == {"name": FIRST_TENANT}
    answer = owner.client.patch("/v1/me", json={"name": NAME, "public_url": f"{ADDRESS}/"})
    assert answer.status_code == 200, answer.text
    me = owner.client.get("/v1/me").json()
    assert (me["name"], me["is_named"], me["service"]["public_url"]) == (NAME, True, ADDRESS)
    document = claim(fresh, FIRST_TENANT, 2)
    assert (document["owner"], document["issuer"]["address"]) == ({"name": NAME}, ADDRESS)
    report = owner.client.get(f"/v1/claims/{document['claim_id']}/report").text
    assert "Studio &lt;b&gt;" in report
    assert "<b>" not in report
    shared = owner.client.post(f"/v1/claims/{document['claim_id']}/share").json()["url"]
    assert shared.startswith(f"{ADDRESS}/shared/")
    assert owner.client.patch("/v1/me", json={"name": "Nord"}).json()["service"]["public_url"] == ADDRESS
    assert owner.client.patch("/v1/me", json={"public_url": None}).json()["service"]["public_url"] == ""
    assert verify_log(fresh.db).ok


def test_a_configured_address_wins_and_cannot_be_changed(fresh: Service) -> None:
    owner = _api(fresh, FIRST_TENANT, ["admin"])
    assert owner.client.patch("/v1/me", json={"public_url": ADDRESS}).status_code == 200
    fixed = with_settings(owner, public_url="https://set.example/")
    said = fixed.client.get("/v1/me").json()["service"]
    assert (said["public_url"], said["may_set_public_url"]) == ("https://set.example", False)
    refused = fixed.client.patch("/v1/me", json={"name": "Nord", "public_url": "https://other.example"})
    assert (refused.status_code, "MARK3DGS_PUBLIC_URL" in refused.json()["detail"]) == (409, True)
    assert claim(fixed.service, FIRST_TENANT, 1)["issuer"]["address"] == "https://set.example"


def test_one_tenant_does_not_enter_the_address_for_all(api: Api, reader: Api) -> None:
    assert not api.client.get("/v1/me").json()["service"]["may_set_public_url"]
    assert api.client.patch("/v1/me", json={"public_url": ADDRESS}).status_code == 403
    assert reader.client.patch("/v1/me", json={"name": "Nord"}).status_code == 403
    assert api.client.patch("/v1/me", json={"name": "Nord"}).json()["name"] == "Nord"


@pytest.mark.parametrize(
    "body",
    [
        {"name": ""},
        {"name": " Nord"},
        {"name": "a\nb"},
        {"name": "a\0b"},
        {"name": "x" * 101},
        {"public_url": "javascript:alert(1)"},
        {"public_url": "https://u:p@a.example/"},
        {"public_url": "https://a.example/?q=1"},
        {"public_url": "a.example"},
        {"other": "x"},
    ],
)
def test_names_and_addresses_that_are_none(fresh: Service, body: dict[str, str]) -> None:
    owner = _api(fresh, FIRST_TENANT, ["admin"])
    before = owner.client.get("/v1/me").json()
    assert owner.client.patch("/v1/me", json=body).status_code == 422
    assert owner.client.get("/v1/me").json() == before


def test_parts_that_are_switched_off_are_named_nowhere(api: Api) -> None:
    assert "packs" in api.client.get("/v1/me").json()["service"]["parts"]
    assert with_settings(api, routers="shares").client.get("/v1/me").json()["service"]["parts"] == ["shares"]


def test_an_api_key_does_what_it_was_made_for_until_it_is_revoked(api: Api, reader: Api) -> None:
    made = api.client.post("/v1/api-keys", json={"label": "Build", "scopes": ["read", "embed"]})
    assert (made.status_code, made.headers["cache-control"]) == (201, "no-store")
    key = made.json()
    headers = {"Authorization": f"Bearer {key['token']}"}
    assert api.client.get("/v1/me", headers=headers).json()["key"]["scopes"] == ["embed", "read"]
    listed = api.client.get("/v1/api-keys").json()["items"]
    assert {"id": key["id"], "label": "Build", "scopes": ["embed", "read"]}.items() <= listed[0].items()
    assert key["token"].rpartition("_")[2] not in json.dumps(listed)
    assert reader.client.get("/v1/api-keys").status_code == 403
    assert reader.client.post("/v1/api-keys", json={"scopes": ["admin"]}).status_code == 403
    assert api.client.get("/v1/api-keys", headers=headers).status_code == 403
    assert api.client.delete(f"/v1/api-keys/{key['id']}").status_code == 204
    assert api.client.get("/v1/me", headers=headers).status_code == 401


def test_api_keys_stay_within_tenant_and_scopes(api: Api, stranger: Api) -> None:
    mine = api.client.get("/v1/me").json()["key"]["id"]
    assert stranger.client.delete(f"/v1/api-keys/{mine}").status_code == 404
    assert mine not in [each["id"] for each in stranger.client.get("/v1/api-keys").json()["items"]]
    assert api.client.delete(f"/v1/api-keys/{mine}").status_code == 409, "it would lock its owner out"
    for scopes, status in ((["operator"], 403), ([], 422), (["root"], 422)):
        assert api.client.post("/v1/api-keys", json={"scopes": scopes}).status_code == status
    operator = _api(api.service, "operators", ["admin", "operator"])
    assert operator.client.post("/v1/api-keys", json={"scopes": ["operator"]}).status_code == 201
