"""The main job through the running service: mark, download, steal, check; and what may go wrong on the way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from engine.formats import encode_model, read_model
from engine.records.signatures import DISPUTE, verify
from tests.scenes import sparse_plant
from tests.service import serving
from tests.service.serving import ROOT, Served

SCENE = encode_model(read_model(ROOT / "tests" / "data" / "train_1000.ply").model, "splat")
FINAL = {"succeeded", "disputed", "failed", "cancelled"}


def mark3dgs(served: Served, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A command beside the running service."""
    environment = {**os.environ, "MARK3DGS_DATA_DIR": str(served.folder / "data")}
    command = [sys.executable, "-m", "service.cli", *arguments]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


class Client(httpx.Client):
    """A tenant's client."""

    def wait(self, job: dict[str, Any]) -> dict[str, Any]:
        """The job once it has ended."""
        until = time.monotonic() + 120
        while time.monotonic() < until:
            found: dict[str, Any] = self.get(f"/v1/jobs/{job['id']}").json()
            if found["state"] in FINAL:
                return found
            time.sleep(0.05)
        raise AssertionError(f"not ended: {found}")

    def embed(self, data: bytes, **form: str) -> dict[str, Any]:
        """An embed job, ended."""
        return self.wait(self.post("/v1/embed", data={"profile": "fast", **form}, files={"model": data}).json())

    def verify(self, data: bytes, field: str = "model", **form: str) -> dict[str, Any]:
        """A verify job, ended."""
        return self.wait(self.post("/v1/verify", data=form, files={field: data}).json())


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One service for all tests here; the budget of near duplicates is small, and one test spends it."""
    made = serving.start(tmp_path_factory.mktemp("served"), SUBJECT_VERIFIES_PER_DAY="8", WORKER_SILENCE_SECONDS="4")
    yield made
    made.stop()


def client_of(served: Served, tenant: str) -> Client:
    done = mark3dgs(served, "apikey", "create", "--tenant", tenant, "--scopes", "admin", "--json")
    token = json.loads(done.stdout)["api_key"]
    return Client(base_url=served.address, headers={"Authorization": f"Bearer {token}"}, timeout=120)


@pytest.fixture(scope="module")
def alice(served: Served) -> Client:
    return client_of(served, "alice")


@pytest.fixture(scope="module")
def bob(served: Served) -> Client:
    return client_of(served, "bob")


@pytest.fixture(scope="module")
def owner_key(alice: Client) -> str:
    """Alice has it, whichever test comes first."""
    return str(alice.post("/v1/keys", json={}).json()["id"])


@pytest.fixture(scope="module")
def marked(alice: Client) -> dict[str, Any]:
    """Alice's asset, with the marked model."""
    job = alice.embed(SCENE, copy_name="acme", label="Potted plant")
    assert job["state"] == "succeeded", job
    asset = job["result"]["asset_id"]
    return {**job["result"], "model": alice.get(f"/v1/assets/{asset}/model").content}


def test_marked_and_registered(alice: Client, marked: dict[str, Any]) -> None:
    asset = alice.get(f"/v1/assets/{marked['asset_id']}").json()
    assert (asset["copy_name"], asset["label"], asset["model_format"]) == ("acme", "Potted plant", "splat")
    assert marked["psnr_worst_view"] >= 47.0
    preview = alice.get(f"/v1/assets/{marked['asset_id']}/preview.png").content
    assert preview.startswith(b"\x89PNG")
    whole = alice.get(f"/v1/assets/{marked['asset_id']}/model")
    part = alice.get(f"/v1/assets/{marked['asset_id']}/model", headers={"Range": "bytes=100-199"})
    assert (part.status_code, part.content) == (206, whole.content[100:200])
    assert part.headers["content-range"] == f"bytes 100-199/{len(whole.content)}"
    assert part.headers["etag"] == whole.headers["etag"]
    original = alice.get(f"/v1/assets/{marked['asset_id']}/model", params={"version": "original"})
    assert original.content == SCENE


@pytest.mark.parametrize("kind", ["ply", "compressed.ply", "spz", "sog"])
def test_in_other_formats(alice: Client, marked: dict[str, Any], kind: str) -> None:
    """Made once, the same bytes ever after."""
    address = f"/v1/assets/{marked['asset_id']}/model"
    first, again = (alice.get(address, params={"format": kind}) for _ in range(2))
    assert first.status_code == 200, first.text
    assert first.content == again.content
    assert f".{kind}" in first.headers["content-disposition"]


