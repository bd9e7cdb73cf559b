"""Lists narrowed and searched, places in the queue, and who asks: always of one's own tenant."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from service.client import Client
from service.core import Service
from service.db.schema import assets
from service.trust.api_keys import check, name_tenant
from tests.service.api.conftest import SMALL, Api, _api
from tests.service.api.test_pack import NUMBERS, claim_of
from tests.service.claims.cases import asset_row, nothing, reply


def tenant_of(api: Api) -> str:
    token = api.client.headers["Authorization"].removeprefix("Bearer ")
    return check(api.service.db, api.service.master, token).tenant


def found(api: Api, path: str, **params: Any) -> list[str]:
    """Ids of a list, newest first."""
    answer = api.client.get(path, params=params)
    assert answer.status_code == 200, answer.text
    return [item["id"] for item in answer.json()["items"]]


@pytest.fixture
def models(api: Api, stranger: Api) -> list[str]:
    """Three assets of a tenant, the first two copies of one original; a stranger has the like of the first."""
    marks = [("Garden, north", "acme", "a"), ("Garden, south", "Bolt 100%", "a"), ("Kitchen", "ÖKO", "b")]
    names = []
    for owner in (api, stranger):
        for label, copy, original in marks if owner is api else marks[:1]:
            number, tenant = next(NUMBERS), tenant_of(owner)
            row = asset_row(id=f"as_list{number}", tenant=tenant, job=f"job_list{number}", label=label, copy=copy)
            row |= {"original_sha256": original * 64, "record_id": f"{number:032x}", "report": "{}"}
            row |= {"registered_at": f"2026-01-01T00:00:{number:02}"}
            with api.service.db.write() as connection:
                connection.execute(assets.insert().values(row))
            names.append(row["id"])
    return names


def test_assets(api: Api, stranger: Api, models: list[str]) -> None:
    north, south, kitchen, theirs = models
    for params, expected in (
        ({}, [kitchen, south, north]),
        ({"q": "GARDEN"}, [south, north]),
        ({"q": "öko"}, [kitchen]),
        ({"q": "0%"}, [south]),
        ({"q": "%"}, [south]),
        ({"q": "_"}, [kitchen, south, north]),  # of the ids
        ({"q": north[-4:]}, [north]),
        ({"original": "a" * 64}, [south, north]),
        ({"original": "a" * 64, "q": "north"}, [north]),
        ({"q": "nothing"}, []),
    ):
        assert found(api, "/v1/assets", **params) == expected, params
    assert found(stranger, "/v1/assets", q="garden")[:1] == [theirs]
    page = api.client.get("/v1/assets", params={"q": "garden", "limit": 1}).json()
    assert (page["items"][0]["id"], page["next"]) == (south, south)
    assert found(api, "/v1/assets", q="garden", after=south) == [north]
    for wrong in ({"original": "A" * 64}, {"original": "a"}, {"q": "a\0b"}, {"q": "x" * 201}):
        assert api.client.get("/v1/assets", params=wrong).status_code == 422, wrong


def test_claims(service: Service, api: Api, stranger: Api) -> None:
    number = next(NUMBERS)
    marked = claim_of(service, api, number, reply(asset=f"as_pack{number}"), ["Stolen Garden.ply"])
    other = next(NUMBERS)
    unmarked = claim_of(service, api, other, reply("not_marked", asset=f"as_pack{other}"), ["shot one.png", "Zwei.png"])
    unknown = claim_of(service, api, next(NUMBERS), nothing())
    claim_of(service, stranger, next(NUMBERS), nothing(), ["stolen garden.ply"])
    for params, expected in (
        ({}, [unknown, unmarked, marked]),
        ({"verdict": "marked"}, [marked]),
        ({"verdict": "inconclusive"}, [unknown]),
        ({"asset": f"as_pack{other}"}, [unmarked]),
        ({"asset": f"as_pack{other}", "verdict": "marked"}, []),
        ({"q": "GARDEN"}, [marked]),
        ({"q": "zwei"}, [unmarked]),
        ({"q": "studio NORD"}, [unmarked, marked]),  # who the copies were made for
        ({"q": f"label of {number}"}, [marked]),
        ({"q": marked[-6:]}, [marked]),
        ({"q": f"PACK{other}"}, [unmarked]),
        ({"q": "12" * 32}, [unknown, unmarked, marked]),
        ({"q": "34" * 32}, []),
        ({"q": "12" * 31}, []),
    ):
        assert found(api, "/v1/claims", **params) == expected, params
    (plain,) = api.client.get("/v1/claims", params={"q": "zwei"}).json()["items"]
    assert plain["suspects"] == ["shot one.png", "Zwei.png"]
    assert (plain["asset_id"], plain["asset_label"]) == (f"as_pack{other}", f"label of {other}")
    assert (plain["copy_name"], plain["verdict"]) == (None, "not_marked"), "no mark names a copy"
    api.client.delete(f"/v1/assets/as_pack{other}")
    (plain,) = api.client.get("/v1/claims", params={"q": "zwei"}).json()["items"]
    assert (plain["asset_id"], plain["asset_label"]) == (f"as_pack{other}", None)
    assert api.client.get("/v1/claims", params={"verdict": "perhaps"}).status_code == 422


def test_the_names_of_a_suspect_go_with_its_job(api: Api) -> None:
    """Not into what a retry is known by: the same bytes under another name are the same request."""
    first, again = (api.upload(SMALL.read_bytes(), name) for name in ("a b.ply", "c.ply"))
    headers = {"Idempotency-Key": "names"}
    made = [api.client.post("/v1/verify", json={"upload_id": each}, headers=headers).json() for each in (first, again)]
    assert made[0]["id"] == made[1]["id"]
    job = api.service.jobs.get(tenant_of(api), made[0]["id"])
    assert job is not None
    assert job.request["names"] == ["a b.ply"]


def test_a_job_says_what_it_is_about(api: Api) -> None:
    uploaded = {"upload_id": api.upload(SMALL.read_bytes(), "vase.ply")}
    started = [
        api.client.post("/v1/embed", json={**uploaded, "label": "Blue vase"}).json(),
        api.client.post("/v1/embed", json=uploaded).json(),
        api.client.post("/v1/verify", json=uploaded).json(),
    ]
    assert [job["name"] for job in started] == ["Blue vase", "vase.ply", "vase.ply"]
    assert api.client.get(f"/v1/jobs/{started[0]['id']}").json()["name"] == "Blue vase"
    for job in started:
        api.client.delete(f"/v1/jobs/{job['id']}")


def test_jobs(api: Api, stranger: Api) -> None:
    """By state and kind; those that wait say their place, at every look, and nothing else does."""
    for job in api.service.jobs.list("stranger", 100, states=["queued"]):
        api.service.jobs.cancel("stranger", job.id)
    body = {"upload_id": api.upload(SMALL.read_bytes())}
    verify, embed = (api.client.post(f"/v1/{kind}", json=body).json() for kind in ("verify", "embed"))
    last = api.client.post("/v1/verify", json=body).json()
    assert found(api, "/v1/jobs", kind="verify") == [last["id"], verify["id"]]
    api.service.jobs.begin(verify["id"], "w")
    assert found(api, "/v1/jobs", state=["queued", "running"], kind="verify") == [last["id"], verify["id"]]
    assert found(api, "/v1/jobs", state="queued") == [last["id"], embed["id"]]
    assert found(stranger, "/v1/jobs", state="queued") == []
    assert api.client.get("/v1/jobs", params={"state": "lost"}).status_code == 422

    places = {job["id"]: job["position"] for job in api.client.get("/v1/jobs").json()["items"]}
    assert places[verify["id"]] is None
    assert places[embed["id"]] < places[last["id"]]
    look = api.client.get(f"/v1/jobs/{last['id']}")
    assert look.json()["position"] == places[last["id"]]
    api.client.delete(f"/v1/jobs/{embed['id']}")
    moved = api.client.get(f"/v1/jobs/{last['id']}", headers={"If-None-Match": look.headers["etag"]})
    assert moved.json()["position"] < places[last["id"]], "another place is another answer"
    same = api.client.get(f"/v1/jobs/{last['id']}", headers={"If-None-Match": moved.headers["etag"]})
    assert same.status_code == 304


def test_who_asks(service: Service, api: Api) -> None:
    tenant = tenant_of(api)
    name_tenant(service.db, tenant, "Studio Nord")
    before = api.client.get("/v1/me").json()
    assert (before["tenant"], before["name"]) == (tenant, "Studio Nord")
    assert before["limits"]["queued_jobs"] == {"used": 0, "most": service.settings.queued_jobs}
    data = SMALL.read_bytes()
    api.client.post("/v1/verify", json={"upload_id": api.upload(data)})
    api.client.post("/v1/uploads", json={"size": 5})
    after = api.client.get("/v1/me").json()["limits"]
    assert after == {
        "queued_jobs": {"used": 1, "most": service.settings.queued_jobs},
        "open_uploads": {"used": 1, "most": service.settings.open_uploads},
        "stored_bytes": {"used": len(data) + 5, "most": service.settings.tenant_bytes},
    }
    for scopes in (["verify", "embed"], ["read"], ["operator"], ["originals"]):
        other = _api(service, tenant, scopes)
        key = other.client.get("/v1/me").json()["key"]
        token = other.client.headers["Authorization"].removeprefix("Bearer ")
        assert set(key["scopes"]) == set(scopes)
        assert token.startswith(f"{key['prefix']}_")
        assert token.split("_")[1] == key["id"]


def test_the_client_narrows(api: Api, models: list[str]) -> None:
    token = api.client.headers["authorization"].removeprefix("Bearer ")
    transport: httpx.BaseTransport = api.client._transport
    with Client("http://testserver", token, transport=transport) as client:
        assert [asset.id for asset in client.assets(q="garden", original="a" * 64)] == models[1::-1]
        assert client.claims(verdict="marked", asset=models[0], q="x") == []
        job = client.submit_verify(SMALL.read_bytes())
        assert [each.id for each in client.jobs(state=["queued", "running"], kind="verify")] == [job.id]
        assert client.jobs(state=["running"]) == []
        assert job.position is not None
        assert client.me().limits["queued_jobs"]["used"] == 1
