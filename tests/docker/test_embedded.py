"""compose.yaml as a user starts it: marks and finds, keeps to its cage, and survives being killed."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docker.conftest import EMBEDDED, another
from tests.docker.images import run
from tests.docker.stack import Client, Stack, kill, running, wait_for

MOST_BYTES = 1_500_000_000
SMALL_MEMORY = "450m"
"""The service at rest takes about 300 MB, an embed of the plant about 1 GB."""


@pytest.fixture(scope="module")
def stack(image: str) -> Iterator[Stack]:
    with running(Stack("mark3dgs-test", [EMBEDDED], {})) as stack:
        yield stack


@pytest.fixture(scope="module")
def client(stack: Stack) -> Iterator[Client]:
    with stack.client(stack.token("mark3dgs")) as client:
        yield client


@pytest.fixture(scope="module")
def key(client: Client) -> str:
    answer = client.post("/v1/keys", json={"label": "docker"})
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


@pytest.fixture(scope="module")
def container(stack: Stack) -> str:
    (found,) = stack.containers("mark3dgs")
    return found


@pytest.fixture(scope="module")
def asset(client: Client, key: str, plant: bytes) -> str:
    """The plant, marked."""
    job = client.end(client.start("embed", plant, key_id=key, profile="fast", copy_name="first"))
    assert job["state"] == "succeeded", job
    return str(job["result"]["asset_id"])


def test_the_image_is_small(image: str) -> None:
    assert int(run("docker", "image", "inspect", "--format", "{{.Size}}", image)) <= MOST_BYTES


def test_any_user_may_run_a_command_on_its_own_files(image: str, plant: bytes, tmp_path: Path) -> None:
    tmp_path.chmod(0o777)
    (tmp_path / "plant.splat").write_bytes(plant)
    mine = ("--user", "12345:12345", "--volume", f"{tmp_path}:/mine", "--workdir", "/mine")
    run("docker", "run", "--rm", *mine, image, "convert", "plant.splat", "plant.ply")
    made = tmp_path / "plant.ply"
    assert (made.stat().st_uid, made.read_bytes()[:4]) == (12345, b"ply\n")


def test_the_container_has_no_rights(container: str) -> None:
    status = run("docker", "exec", container, "cat", "/proc/self/status")
    fields = dict(line.split(":\t", 1) for line in status.splitlines())
    assert fields["Uid"].split() == ["10001"] * 4
    assert int(fields["CapBnd"], 16) == 0
    assert fields["NoNewPrivs"] == "1"


def test_only_the_volume_can_be_written(container: str) -> None:
    script = "import sys; open(sys.argv[1] + '/new', 'w').close()"
    for folder in ("/", "/opt/mark3dgs", "/usr/local/bin", "/etc"):
        with pytest.raises(RuntimeError, match=r"Read-only|Permission denied"):
            run("docker", "exec", container, "python", "-c", script, folder)
    for folder in ("/data/scratch", "/tmp"):
        run("docker", "exec", container, "python", "-c", script, folder)
    run("docker", "exec", container, "rm", "/data/scratch/new", "/tmp/new")


def test_the_port_is_published_on_the_loopback_only(stack: Stack, container: str) -> None:
    ports = stack.inspect(container)["NetworkSettings"]["Ports"]
    assert ports == {"8000/tcp": [{"HostIp": "127.0.0.1", "HostPort": str(stack.port)}]}


def test_a_mark_made_is_found_and_an_unmarked_model_is_not(
    client: Client, asset: str, plant: bytes, tmp_path: Path
) -> None:
    marked = client.get(f"/v1/assets/{asset}/model").content
    keys = tmp_path / "jwks.json"
    keys.write_bytes(client.get("/.well-known/jwks.json").content)
    for suspect, verdict in ((marked, "marked"), (plant, "not_marked")):
        job = client.end(client.start("verify", suspect, asset_id=asset))
        assert job["state"] == "succeeded", job
        claim = client.get(f"/v1/claims/{job['result']['claim_id']}").json()
        assert claim["document"]["verdict"] == verdict
        signed = tmp_path / f"{verdict}.jws"
        signed.write_text(claim["jws"])
        run(sys.executable, "-m", "service.cli", "verify-report", signed, "--jwks", keys)


def test_kernels_come_from_the_image(client: Client, container: str, asset: str, plant: bytes) -> None:
    marked = client.get(f"/v1/assets/{asset}/model").content
    client.end(client.start("verify", marked, asset_id=asset))
    compiled = run("docker", "exec", container, "find", "/data/numba", "-name", "*.kernel").splitlines()
    shipped = run("docker", "exec", container, "find", "/opt/mark3dgs/numba", "-name", "*.kernel").splitlines()
    assert shipped
    assert len(compiled) == len(shipped)


def test_a_worker_killed_in_mid_job(stack: Stack, client: Client, container: str, key: str, plant: bytes) -> None:
    job = client.start("embed", another(plant, 1), key_id=key, copy_name="worker killed")
    client.middle(job)
    worker = stack.process(container, "service.cli worker")
    kill(worker)
    assert client.end(job)["state"] == "succeeded"
    assert stack.process(container, "service.cli worker") != worker
    _is_registered_once(client, job)


def test_the_container_killed_in_mid_job(stack: Stack, client: Client, container: str, key: str, plant: bytes) -> None:
    job = client.start("embed", another(plant, 2), key_id=key, copy_name="container killed")
    client.middle(job)
    before = stack.inspect(container)
    kill(before["State"]["Pid"])
    assert client.end(job)["state"] == "succeeded"
    after = stack.inspect(container)
    assert after["RestartCount"] == before["RestartCount"] + 1
    _is_registered_once(client, job)


def test_work_that_outgrows_the_memory_fails_alone(
    stack: Stack, client: Client, container: str, key: str, plant: bytes
) -> None:
    before = stack.inspect(container)
    limit = str(before["HostConfig"]["Memory"])
    run("docker", "update", f"--memory={SMALL_MEMORY}", f"--memory-swap={SMALL_MEMORY}", container)
    try:
        job = client.end(client.start("embed", another(plant, 3), key_id=key, copy_name="out of memory"))
        assert job["state"] == "failed"
        assert job["problem"]["type"].endswith(":engine-limit"), job
        assert client.get("/healthz").status_code == 200
    finally:
        run("docker", "update", f"--memory={limit}", f"--memory-swap={limit}", container)
    after = stack.inspect(container)
    assert (after["State"]["StartedAt"], after["RestartCount"]) == (
        before["State"]["StartedAt"],
        before["RestartCount"],
    )
    job = client.end(client.start("embed", plant, key_id=key, profile="fast", copy_name="enough memory"))
    assert job["state"] == "succeeded", job


def test_the_volume_outlives_the_container(stack: Stack, client: Client, asset: str, tmp_path: Path) -> None:
    before = client.get(f"/v1/assets/{asset}/model").content
    started = time.monotonic()
    stack.compose("down")
    assert time.monotonic() - started < 20, "it does not stop when asked to"
    stack.up()
    assert client.get(f"/v1/assets/{asset}/model").content == before
    assert "mk_" not in stack.compose("logs")  # the key was shown once
    wait_for(lambda: client.get("/readyz").status_code == 200, 30, "a worker")


def _is_registered_once(client: Client, job: str) -> None:
    """The job's copy is in the registry, and no second one of it."""
    copy = client.get(f"/v1/assets/{client.job(job)['result']['asset_id']}").json()["copy_name"]
    items = client.get("/v1/assets", params={"limit": 100}).json()["items"]
    assert [item["copy_name"] for item in items].count(copy) == 1