def test_a_copy_is_claimed_and_the_claim_checked_offline(
    served: Served, alice: Client, marked: dict[str, Any], tmp_path: Path
) -> None:
    job = alice.verify(marked["model"])
    assert job["result"]["verdict"] == "marked"
    assert job["result"]["log10_false_claim"] < -100
    claim = alice.get(f"/v1/claims/{job['result']['claim_id']}").json()
    document = claim["document"]
    assert document["copy"] == "acme"
    assert document["message"]["hex"] == marked["message"]
    assert document["audit"]["registration"]["entry"]["at"] < document["created_at"]
    for name, content in (
        ("claim.jws", alice.get(f"/v1/claims/{document['claim_id']}.jws").content),
        ("claim.json", json.dumps(claim).encode()),
        ("report.html", alice.get(f"/v1/claims/{document['claim_id']}/report").content),
        ("jwks.json", alice.get("/.well-known/jwks.json").content),
    ):
        (tmp_path / name).write_bytes(content)
    for name in ("claim.jws", "claim.json", "report.html"):
        done = mark3dgs(served, "verify-report", str(tmp_path / name), "--jwks", str(tmp_path / "jwks.json"))
        assert done.returncode == 0, done.stdout + done.stderr
    forged = (tmp_path / "claim.json").read_text().replace(marked["message"], "ffffffff")
    (tmp_path / "forged.json").write_text(forged)
    done = mark3dgs(served, "verify-report", str(tmp_path / "forged.json"), "--jwks", str(tmp_path / "jwks.json"))
    assert done.returncode == 3, done.stdout


def test_the_record_proves_it_without_the_service(alice: Client, tmp_path: Path, served: Served) -> None:
    """What the service keeps is what the command line takes."""
    key = alice.post("/v1/keys", json={"reveal": True, "label": "second"}).json()
    job = alice.embed(SCENE, key_id=key["id"], bits="16", format="spz")
    (tmp_path / "owner.key").write_text(key["key"])
    (tmp_path / "owner.key").chmod(0o600)
    (tmp_path / "jwks.json").write_bytes(alice.get("/.well-known/jwks.json").content)
    for name, part in (("scene.record", "record"), ("marked.spz", "model")):
        (tmp_path / name).write_bytes(alice.get(f"/v1/assets/{job['result']['asset_id']}/{part}").content)
    done = mark3dgs(
        served,
        "verify",
        str(tmp_path / "marked.spz"),
        "--record",
        str(tmp_path / "scene.record"),
        "--key",
        str(tmp_path / "owner.key"),
        "--jwks",
        str(tmp_path / "jwks.json"),
        "--json",
    )
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads(done.stdout)
    assert (told["false_claim_rate"], told["rate_basis"]) == (1e-9, "drawn")
    assert told["attested"]["by"].startswith("the log of the service")


def test_what_is_not_marked_is_not_claimed(alice: Client, marked: dict[str, Any]) -> None:
    """A negative answer is an answer: 200, and a signed claim. The original derives from the asset, unmarked."""
    form = {"asset_id": marked["asset_id"]}
    answer = alice.post("/v1/verify", data=form, files={"model": SCENE}, headers={"Prefer": "wait=60"})
    assert answer.status_code == 200
    assert answer.json()["result"]["verdict"] == "not_marked"
    document = alice.get(f"/v1/claims/{answer.json()['result']['claim_id']}").json()["document"]
    checks = {check["code"]: check["ok"] for check in document["checks"]}
    assert (checks["derived"], checks["mark"]) == (True, False)
    assert document["derived_but_unmarked"] is True


def test_a_stranger_cannot_mark_it_again(bob: Client, marked: dict[str, Any]) -> None:
    """The classic deadlock of two owners: the later one is told, and learns nothing of the earlier."""
    job = bob.embed(marked["model"])
    assert job["state"] == "disputed"
    said = json.dumps(job)
    assert not any(secret in said for secret in ("alice", "acme", marked["asset_id"], marked["record_id"]))
    assert bob.get("/v1/assets").json()["items"] == []


@pytest.fixture(scope="module")
def again(alice: Client, marked: dict[str, Any]) -> dict[str, Any]:
    """Alice's marked model, marked once more."""
    key = alice.post("/v1/keys", json={}).json()["id"]
    job = alice.embed(marked["model"], key_id=key)
    assert job["state"] == "succeeded"
    return dict(job["result"])


def test_its_owner_can(marked: dict[str, Any], again: dict[str, Any]) -> None:
    assert marked["asset_id"] in again["already_carries"]


def test_a_dispute_is_settled_and_signed(
    alice: Client, bob: Client, marked: dict[str, Any], again: dict[str, Any]
) -> None:
    """Two assets of hers, the second made from the first one's marked model: the first came first."""
    newest = again["asset_id"]
    assert newest != marked["asset_id"]
    asked = {"asset_a": newest, "asset_b": marked["asset_id"]}
    assert bob.post("/v1/disputes", json=asked).status_code == 404
    job = alice.wait(alice.post("/v1/disputes", json=asked).json())
    assert job["state"] == "succeeded", job
    assert job["result"]["first"] == "b"
    address = f"/v1/disputes/{job['result']['dispute_id']}"
    settled = alice.get(address).json()
    assert settled["headline"] == "Party B came first"
    assert any(reason.startswith("Re-marking") for reason in settled["reasons"])
    payload, _ = verify(settled["jws"], alice.get("/.well-known/jwks.json").json(), DISPUTE)
    assert json.loads(payload) == settled["document"]
    assert settled["document"]["assets"] == {"a": newest, "b": marked["asset_id"]}
    dates = settled["document"]["finding"]["dates"]
    assert dates["b"]["attested"] < dates["a"]["attested"]
    assert "Party B came first" in alice.get(f"{address}/report").text
    for path in (address, f"{address}/report"):
        assert bob.get(path).status_code == 404


