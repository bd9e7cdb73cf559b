"""The main job through the running service: mark, download, steal, check; and what may go wrong on the way."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import httpx
import pytest

from engine.formats import encode_model, read_model
from engine.records.signatures import DISPUTE, verify
from service.client import Client, Embedded, ServiceError
from tests.scenes import sparse_plant
from tests.service import serving
from tests.service.flow.commands import client_of, mark3dgs
from tests.service.serving import ROOT, Served

SCENE = encode_model(read_model(ROOT / "tests" / "data" / "train_1000.ply").model, "splat")


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One service for all tests here; the budget of near duplicates is small, and one test spends it."""
    made = serving.start(
        tmp_path_factory.mktemp("served"),
        lean=True,
        SUBJECT_VERIFIES_PER_DAY="5",
        WORKER_SILENCE_SECONDS="4",
        WATCH_MINUTES="0",
    )
    yield made
    made.stop()


@pytest.fixture(scope="module")
def marked(alice: Client) -> Embedded:
    """Alice's asset."""
    return alice.embed(SCENE, profile="fast", copy_name="acme", label="Potted plant")


@pytest.fixture(scope="module")
def model(alice: Client, marked: Embedded, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The marked model."""
    return alice.download(marked.asset_id, tmp_path_factory.mktemp("marked") / "model").read_bytes()


def test_marked_and_registered(
    alice: Client, raw: httpx.Client, marked: Embedded, model: bytes, tmp_path: Path
) -> None:
    asset = alice.asset(marked.asset_id)
    assert (asset.copy_name, asset.label, asset.model_format) == ("acme", "Potted plant", "splat")
    assert marked.psnr_worst_view >= 47.0
    assert marked.psnr_total_worst_view == marked.psnr_worst_view, "nothing was pruned"
    preview = raw.get(f"/v1/assets/{marked.asset_id}/preview.png").content
    assert preview.startswith(b"\x89PNG")
    whole = raw.get(f"/v1/assets/{marked.asset_id}/model")
    assert whole.content == model
    part = raw.get(f"/v1/assets/{marked.asset_id}/model", headers={"Range": "bytes=100-199"})
    assert (part.status_code, part.content) == (206, whole.content[100:200])
    assert part.headers["content-range"] == f"bytes 100-199/{len(whole.content)}"
    assert part.headers["etag"] == whole.headers["etag"]
    original = alice.download(marked.asset_id, tmp_path / "original", version="original")
    assert original.read_bytes() == SCENE


@pytest.mark.parametrize("kind", ["ply", "compressed.ply", "spz", "sog"])
def test_in_other_formats(raw: httpx.Client, marked: Embedded, kind: str) -> None:
    """Made once, the same bytes ever after."""
    address = f"/v1/assets/{marked.asset_id}/model"
    first, again = (raw.get(address, params={"format": kind}) for _ in range(2))
    assert first.status_code == 200, first.text
    assert first.content == again.content
    assert f".{kind}" in first.headers["content-disposition"]


def test_a_copy_is_claimed_and_the_claim_checked_offline(
    served: Served, alice: Client, marked: Embedded, model: bytes, tmp_path: Path
) -> None:
    stages = list[str]()
    acquired = alice.acquire(model)
    found = alice.verify(model, acquisition_id=acquired.id, progress=lambda stage, share: stages.append(stage))
    assert (found.verdict, found.asset_id) == ("marked", marked.asset_id)
    assert found.log10_false_claim < -100
    assert (stages[0], stages[-1]) == ("upload", "commit")
    claim = alice.claim(found.claim_id)
    assert claim.document["copy"] == "acme"
    assert claim.document["message"]["hex"] == marked.message
    assert claim.document["audit"]["registration"]["entry"]["at"] < claim.document["created_at"]
    assert claim.document["acquisition"]["warc_sha256"] == acquired.warc_sha256
    assert {each.id: each.copy_name for each in alice.claims()}[found.claim_id] == "acme"
    alice.jws(found.claim_id, tmp_path / "claim.jws")
    alice.report(found.claim_id, tmp_path / "report.html")
    annex = alice.annex(found.claim_id, tmp_path / "annex.html").read_text(encoding="utf-8")
    assert f"Annex to claim {found.claim_id}" in annex
    assert claim.document["tool"]["version"] in annex
    (tmp_path / "claim.json").write_text(json.dumps(asdict(claim)))
    (tmp_path / "jwks.json").write_text(json.dumps(alice.call("GET", "/.well-known/jwks.json")))
    for name in ("claim.jws", "claim.json", "report.html"):
        done = mark3dgs(served, "verify-report", str(tmp_path / name), "--jwks", str(tmp_path / "jwks.json"))
        assert done.returncode == 0, done.stdout + done.stderr
        assert "acquisition" in done.stdout.splitlines()[-1], "no third party says when the suspect was there"
    forged = (tmp_path / "claim.json").read_text().replace(marked.message, "ffffffff")
    (tmp_path / "forged.json").write_text(forged)
    done = mark3dgs(served, "verify-report", str(tmp_path / "forged.json"), "--jwks", str(tmp_path / "jwks.json"))
    assert done.returncode == 3, done.stdout


def test_the_record_proves_it_without_the_service(alice: Client, tmp_path: Path, served: Served) -> None:
    """What the service keeps is what the command line takes."""
    key = alice.call("POST", "/v1/keys", json={"reveal": True, "label": "second"})
    made = alice.embed(SCENE, profile="fast", key_id=key["id"], bits=16, format="spz")
    (tmp_path / "owner.key").write_text(key["key"])
    (tmp_path / "owner.key").chmod(0o600)
    (tmp_path / "jwks.json").write_text(json.dumps(alice.call("GET", "/.well-known/jwks.json")))
    alice.record(made.asset_id, tmp_path / "scene.record")
    alice.download(made.asset_id, tmp_path / "marked.spz")
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
    output = json.loads(done.stdout)
    assert (output["false_claim_rate"], output["rate_basis"]) == (2.0**-128, "undated")
    assert output["attested"]["by"].startswith("the log of the service")


def test_a_stranger_who_marks_it_again_learns_nothing_and_its_owner_is_told(
    served: Served, alice: Client, bob: Client, marked: Embedded, model: bytes
) -> None:
    """What bob sees of alice's marked model is what he sees of an unmarked one."""
    answers = [bob.wait(bob.submit_embed(data, profile="fast").id) for data in (model, SCENE)]
    assert [answer.state for answer in answers] == ["succeeded", "succeeded"]
    output = [dict(answer.outcome()) for answer in answers]
    fixed = [{name: answer[name] for name in ("already_carries", "not_screened", "review")} for answer in output]
    assert fixed[0] == fixed[1]
    assert output[0].keys() == output[1].keys()
    said = json.dumps([bob.call("GET", f"/v1/jobs/{answer.id}") for answer in answers])
    assert not any(secret in said for secret in ("alice", "acme", marked.asset_id, marked.record_id))
    assert bob.notices() == []
    until = time.monotonic() + 60
    while not (notices := alice.notices(asset=marked.asset_id)):
        assert time.monotonic() < until, served.log()
        time.sleep(0.1)
    assert [notice.uploaded_as for notice in notices] == [output[0]["asset_id"]]
    assert notices[0].strength > 128


@pytest.fixture(scope="module")
def again(alice: Client, model: bytes) -> Embedded:
    """Alice's marked model, marked once more."""
    return alice.embed(model, profile="fast", key_id=alice.call("POST", "/v1/keys", json={})["id"])


def test_its_owner_can(marked: Embedded, again: Embedded) -> None:
    assert marked.asset_id in again.already_carries


def test_a_dispute_is_settled_and_signed(
    alice: Client, bob: Client, raw: httpx.Client, marked: Embedded, again: Embedded
) -> None:
    """Two assets of hers, the second made from the first one's marked model: the first came first."""
    assert again.asset_id != marked.asset_id
    body = {"asset_a": again.asset_id, "asset_b": marked.asset_id}
    with pytest.raises(ServiceError, match="not-found"):
        bob.call("POST", "/v1/disputes", json=body)
    result = alice.wait(alice.call("POST", "/v1/disputes", json=body)["id"]).outcome()
    assert result["first"] == "b"
    address = f"/v1/disputes/{result['dispute_id']}"
    settled = alice.call("GET", address)
    assert settled["headline"] == "Party B came first"
    assert any(reason.startswith("Re-marking") for reason in settled["reasons"])
    payload, _ = verify(settled["jws"], alice.call("GET", "/.well-known/jwks.json"), DISPUTE)
    assert json.loads(payload) == settled["document"]
    assert settled["document"]["assets"] == {"a": again.asset_id, "b": marked.asset_id}
    dates = settled["document"]["finding"]["dates"]
    assert dates["b"]["attested"] < dates["a"]["attested"]
    assert "Party B came first" in raw.get(f"{address}/report").text
    for path in (address, f"{address}/report"):
        with pytest.raises(ServiceError, match="not-found"):
            bob.call("GET", path)


def test_a_tenant_without_assets(served: Served) -> None:
    with pytest.raises(ServiceError, match="conflict: no asset is registered") as caught:
        client_of(served, "carol").verify(SCENE)
    assert caught.value.status == 409


def test_an_erased_owner_key(served: Served, tmp_path: Path) -> None:
    """Erasing is refused while assets need the key, unless it is meant; then nothing can be checked, and says so."""
    dave = client_of(served, "dave")
    key = dave.call("POST", "/v1/keys", json={"reveal": True})
    asset = dave.embed(SCENE, profile="fast", key_id=key["id"]).asset_id
    model = dave.download(asset, tmp_path / "model")
    with pytest.raises(ServiceError, match="conflict: 1 assets"):
        dave.call("DELETE", f"/v1/keys/{key['id']}")
    assert dave.call("DELETE", f"/v1/keys/{key['id']}", params={"force": "true"}) is None
    with pytest.raises(ServiceError, match=r"conflict: .* erased"):
        dave.verify(model)
    back = dave.call("POST", "/v1/keys", json={"key": key["key"].splitlines()[-1]})
    assert back["id"] == key["id"]
    assert dave.verify(model, asset_id=asset).verdict == "marked"


def test_cancelling_kills_the_process(served: Served, alice: Client, owner_key: str) -> None:
    job = alice.submit_embed(sparse_plant(every=15), key_id=owner_key, profile="strong")
    until = time.monotonic() + 60
    while alice.job(job.id).stage not in ("look", "quantize", "landmarks"):
        assert time.monotonic() < until
        time.sleep(0.05)
    began = time.monotonic()
    alice.cancel(job.id)
    assert alice.wait(job.id).state == "cancelled"
    assert time.monotonic() - began < 6.0
    left = [path for path in (served.folder / "data" / "scratch").rglob("*") if path.is_file()]
    assert left == []


def test_a_killed_worker_loses_nothing(served: Served, alice: Client, owner_key: str) -> None:
    job = alice.submit_embed(sparse_plant(every=15), key_id=owner_key, profile="balanced", copy_name="survivor")
    while alice.job(job.id).state == "queued":
        time.sleep(0.05)
    for worker in served.workers():
        os.kill(worker, signal.SIGKILL)
    assert alice.wait(job.id).state == "succeeded"
    names = [asset.copy_name for asset in alice.assets()]
    assert names.count("survivor") == 1


def test_a_later_copy_costs_a_part(alice: Client, owner_key: str) -> None:
    """The killed worker's model again, for another buyer, who gets the first one's settings."""
    ended = alice.embed(sparse_plant(every=15), key_id=owner_key, copy_name="second")
    assert "those of the earlier copy ('survivor')" in alice.asset(ended.asset_id).report["notes"][0]
    first = next(asset for asset in alice.assets() if asset.copy_name == "survivor")
    made, taken = (alice.asset(name).report["seconds_by_stage"]["landmarks"] for name in (first.id, ended.asset_id))
    assert taken < 0.3 * made


def test_what_is_not_marked_is_not_claimed(alice: Client, raw: httpx.Client) -> None:
    """A negative answer is an answer: 200, and a signed claim. The original derives from the asset, unmarked.

    Of the thousand Gaussians of the other tests, some keys leave too little evidence to exclude the mark.
    """
    asset = next(asset for asset in alice.assets() if asset.copy_name == "second")
    form = {"asset_id": asset.id}
    answer = raw.post("/v1/verify", data=form, files={"model": sparse_plant(every=15)}, headers={"Prefer": "wait=60"})
    assert answer.status_code == 200
    assert answer.json()["result"]["verdict"] == "not_marked"
    document = alice.claim(answer.json()["result"]["claim_id"]).document
    checks = {check["code"]: check["ok"] for check in document["checks"]}
    assert (checks["derived"], checks["mark"]) == (True, False)
    assert document["derived_but_unmarked"] is True


def test_a_model_too_small_for_its_message(raw: httpx.Client, owner_key: str) -> None:
    small = (ROOT / "tests" / "data" / "train_1000.ply").read_bytes()
    answer = raw.post(
        "/v1/embed", data={"key_id": owner_key, "bits": "256"}, files={"model": small}, headers={"Prefer": "wait=60"}
    )
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:mark3dgs:problem:capacity")
    assert answer.json()["wanted"] == 256


def test_near_duplicates_share_a_budget(alice: Client, marked: Embedded, model: bytes) -> None:
    """Whoever asks about slight changes of one model again and again learns how to remove its mark."""
    changed = bytearray(model)

    def ask_again_and_again() -> None:
        for number in range(6):
            changed[24] = number  # one byte of one colour
            alice.verify(bytes(changed), asset_id=marked.asset_id)

    with pytest.raises(ServiceError) as caught:
        ask_again_and_again()
    assert caught.value.status == 429
    assert caught.value.retry_after
    changed[24] += 1
    ended = alice.wait(alice.submit_verify(bytes(changed)).id)
    assert ended.state == "failed"
    with pytest.raises(ServiceError, match="budget-exceeded"):
        ended.outcome()


def test_the_log_holds_and_tells_what_was_altered(served: Served, marked: Embedded) -> None:
    import sqlite3

    assert mark3dgs(served, "audit", "verify").returncode == 0
    database = sqlite3.connect(served.folder / "data" / "mark3dgs.sqlite", timeout=30)
    with database:
        database.execute("UPDATE assets SET registered_at = '2020-01-01' WHERE id = ?", (marked.asset_id,))
    done = mark3dgs(served, "audit", "verify")
    assert done.returncode == 3
    assert marked.asset_id in done.stdout
