"""A backup of a running service, taken in the middle of a job, becomes the same service elsewhere."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from service.client import Claim, Client, Embedded, ServiceError
from tests.scenes import sparse_plant
from tests.service import serving
from tests.service.flow.commands import mark3dgs, token_of
from tests.service.flow.test_main_job import SCENE
from tests.service.serving import ROOT, Served

pytestmark = pytest.mark.long


@dataclass(frozen=True)
class Before:
    """What the first service had when the backup was taken."""

    token: str
    marked: Embedded
    model: bytes
    record: bytes
    claim_id: str
    claim: Claim
    jws: bytes
    running: str  # id of the job that was at work
    started_upload: str
    backup: Path


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> Before:
    folder = tmp_path_factory.mktemp("first")
    served = serving.start(folder, lean=True)
    try:
        return _lived(served, folder)
    finally:
        served.stop()


def _lived(served: Served, folder: Path) -> Before:
    token = token_of(served, "alice")
    client = Client(served.address, token)
    owner = str(client.call("POST", "/v1/keys", json={})["id"])
    marked = client.embed(SCENE, key_id=owner, profile="fast", copy_name="acme")
    model = client.download(marked.asset_id, folder / "model").read_bytes()
    claim_id = client.verify(model).claim_id
    claim = client.claim(claim_id)
    client.jws(claim_id, folder / "claim.jws")
    client.record(marked.asset_id, folder / "record")
    upload = str(client.call("POST", "/v1/uploads", json={"size": 1000})["id"])
    running = client.submit_embed(sparse_plant(), key_id=owner, profile="strong", copy_name="globex").id
    until = time.monotonic() + 60
    while client.job(running).stage not in ("look", "quantize", "landmarks"):
        assert time.monotonic() < until
        time.sleep(0.02)
    done = mark3dgs(served, "backup", str(folder / "backup"), "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["audit"]["ok"]
    assert client.wait(running).state == "succeeded", "the service went on"
    record, jws = (folder / "record").read_bytes(), (folder / "claim.jws").read_bytes()
    return Before(token, marked, model, record, claim_id, claim, jws, running, upload, folder / "backup")


@pytest.fixture(scope="module")
def restored(before: Before, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("second")
    environment = {**os.environ, "MARK3DGS_DATA_DIR": str(folder / "data")}
    command = [sys.executable, "-m", "service.cli", "restore", str(before.backup)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    served = serving.start(folder, api_key=before.token, lean=True)
    yield served
    served.stop()


@pytest.fixture
def alice(restored: Served, before: Before) -> Client:
    return Client(restored.address, before.token)


def test_asset_record_claim_and_log_are_there(restored: Served, alice: Client, before: Before, tmp_path: Path) -> None:
    assert alice.asset(before.marked.asset_id).copy_name == "acme"
    assert alice.download(before.marked.asset_id, tmp_path / "model").read_bytes() == before.model
    alice.record(before.marked.asset_id, tmp_path / "record")
    assert (tmp_path / "record").read_bytes() == before.record
    assert alice.claim(before.claim_id).document == before.claim.document
    alice.jws(before.claim_id, tmp_path / "claim.jws")
    assert (tmp_path / "claim.jws").read_bytes() == before.jws
    done = mark3dgs(restored, "audit", "verify")
    assert done.returncode == 0, done.stdout


def test_a_marked_model_is_claimed(alice: Client, before: Before) -> None:
    """The owner keys are there, and what the log says of the registration."""
    found = alice.verify(before.model)
    assert (found.verdict, found.asset_id) == ("marked", before.marked.asset_id)
    assert alice.claim(found.claim_id).document["attested"]["at"] == alice.asset(found.asset_id).registered_at


def test_the_job_at_work_goes_on(alice: Client, before: Before) -> None:
    ended = alice.wait(before.running)
    assert ended.state == "succeeded", ended.problem
    assert [asset.copy_name for asset in alice.assets()].count("globex") == 1


def test_an_upload_under_way_starts_again(alice: Client, before: Before) -> None:
    with pytest.raises(ServiceError, match="not-found"):
        alice.call("GET", f"/v1/uploads/{before.started_upload}")