def test_a_tenant_without_assets(served: Served) -> None:
    answer = client_of(served, "carol").verify(SCENE)
    assert answer["state"] == "failed"
    assert answer["problem"]["status"] == 409


def test_an_erased_owner_key(served: Served) -> None:
    """Erasing is refused while assets need the key, unless it is meant; then nothing can be checked, and says so."""
    dave = client_of(served, "dave")
    key = dave.post("/v1/keys", json={"reveal": True}).json()
    job = dave.embed(SCENE, key_id=key["id"])
    asset = job["result"]["asset_id"]
    model = dave.get(f"/v1/assets/{asset}/model").content
    assert dave.delete(f"/v1/keys/{key['id']}").status_code == 409
    assert dave.delete(f"/v1/keys/{key['id']}", params={"force": True}).status_code == 204
    gone = dave.verify(model)
    assert (gone["state"], gone["problem"]["status"]) == ("failed", 409)
    assert "erased" in gone["problem"]["detail"]
    back = dave.post("/v1/keys", json={"key": key["key"].splitlines()[-1]}).json()
    assert back["id"] == key["id"]
    assert dave.verify(model, asset_id=asset)["result"]["verdict"] == "marked"


def test_cancelling_kills_the_process(served: Served, alice: Client, owner_key: str) -> None:
    form = {"key_id": owner_key, "profile": "strong"}
    job = alice.post("/v1/embed", data=form, files={"model": sparse_plant()}).json()
    until = time.monotonic() + 60
    while alice.get(f"/v1/jobs/{job['id']}").json()["stage"] not in ("look", "quantize", "landmarks"):
        assert time.monotonic() < until
        time.sleep(0.05)
    began = time.monotonic()
    alice.delete(f"/v1/jobs/{job['id']}")
    ended = alice.wait(job)
    assert ended["state"] == "cancelled"
    assert time.monotonic() - began < 3.0
    left = [path for path in (served.folder / "data" / "scratch").rglob("*") if path.is_file()]
    assert left == []


def test_a_killed_worker_loses_nothing(served: Served, alice: Client, owner_key: str) -> None:
    form = {"key_id": owner_key, "profile": "fast", "copy_name": "survivor"}
    job = alice.post("/v1/embed", data=form, files={"model": sparse_plant()}).json()
    while alice.get(f"/v1/jobs/{job['id']}").json()["state"] == "queued":
        time.sleep(0.05)
    for worker in served.workers():
        os.kill(worker, signal.SIGKILL)
    assert alice.wait(job)["state"] == "succeeded"
    names = [asset["copy_name"] for asset in alice.get("/v1/assets").json()["items"]]
    assert names.count("survivor") == 1


def test_a_model_too_small_for_its_message(alice: Client, owner_key: str) -> None:
    small = (ROOT / "tests" / "data" / "train_1000.ply").read_bytes()
    answer = alice.post(
        "/v1/embed", data={"key_id": owner_key, "bits": "256"}, files={"model": small}, headers={"Prefer": "wait=60"}
    )
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:mark3dgs:problem:capacity")
    assert answer.json()["wanted"] == 256


def test_near_duplicates_share_a_budget(alice: Client, marked: dict[str, Any]) -> None:
    """Whoever asks about slight changes of one model again and again learns how to remove its mark."""
    model = bytearray(marked["model"])
    states = []
    for number in range(9):
        model[24] = number  # one byte of one colour
        job = alice.verify(bytes(model))
        states.append(job["state"])
        if job["state"] == "failed":
            assert job["problem"]["type"] == "urn:mark3dgs:problem:budget-exceeded"
            break
    assert states[-1] == "failed"
    named = alice.post("/v1/verify", data={"asset_id": marked["asset_id"]}, files={"model": bytes(model)})
    assert named.status_code == 429


def test_the_log_holds_and_tells_what_was_altered(served: Served, marked: dict[str, Any]) -> None:
    import sqlite3

    assert mark3dgs(served, "audit", "verify").returncode == 0
    database = sqlite3.connect(served.folder / "data" / "mark3dgs.sqlite", timeout=30)
    with database:
        database.execute("UPDATE assets SET registered_at = '2020-01-01' WHERE id = ?", (marked["asset_id"],))
    done = mark3dgs(served, "audit", "verify")
    assert done.returncode == 3
    assert marked["asset_id"] in done.stdout
