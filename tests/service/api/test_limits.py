"""What one tenant may ask of the service at a time, so that the others are not kept waiting."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi.testclient import TestClient

from service.app import make_app
from service.assets import conversions
from service.core import Service
from service.db.schema import assets
from service.processes import Turns
from service.settings import Settings
from service.uploads import ingest, store
from service.uploads.store import stored_bytes
from tests.service.api.conftest import SMALL, Api, SetUp, _api
from tests.service.rows import add_asset


def test_a_queue_of_so_many_jobs(api: Api, stranger: Api, set_up: SetUp) -> None:
    set_up(queued_jobs=2)
    body = {"upload_id": api.upload(SMALL.read_bytes())}
    jobs = [api.client.post("/v1/verify", json=body) for _ in range(3)]
    assert [answer.status_code for answer in jobs] == [202, 202, 429]
    assert int(jobs[2].headers["retry-after"]) > 0
    theirs = {"upload_id": stranger.upload(SMALL.read_bytes())}
    assert stranger.client.post("/v1/verify", json=theirs).status_code == 202
    api.client.delete(f"/v1/jobs/{jobs[0].json()['id']}")
    assert api.client.post("/v1/verify", json=body).status_code == 202, "one that ended makes room"


def test_storage(api: Api, set_up: SetUp) -> None:
    data = SMALL.read_bytes()
    set_up(tenant_bytes=2 * len(data) + 1000)
    first, _ = api.upload(data), api.upload(data)
    refused = api.client.post("/v1/uploads", json={"size": 2000})
    assert (refused.status_code, refused.json()["type"]) == (413, "urn:mark3dgs:problem:quota-exceeded")
    assert refused.json()["stored"] == 2 * len(data)
    slot = api.client.post("/v1/uploads", json={}).json()["id"]
    assert api.client.put(f"/v1/uploads/{slot}", content=bytes(2000)).status_code == 413, "nor unannounced"
    form = api.client.post("/v1/verify", files={"model": ("m.ply", data)})
    assert form.json()["type"] == "urn:mark3dgs:problem:quota-exceeded"
    assert api.client.delete(f"/v1/uploads/{first}").status_code == 204
    assert api.client.post("/v1/uploads", json={"size": 2000}).status_code == 201, "deleting makes room at once"


def test_a_tenant_that_stores_too_much_cannot_embed(api: Api, set_up: SetUp) -> None:
    body = {"upload_id": api.upload(SMALL.read_bytes())}
    set_up(tenant_bytes=len(SMALL.read_bytes()))
    assert api.client.post("/v1/embed", json=body).json()["type"] == "urn:mark3dgs:problem:quota-exceeded"


def test_uploads_under_way(api: Api, set_up: SetUp) -> None:
    set_up(open_uploads=2)
    codes = [api.client.post("/v1/uploads", json={"size": 10}).status_code for _ in range(3)]
    assert codes == [201, 201, 429]
    assert "429" in api.client.get("/openapi.json").json()["paths"]["/v1/uploads"]["post"]["responses"]


def _asset(api: Api, number: int, **values: Any) -> str:
    """A registered asset of `api`'s tenant; bytes in, out and of the record: 100, 10, 1 million."""
    key = api.key()
    with api.service.db.read() as connection:
        from service.db.schema import owner_keys

        tenant = connection.execute(owner_keys.select().where(owner_keys.c.id == key)).one().tenant
    report = {"bytes_in": 100_000_000, "bytes_out": 10_000_000, "record_bytes": 1_000_000}
    row = {"id": f"as_{tenant[-30:]}_{number}", "tenant": tenant, "job": f"job of {tenant} {number}"}
    row |= {"report": json.dumps(report), "model_format": "ply", "model_sha256": f"{number:064x}"} | values
    return add_asset(api.service.db, **row)


def test_what_a_tenant_stores(api: Api) -> None:
    """An original counts once however many copies; as an upload that is still there it is not counted twice."""
    _asset(api, 1, original_sha256="a" * 64)
    _asset(api, 2, original_sha256="a" * 64)
    tenant = _tenant(api)

    def stored() -> int:
        with api.service.db.read() as connection:
            return stored_bytes(connection, tenant)

    copies = 2 * (10_000_000 + 1_000_000 + (1 << 20))
    assert stored() == 100_000_000 + copies
    data = SMALL.read_bytes()
    slot = api.upload(data)
    sha256 = api.client.get(f"/v1/uploads/{slot}").json()["sha256"]
    _asset(api, 3, original_sha256=sha256)
    assert stored() == 100_000_000 + copies * 3 // 2 + len(data)


def _tenant(api: Api) -> str:
    with api.service.db.read() as connection:
        rows = connection.execute(assets.select().order_by(assets.c.id)).all()
    return str(next(row.tenant for row in rows if row.id in api.client.get("/v1/assets").text))


class Slow:
    """In place of the task `convert`: counts, and waits to be let go."""

    def __init__(self) -> None:
        self.go, self.begun = threading.Event(), 0

    def __call__(self, settings: Settings, task: str, request: dict[str, str], folder: Any, *_: Any) -> dict[str, Any]:
        self.begun += 1
        assert self.go.wait(20)
        (folder / "m").write_bytes(request["format"].encode())
        return {"files": {"model": "m"}}


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> Iterator[Slow]:
    made = Slow()
    monkeypatch.setattr(conversions, "run_within", made)
    yield made
    made.go.set()


