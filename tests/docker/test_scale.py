"""compose.scale.yaml: API, two workers, PostgreSQL and an S3 store; each may go away and come back.

No image of a real S3 store can be relied on here: its place is taken by a server of the test's own that speaks S3
over HTTP, so signatures and the store's own durability are not tested.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.docker.conftest import HERE, SCALE, another
from tests.docker.images import run
from tests.docker.stack import ROOT, Client, Stack, kill, running, wait_for


@pytest.fixture(scope="module")
def stack(image: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    secrets: Path = tmp_path_factory.mktemp("secrets")
    run(ROOT / "docker" / "secrets.sh", secrets)
    files = [SCALE, HERE / "compose.store.yaml"]
    with running(Stack("mark3dgs-test-scale", files, {"MARK3DGS_SECRETS": str(secrets)}), "--scale=worker=2") as stack:
        yield stack


@pytest.fixture(scope="module")
def client(stack: Stack) -> Iterator[Client]:
    with stack.client(stack.token("api")) as client:
        wait_for(lambda: client.get("/readyz").json()["workers"] == 2, 60, "both workers")
        yield client


@pytest.fixture(scope="module")
def key(client: Client) -> str:
    return str(client.post("/v1/keys", json={"label": "docker"}).json()["id"])


def test_what_one_worker_marked_another_finds(client: Client, stack: Stack, key: str, plant: bytes) -> None:
    jobs = [client.start("embed", plant, key_id=key, profile="fast", copy_name=name) for name in "ab"]
    assets = [_succeeded(client.end(job))["asset_id"] for job in jobs]
    for asset in assets:
        marked = client.get(f"/v1/assets/{asset}/model")
        assert marked.status_code == 200
        found = _succeeded(client.end(client.start("verify", marked.content, asset_id=asset)))
        assert found["verdict"] == "marked"


def test_the_secrets_are_in_no_configuration(stack: Stack) -> None:
    for service in ("api", "worker", "postgres"):
        for container in stack.containers(service):
            environment = "\n".join(stack.inspect(container)["Config"]["Env"])
            assert "postgresql://" not in environment
            assert "MASTER_KEY=" not in environment
            assert "PASSWORD=" not in environment


def test_a_worker_that_never_comes_back(client: Client, stack: Stack, key: str, plant: bytes) -> None:
    job = client.start("embed", another(plant, 1), key_id=key, copy_name="worker gone")
    client.middle(job)
    busy = _busy(stack, job)
    run("docker", "kill", busy)  # the restart policy takes that for the user's wish
    assert _succeeded(client.end(job))
    run("docker", "start", busy)
    wait_for(lambda: client.get("/readyz").json()["workers"] == 2, 60, "the worker's return")


def test_a_worker_killed_comes_back_by_itself(client: Client, stack: Stack, key: str, plant: bytes) -> None:
    job = client.start("embed", another(plant, 2), key_id=key, copy_name="worker killed")
    client.middle(job)
    busy = _busy(stack, job)
    kill(stack.inspect(busy)["State"]["Pid"])
    assert _succeeded(client.end(job))
    wait_for(lambda: stack.inspect(busy)["State"]["Running"], 30, "the restart")


def test_the_database_cut_off_in_mid_job(client: Client, stack: Stack, key: str, plant: bytes) -> None:
    (database,) = stack.containers("postgres")
    network = f"{stack.project}_backend"
    job = client.start("embed", another(plant, 3), key_id=key, copy_name="database cut")
    client.middle(job)
    run("docker", "network", "disconnect", network, database)
    try:
        ready = wait_for(lambda: (a := client.get("/readyz")).status_code == 503 and a, 60, "the outage")
        assert ready.json()["database"] is False
        answer = client.get(f"/v1/jobs/{job}")
        assert answer.status_code == 503
        assert answer.json()["type"].endswith(":unavailable")
        assert client.get("/healthz").status_code == 200
    finally:
        run("docker", "network", "connect", "--alias=postgres", network, database)
    assert _succeeded(client.end(job))


def test_the_database_killed_in_mid_job(client: Client, stack: Stack, key: str, plant: bytes) -> None:
    (database,) = stack.containers("postgres")
    job = client.start("embed", another(plant, 4), key_id=key, copy_name="database killed")
    client.middle(job)
    kill(stack.inspect(database)["State"]["Pid"])
    assert _succeeded(client.end(job))
    items = client.get("/v1/assets", params={"limit": 100}).json()["items"]
    names = [item["copy_name"] for item in items]
    assert len(names) == len(set(names)), "a job left two assets"


def _succeeded(job: dict[str, Any]) -> dict[str, Any]:
    assert job["state"] == "succeeded", job
    result: dict[str, Any] = job["result"]
    return result


def _busy(stack: Stack, job: str) -> str:
    """The container whose worker is at a job; a worker's name begins with its host's."""
    (database,) = stack.containers("postgres")
    question = f"SELECT worker FROM jobs WHERE id = '{job}'"
    name = run("docker", "exec", database, "psql", "--username=mark3dgs", "-tAc", question).strip()
    (busy,) = [found for found in stack.containers("worker") if found.startswith(name.split("-")[0])]
    return busy
