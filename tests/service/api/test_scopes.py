"""What each scope gives and what it does not: originals by one of their own, one's own job without `read`."""

from __future__ import annotations

from typing import Any

import pytest

from service.db.schema import claims
from service.jobs.port import Job, State
from tests.service.api.conftest import SMALL, Api, _api
from tests.service.rows import add_asset

TENANT = "tenant of scopes"


@pytest.fixture
def made(service: Any) -> dict[str, str]:
    """An embed and a verify job of two keys, and what came of them."""
    owner = _api(service, TENANT, ["admin"])
    digest = owner.client.get(f"/v1/uploads/{owner.upload(SMALL.read_bytes())}").json()["sha256"]
    embedder, verifier = _api(service, TENANT, ["embed"]), _api(service, TENANT, ["verify"])
    ids = {"embedder": embedder, "verifier": verifier}
    for number, (kind, who) in enumerate((("embed", embedder), ("verify", verifier))):
        key_id = who.client.headers["Authorization"].split("_")[1]
        job = Job(f"job_{kind}{id(ids)}", TENANT, key_id, kind, State.QUEUED, {"model": digest})
        service.jobs.submit(job)
        ids[kind] = job.id
        of_it = {"tenant": TENANT, "job": job.id}
        if number == 0:
            of_it |= {f"{name}_sha256": digest for name in ("original", "model", "record", "preview", "sketch")}
            of_it |= {"original_format": "ply", "model_format": "ply"}
            ids["asset"] = add_asset(service.db, id=f"as_{id(ids)}", **of_it)
        else:
            ids["claim"] = f"cl_{id(ids)}"
            of_it |= {"document": "{}", "jws": "a.b.c", "pictures": "{}", "created_at": "x"}
            service.db.change(claims.insert().values(of_it | {"id": ids["claim"]}))
    return ids  # type: ignore[return-value]


def get(api: Api, path: str) -> int:
    return api.client.get(path).status_code


def test_read_gives_no_original_and_no_record(service: Any, made: dict[str, Any]) -> None:
    reader, keeper = _api(service, TENANT, ["read"]), _api(service, TENANT, ["read", "originals"])
    asset = f"/v1/assets/{made['asset']}"
    for api, status in ((reader, 403), (keeper, 200)):
        assert get(api, f"{asset}/model?version=original") == status
    assert get(reader, f"{asset}/record") == 403
    assert get(keeper, f"{asset}/record") != 403
    for path in (asset, f"{asset}/model", f"{asset}/preview.png", f"/v1/claims/{made['claim']}.jws"):
        assert get(reader, path) == 200, path


def test_embed_follows_its_own_job_and_fetches_its_result(service: Any, made: dict[str, Any]) -> None:
    mine, other = made["embedder"], _api(service, TENANT, ["embed"])
    asset, job = f"/v1/assets/{made['asset']}", f"/v1/jobs/{made['embed']}"
    for path in (job, asset, f"{asset}/model", f"{asset}/preview.png"):
        assert get(mine, path) == 200, path
        assert get(other, path) == 404, f"{path} of another key"
    assert get(mine, f"/v1/jobs/{made['verify']}") == 404
    assert get(mine, f"/v1/claims/{made['claim']}.jws") == 404
    for path in ("/v1/jobs", "/v1/assets", "/v1/claims", f"{asset}/record", f"{asset}/model?version=original"):
        assert get(mine, path) == 403, path
    assert get(made["verifier"], f"/v1/claims/{made['claim']}.jws") == 200
    assert other.client.delete(job).status_code == 404
    assert mine.client.delete(job).json()["state"] == "cancelled"


def test_metrics_are_for_the_operator(service: Any) -> None:
    """They count what all tenants have: an administrator of one may not see them."""
    assert get(_api(service, TENANT, ["admin"]), "/metrics") == 403
    answer = _api(service, TENANT, ["operator"]).client.get("/metrics")
    assert answer.status_code == 200
    assert "mark3dgs_jobs" in answer.text


def test_an_upload_is_its_keys_own(service: Any) -> None:
    mine, other, admin = (_api(service, TENANT, [scope]) for scope in ("embed", "verify", "admin"))
    slot = mine.upload(SMALL.read_bytes())
    path = f"/v1/uploads/{slot}"
    assert [slot in api.client.get("/v1/uploads").text for api in (mine, other, admin)] == [True, False, True]
    opened = mine.client.post("/v1/uploads", json={"size": 3}).json()["id"]
    for path in (f"/v1/uploads/{slot}", f"/v1/uploads/{opened}"):
        assert (get(mine, path), get(other, path), get(admin, path)) == (200, 404, 200)
        assert other.client.put(path, content=b"abc").status_code == 404
        assert other.client.delete(path).status_code == 404
    assert other.client.post("/v1/verify", json={"upload_id": slot}).status_code == 404
    assert mine.client.post("/v1/embed", json={"upload_id": slot}).status_code == 202
    assert admin.client.delete(path).status_code == 204


@pytest.mark.parametrize(("profile", "most"), [("balanced", 47), ("strong", 45), ("auto", 47), ("paper", 31)])
def test_a_mark_fainter_than_the_profiles_is_for_those_who_may_see_originals(
    service: Any, profile: str, most: float
) -> None:
    """With `psnr: 90` the marked model is the unmarked one to the last bit of most colors."""
    for scopes, psnr, status in ((["embed"], most, 202), (["embed"], most + 0.1, 403), (["embed"], 90, 403)):
        api = _api(service, TENANT, scopes)
        body = {"upload_id": api.upload(SMALL.read_bytes()), "profile": profile, "psnr": psnr}
        assert api.client.post("/v1/embed", json=body).status_code == status, psnr
    keeper = _api(service, TENANT, ["embed", "originals"])
    body = {"upload_id": keeper.upload(SMALL.read_bytes()), "profile": profile, "psnr": 90}
    assert keeper.client.post("/v1/embed", json=body).status_code == 202
