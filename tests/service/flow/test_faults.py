"""Full disk, dead database, slow clients: clear errors, nothing lost, and the service goes on."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.scenes import sparse_plant
from tests.service import serving
from tests.service.conftest import running_postgres
from tests.service.flow.commands import Line
from tests.service.postgres import Postgres
from tests.service.serving import ROOT, Served

SMALL = ROOT / "tests" / "data" / "train_1000.ply"


def admin(served: Served) -> Line:
    return Line(base_url=served.address, headers=served.headers, timeout=120)


postgres = pytest.fixture(name="postgres")(running_postgres)


@pytest.mark.long
def test_on_postgres_with_an_outage_in_mid_job(postgres: Postgres, tmp_path: Path) -> None:
    """The same code on the other database. While it is away: 503 for what needs it, and the job goes on after it."""
    served = serving.start(tmp_path, DATABASE_URL=postgres.new_database("mark"), WORKER_SILENCE_SECONDS="5")
    try:
        with admin(served) as client:
            job = client.post("/v1/embed", data={"profile": "fast"}, files={"model": sparse_plant()}).json()
            until = time.monotonic() + 60
            while client.get(f"/v1/jobs/{job['id']}").json()["stage"] not in ("look", "quantize", "landmarks"):
                assert time.monotonic() < until
                time.sleep(0.05)
            postgres.stop()
            answer = client.get("/v1/assets")
            assert (answer.status_code, answer.json()["type"]) == (503, "urn:mark3dgs:problem:unavailable")
            assert "retry-after" in answer.headers
            assert client.get("/readyz").json()["database"] is False
            assert client.get("/healthz").status_code == 200
            time.sleep(3)
            postgres.start()
            ended = client.wait(job)
            assert ended["state"] == "succeeded", ended
            model = client.get(f"/v1/assets/{ended['result']['asset_id']}/model").content
            assert client.verify(model)["result"]["verdict"] == "marked"
    finally:
        served.stop()


def test_a_full_disk(tmp_path: Path) -> None:
    """On a file system of 24 MB: the upload that does not fit is refused, the next smaller one is not."""
    data = tmp_path / "data"
    data.mkdir()
    mounted = (
        os.geteuid() == 0
        and subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(data)], capture_output=True, check=False
        ).returncode
        == 0
    )
    if not mounted:
        pytest.skip("a small file system cannot be mounted by this user")
    try:
        served = serving.start(tmp_path, workers=0)
        try:
            with admin(served) as client:
                sized = client.post("/v1/uploads", json={"size": 100 << 20})
                assert (sized.status_code, sized.json()["type"]) == (507, "urn:mark3dgs:problem:storage-full")
                slot = client.post("/v1/uploads", json={}).json()["id"]
                answer = client.put(f"/v1/uploads/{slot}", content=bytes(40 << 20))
                assert (answer.status_code, answer.json()["type"]) == (507, "urn:mark3dgs:problem:storage-full")
                assert list((data / "scratch").rglob("*")) == []
                slot = client.post("/v1/uploads", json={}).json()["id"]
                assert client.put(f"/v1/uploads/{slot}", content=SMALL.read_bytes()).status_code == 200
        finally:
            served.stop()
    finally:
        subprocess.run(["umount", "-l", str(data)], check=False)


def test_slow_clients_hold_up_nobody(tmp_path: Path) -> None:
    """Fifty connections that send a byte now and then; another that stops in the middle keeps what it has sent."""
    served = serving.start(tmp_path, workers=0)
    host, port = served.address.removeprefix("http://").split(":")
    slow: list[socket.socket] = []
    try:
        with admin(served) as client:
            slots = [client.post("/v1/uploads", json={"size": 1000}).json()["id"] for _ in range(50)]
            for slot in slots:
                connection = socket.create_connection((host, int(port)))
                head = f"PUT /v1/uploads/{slot} HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n"
                head += f"Authorization: Bearer {served.api_key}\r\n\r\n"
                connection.sendall(head.encode() + b"x" * 400)
                slow.append(connection)
            times = []
            for _ in range(40):
                began = time.perf_counter()
                assert client.get("/v1/assets").status_code == 200
                times.append(time.perf_counter() - began)
            assert sorted(times)[20] < 0.25
            for connection in slow:
                connection.close()
            assert _eventually(lambda: client.get(f"/v1/uploads/{slots[0]}").json()["offset"]) == 400
    finally:
        served.stop()


def _eventually(value: Any) -> Any:
    until = time.monotonic() + 10
    while not (found := value()) and time.monotonic() < until:
        time.sleep(0.1)
    return found


def test_a_second_service_on_the_port_says_so(tmp_path: Path) -> None:
    served = serving.start(tmp_path, workers=0)
    try:
        port = served.address.rsplit(":", 1)[1]
        done = subprocess.run(
            [sys.executable, "-m", "service.cli", "serve", "--port", port, "--workers", "0"],
            cwd=ROOT,
            env={**os.environ, "MARK3DGS_DATA_DIR": str(tmp_path / "other")},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == 2
        assert port in done.stderr
        assert "Traceback" not in done.stderr
        assert httpx.get(f"{served.address}/healthz").status_code == 200
    finally:
        served.stop()
