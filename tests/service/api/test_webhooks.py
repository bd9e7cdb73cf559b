"""/v1/webhooks: a few of each tenant's own, for administrators; the secret is shown once and kept sealed."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import SimpleNamespace

import pytest
import sqlalchemy as sa

from service.client import Client
from service.core import Service
from service.db.schema import audit, webhooks
from service.jobs.port import Job, State
from service.trust import webhook_secrets as registry
from tests.service.api.conftest import Api, _api
from tests.service.api.test_lists import tenant_of

HOOK = {"url": "https://studio.example/hook?token=7", "events": ["job.ended"]}


def test_a_webhook(service: Service, api: Api) -> None:
    answer = api.client.post("/v1/webhooks", json=HOOK)
    assert (answer.status_code, answer.headers["cache-control"]) == (201, "no-store")
    made = answer.json()
    assert (made["url"], made["events"]) == (HOOK["url"], ["job.ended"])
    (listed,) = api.client.get("/v1/webhooks").json()["items"]
    assert listed == {name: value for name, value in made.items() if name != "secret"}
    assert (listed["waiting"], listed["last_at"], listed["last_status"], listed["last_outcome"]) == (
        0,
        None,
        None,
        None,
    )
    job = Job(f"job_{made['id']}", tenant_of(api), "key", "verify", State.QUEUED, {})
    service.jobs.submit(job)
    service.jobs.cancel(job.tenant, job.id)
    assert api.client.get("/v1/webhooks").json()["items"][0]["waiting"] == 1
    assert api.client.delete(f"/v1/webhooks/{made['id']}").status_code == 204
    assert api.client.delete(f"/v1/webhooks/{made['id']}").status_code == 404
    assert api.client.get("/v1/webhooks").json()["items"] == []


def test_the_secret_is_sealed(service: Service, api: Api) -> None:
    made = api.client.post("/v1/webhooks", json=HOOK).json()
    assert len(made["secret"]) == len("whs_") + 64
    with service.db.read() as connection:
        row = connection.execute(sa.select(webhooks).where(webhooks.c.id == made["id"])).one()
    assert registry.secret_of(service.master, row) == made["secret"]
    for path in service.settings.data_dir.glob("*.sqlite*"):
        assert made["secret"].encode() not in path.read_bytes(), path
    with pytest.raises(Exception, match="moved from its place"):
        registry.secret_of(service.master, SimpleNamespace(**row._asdict() | {"tenant": "another"}))


def test_the_log_has_the_host_and_not_the_address(service: Service, api: Api) -> None:
    made = api.client.post("/v1/webhooks", json=HOOK).json()
    api.client.delete(f"/v1/webhooks/{made['id']}")
    with service.db.read() as connection:
        rows = connection.execute(sa.select(audit).where(audit.c.subject == made["id"]).order_by(audit.c.index)).all()
    output = [(row.event, json.loads(row.payload)) for row in rows]
    assert output == [("webhook.made", {"host": "studio.example"}), ("webhook.deleted", {})]


def test_so_many_of_a_tenant(api: Api, stranger: Api, set_up: Callable[..., None]) -> None:
    set_up(webhooks=2)
    codes = [api.client.post("/v1/webhooks", json=HOOK).status_code for _ in range(3)]
    assert codes == [201, 201, 429]
    theirs = stranger.client.post("/v1/webhooks", json=HOOK)
    assert theirs.status_code == 201
    stranger.client.delete(f"/v1/webhooks/{theirs.json()['id']}")


@pytest.mark.parametrize(
    "url",
    [
        "http://studio.example/",
        "https://127.0.0.1/",
        "https://127.1/",
        "https://2130706433/",
        "https://[::1]/",
        "https://[::ffff:10.0.0.1]/",
        "https://169.254.169.254/latest/meta-data",
        "https://localhost/",
        "https://LOCALHOST./",
        "https://me:secret@studio.example/",
        "ftp://studio.example/",
        "https://studio.example/" + "x" * 400,
        "no address",
    ],
)
def test_addresses_that_are_refused(api: Api, url: str) -> None:
    answer = api.client.post("/v1/webhooks", json={"url": url})
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:mark3dgs:problem:invalid-request"), answer.text


def test_the_operator_may_allow_his_own_network(api: Api, set_up: Callable[..., None]) -> None:
    set_up(webhooks_private=True)
    for url in ("http://127.0.0.1:9/", "https://10.0.0.1/x"):
        assert api.client.post("/v1/webhooks", json={"url": url}).status_code == 201


def test_events_are_those_there_are(api: Api) -> None:
    for events in ([], ["job.begun"], ["job.ended", "mark.found", "job.ended"]):
        assert api.client.post("/v1/webhooks", json=HOOK | {"events": events}).status_code == 422
    assert api.client.post("/v1/webhooks", json={"url": HOOK["url"]}).json()["events"] == ["job.ended", "mark.found"]
    some = api.client.post("/v1/webhooks", json=HOOK | {"events": ["mark.found"]}).json()
    assert some["events"] == ["mark.found"]
    assert [each["events"] for each in api.client.get("/v1/webhooks").json()["items"]][-1] == ["mark.found"]


def test_for_administrators(service: Service, api: Api) -> None:
    """An address gets the results of all jobs: that is more than one key's own, and an address may hold a secret."""
    made = api.client.post("/v1/webhooks", json=HOOK).json()
    for scopes in (["embed", "verify", "read", "originals"], ["operator"]):
        client = _api(service, tenant_of(api), scopes).client
        assert client.post("/v1/webhooks", json=HOOK).status_code == 403
        assert client.get("/v1/webhooks").status_code == 403
        assert client.delete(f"/v1/webhooks/{made['id']}").status_code == 403


def test_the_client(api: Api) -> None:
    token = api.client.headers["authorization"].removeprefix("Bearer ")
    with Client("http://testserver", token, transport=api.client._transport) as client:
        made = client.add_webhook(str(HOOK["url"]))
        assert made.secret is not None
        assert [(each.id, each.secret, each.waiting) for each in client.webhooks()] == [(made.id, None, 0)]
        client.delete_webhook(made.id)
        assert client.webhooks() == []
