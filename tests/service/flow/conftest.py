"""Who asks the service that a module has `served`."""

from __future__ import annotations

import httpx
import pytest

from service.client import Client
from tests.service.flow.commands import client_of, token_of
from tests.service.serving import Served


@pytest.fixture(scope="module")
def token(served: Served) -> str:
    """Alice's API key."""
    return token_of(served, "alice")


@pytest.fixture(scope="module")
def alice(served: Served, token: str) -> Client:
    return Client(served.address, token)


@pytest.fixture(scope="module")
def raw(served: Served, token: str) -> httpx.Client:
    """Alice, as she sees what goes over the line."""
    return httpx.Client(base_url=served.address, headers={"Authorization": f"Bearer {token}"}, timeout=120)


@pytest.fixture(scope="module")
def bob(served: Served) -> Client:
    return client_of(served, "bob")


@pytest.fixture(scope="module")
def owner_key(alice: Client) -> str:
    """Alice has it, whichever test comes first."""
    return str(alice.call("POST", "/v1/keys", json={})["id"])