def test_conversions(api: Api, stranger: Api, slow: Slow) -> None:
    """44 who ask for one conversion cost one, other conversions wait at a limit, and nobody else's list does."""
    slot = api.upload(SMALL.read_bytes())
    sha256 = api.client.get(f"/v1/uploads/{slot}").json()["sha256"]
    asset = _asset(api, 1, model_sha256=sha256)
    app, mine, theirs = api.client.app, api.client.headers, stranger.client.headers

    async def ask() -> None:
        transport = httpx.ASGITransport(app)  # type: ignore[arg-type]
        async with httpx.AsyncClient(transport=transport, base_url="http://t", timeout=30) as client:

            async def get(kind: str) -> httpx.Response:
                return await client.get(f"/v1/assets/{asset}/model?format={kind}", headers=mine)

            same = [asyncio.create_task(get("spz")) for _ in range(44)]
            other = asyncio.create_task(get("sog"))
            while slow.begun < 2:
                await asyncio.sleep(0.01)
            third = await get("splat")
            assert (third.status_code, third.json()["type"]) == (429, "urn:mark3dgs:problem:budget-exceeded")
            assert (await client.get("/v1/assets", headers=theirs)).status_code == 200
            same.pop().cancel()
            await asyncio.sleep(0.05)
            slow.go.set()
            answers = await asyncio.gather(*same)
            assert {(answer.status_code, answer.content) for answer in answers} == {(200, b"spz")}
            assert (await other).content == b"sog"

    asyncio.run(ask())
    assert slow.begun == 2
    assert api.client.get(f"/v1/assets/{asset}/model?format=spz").content == b"spz"
    assert slow.begun == 2, "kept"


def test_looks_that_wait_keep_nobody_else_waiting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Forty uploads of one tenant wait to be looked at; another's job is taken on and followed meanwhile."""
    service = Service.open(Settings(data_dir=tmp_path))
    hostile, honest = _api(service, "hostile", ["admin"]), _api(service, "honest", ["admin"])
    theirs = {"upload_id": honest.upload(SMALL.read_bytes())}
    slots = [hostile.client.post("/v1/uploads", json={}).json()["id"] for _ in range(40)]
    go, waiting = threading.Event(), threading.Semaphore(0)

    def look(*_: Any) -> None:
        waiting.release()
        assert go.wait(60)

    monkeypatch.setattr(ingest, "run_once", look)
    with TestClient(make_app(service)) as client, ThreadPoolExecutor(40) as pool:
        garbage = [
            pool.submit(client.put, f"/v1/uploads/{slot}", content=b"x", headers=dict(hostile.client.headers))
            for slot in slots
        ]
        try:
            assert all(waiting.acquire(timeout=30) for _ in slots)
            headers = {**dict(honest.client.headers), "Prefer": "wait=1"}
            answer = client.post("/v1/verify", json=theirs, headers=headers)
            assert answer.status_code == 202, answer.text
        finally:
            go.set()
        assert {each.result().status_code for each in garbage} == {200}


def test_unannounced_uploads_at_a_time_do_not_pass_the_limit(
    api: Api, set_up: SetUp, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What there was room for when it began to come may find none when it has come."""
    data = SMALL.read_bytes()
    set_up(tenant_bytes=len(data) + 10)
    slots = [api.client.post("/v1/uploads", json={}).json()["id"] for _ in range(2)]
    monkeypatch.setattr(store, "room", lambda service, row: 1 << 30)
    statuses = [api.client.put(f"/v1/uploads/{slot}", content=data).status_code for slot in slots]
    assert statuses == [200, 413]


def test_limits_hold_for_many_who_ask_at_once(api: Api, set_up: SetUp) -> None:
    """Forty see that there is room for one more."""
    set_up(queued_jobs=3, open_uploads=2, tenant_bytes=10**6)
    body = {"upload_id": api.upload(SMALL.read_bytes())}

    def ask(number: int) -> tuple[int, int]:
        job = api.client.post("/v1/verify", json=body)
        return job.status_code, api.client.post("/v1/uploads", json={"size": 10}).status_code

    with ThreadPoolExecutor(20) as pool:
        jobs, slots = zip(*pool.map(ask, range(40)), strict=True)
    assert (jobs.count(202), jobs.count(429)) == (3, 37)
    assert (slots.count(201), slots.count(429)) == (2, 38)


def test_storage_holds_for_many_who_ask_at_once(api: Api, set_up: SetUp) -> None:
    set_up(tenant_bytes=1000)
    with ThreadPoolExecutor(20) as pool:
        answers = list(pool.map(lambda _: api.client.post("/v1/uploads", json={"size": 400}).status_code, range(20)))
    assert (answers.count(201), answers.count(413)) == (2, 18)


def test_two_turns_go_to_two_tenants() -> None:
    turns, order, go = Turns(2), [], threading.Event()

    def work(tenant: str) -> None:
        with turns.of(tenant):
            order.append(tenant)
            go.wait(10)

    threads = [threading.Thread(target=work, args=(tenant,)) for tenant in "aaab"]
    for number, thread in enumerate(threads):
        thread.start()
        while len(turns._waiting) + len(order) < number + 1:
            time.sleep(0.001)
    assert order == ["a", "a"]
    turns._at_once = 3
    with turns._changed:
        turns._changed.notify_all()
    while len(order) < 3:
        time.sleep(0.001)
    go.set()
    for thread in threads:
        thread.join(10)
    assert order == ["a", "a", "b", "a"], "b came last, and had none at work"
