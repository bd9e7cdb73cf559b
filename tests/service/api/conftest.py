"""The application in this process, without workers: jobs are taken on and stay queued."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.app import make_app
from service.core import Service
from service.settings import Settings
from service.trust.api_keys import issue
from service.trust.signing import ensure_key

DATA = Path(__file__).resolve().parents[2] / "data"
PLANT = DATA / "plant.splat"
SMALL = DATA / "train_1000.ply"
SetUp = Callable[..., None]


@dataclass(frozen=True)
class Api:
    """A client of one tenant."""

    client: TestClient
    service: Service

    def key(self) -> str:
        """A new owner key."""
        return str(self.client.post("/v1/keys", json={"label": "k"}).json()["id"])

    def upload(self, data: bytes, name: str = "m.ply") -> str:
        """A complete upload."""
        slot = self.client.post("/v1/uploads", json={"name": name, "size": len(data)}).json()["id"]
        answer = self.client.put(f"/v1/uploads/{slot}", content=data)
        assert answer.status_code == 200, answer.text
        return str(slot)


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """One data folder for the session; small limits, so that they can be met."""
    made = Service.open(
        Settings(
            data_dir=tmp_path_factory.mktemp("data"),
            max_upload_bytes=32 << 20,
            max_form_bytes=8 << 20,
            max_body_bytes=64 << 10,
            inspect_seconds=30.0,
        )
    )
    ensure_key(made.db, made.master)
    yield made
    made.close()


def _api(service: Service, tenant: str, scopes: list[str]) -> Api:
    token = issue(service.db, service.master, tenant, scopes)
    client = TestClient(make_app(service), headers={"Authorization": f"Bearer {token}"}, raise_server_exceptions=False)
    return Api(client, service)


@pytest.fixture
def api(service: Service, request: pytest.FixtureRequest) -> Api:
    """An administrator of a tenant of this test's own."""
    return _api(service, f"tenant of {request.node.name}"[:100], ["admin"])


@pytest.fixture
def stranger(service: Service) -> Api:
    """An administrator of another tenant."""
    return _api(service, "stranger", ["admin"])


@pytest.fixture
def reader(service: Service, request: pytest.FixtureRequest) -> Api:
    """Who may read only, of the same tenant as `api`."""
    return _api(service, f"tenant of {request.node.name}"[:100], ["read"])


@pytest.fixture
def set_up(api: Api, monkeypatch: pytest.MonkeyPatch) -> SetUp:
    """Serve `api` under other settings."""

    def under(**settings: Any) -> None:
        plain = api.service.settings.model_dump() | {"master_key": None} | settings
        monkeypatch.setattr(api.client.app.state, "service", replace(api.service, settings=Settings(**plain)))  # type: ignore[attr-defined]

    return under
