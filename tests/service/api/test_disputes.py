"""Who may have two assets compared, and what no other party learns."""

from __future__ import annotations

import secrets
from typing import Any

from service.core import Service
from service.db.schema import assets
from service.trust import audit
from service.trust.api_keys import OPERATOR
from tests.service.api.conftest import Api, _api
from tests.service.rows import add_asset


def asset_of(service: Service, tenant: str) -> str:
    """An asset of a tenant, as a worker would have left it."""
    name = "as_" + secrets.token_hex(12)
    digests = {column.name: "a" * 64 for column in assets.columns if column.name.endswith("sha256")}
    return add_asset(service.db, id=name, tenant=tenant, job=name, **digests)


def ask(api: Api, one: str, two: str) -> dict[str, Any]:
    answer = api.client.post("/v1/disputes", json={"asset_a": one, "asset_b": two})
    return {"status": answer.status_code, **answer.json()}


def test_both_owners_must_agree_and_each_agrees_once(service: Service) -> None:
    alice, bob = (_api(service, f"{name} of disputes", ["verify"]) for name in ("alice", "bob"))
    mine, theirs = asset_of(service, "alice of disputes"), asset_of(service, "bob of disputes")
    for _ in range(2):
        waiting = ask(alice, mine, theirs)
        assert waiting["status"] == 409
        assert "your consent is noted" in waiting["detail"]
    job = ask(bob, theirs, mine)
    assert (job["status"], job["kind"]) == (202, "dispute")
    assert ask(alice, mine, theirs)["status"] == 202
    with service.db.read() as connection:
        entry = audit.find(connection, "dispute.consented", " ".join(("alice of disputes", *sorted((mine, theirs)))))
    assert entry is not None
    assert entry.payload == {"assets": sorted((mine, theirs))}


def test_nobody_learns_whether_anothers_asset_exists(service: Service) -> None:
    alice = _api(service, "alice who guesses", ["verify"])
    mine, theirs = asset_of(service, "alice who guesses"), asset_of(service, "somebody else")
    there, nowhere = ask(alice, mine, theirs), ask(alice, mine, "as_" + "0" * 24)
    assert {name: there[name] for name in ("status", "type", "detail")} == {
        name: nowhere[name] for name in ("status", "type", "detail")
    }
    for one, two in ((theirs, "as_" + "0" * 24), ("as_" + "0" * 24, "as_" + "1" * 24)):
        assert ask(alice, one, two)["status"] == 404


def test_an_administrator_of_a_tenant_is_none_of_the_service(service: Service) -> None:
    one, two = asset_of(service, "first of two"), asset_of(service, "second of two")
    assert ask(_api(service, "first of two", ["admin"]), one, two)["status"] == 409
    assert ask(_api(service, "third", ["admin"]), one, two)["status"] == 404
    operator = _api(service, "whoever runs it", [OPERATOR])
    started = ask(operator, one, two)
    assert started["status"] == 202
    assert operator.client.get(f"/v1/jobs/{started['id']}").status_code == 200
    assert ask(operator, one, "as_" + "0" * 24)["status"] == 404


def test_one_asset_is_no_dispute(service: Service) -> None:
    alice = _api(service, "alice alone", ["admin"])
    mine, other = asset_of(service, "alice alone"), asset_of(service, "alice alone")
    assert ask(alice, mine, mine)["status"] == 409
    assert ask(alice, mine, other)["status"] == 202
    assert alice.client.get("/v1/disputes/di_none").status_code == 404
