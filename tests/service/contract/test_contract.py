"""Schemathesis against the running service: every answer is one that the description announces."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.service import serving
from tests.service.serving import Served

HERE = Path(__file__).parent
SMALL = HERE.parents[1] / "data" / "train_1000.ply"
EXAMPLES = os.environ.get("MARK3DGS_CONTRACT_EXAMPLES", "10")

ENDLESS = "/v1/jobs/{job_id}/events"
"""A stream of events, which ends with its job."""
ANSWERS = "not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance"
LETTERS = {"all": ("utf-8", "all"), "surrogates": ("raw-unicode-escape", ANSWERS)}
"""Codec of the letters that are tried, which all include NUL, and the checks: no schema can refuse half of a pair."""


@pytest.fixture(params=["sqlite", "postgres"])
def served(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Served]:
    """A service with an asset and a claim in it; after the first acquisition it asks no address for anything."""
    url = request.getfixturevalue("postgres").new_database(tmp_path.name[-60:]) if request.param == "postgres" else ""
    budgets = {"EMBEDS_PER_HOUR": "1000000", "VERIFIES_PER_HOUR": "1000000", "ACQUISITIONS_PER_HOUR": "1"}
    made = serving.start(tmp_path, DATABASE_URL=url, **budgets)
    yield made
    made.stop()


def filled(served: Served) -> dict[str, str]:
    """Ids of an asset and of a claim on it."""
    with httpx.Client(base_url=served.address, headers={**served.headers, "Prefer": "wait=60"}, timeout=120) as client:
        key = client.post("/v1/keys", json={}).json()["id"]
        form = {"key_id": key, "profile": "fast"}
        asset = client.post("/v1/embed", data=form, files={"model": SMALL.read_bytes()}).json()["result"]["asset_id"]
        body = {"asset_id": asset}
        claim = client.post("/v1/verify", data=body, files={"model": SMALL.read_bytes()}).json()["result"]["claim_id"]
        hook = client.post("/v1/webhooks", json={"url": "https://hooks.example/"}).json()["id"]
        upload = client.get("/v1/uploads").json()["items"][0]["id"]
        acquired = client.post("/v1/acquisitions", json={"upload_id": upload}).json()["id"]
        share = client.post(f"/v1/claims/{claim}/share", json={}).json()
    shared = {"share_id": share["id"], "token": share["url"].rpartition("/")[2]}
    shared["acquisition_id"] = acquired
    return {"asset_id": asset, "claim_id": claim, "webhook_id": hook, **shared}


@pytest.mark.long
@pytest.mark.timeout(660)
@pytest.mark.parametrize("letters", LETTERS)
def test_all_checks(served: Served, tmp_path: Path, letters: str) -> None:
    codec, checks = LETTERS[letters]
    ids = filled(served)
    # Made once, slowly on a busy machine.
    paths = httpx.get(f"{served.address}/openapi.json", timeout=120).raise_for_status().json()["paths"]
    config = tmp_path / "schemathesis.toml"
    known = "\n".join(f'"path.{name}" = "{value}"' for name, value in ids.items())
    config.write_text(f"[parameters]\n{known}\n\n" + (HERE / "schemathesis.toml").read_text())
    command = [
        str(Path(sys.executable).with_name("schemathesis")),
        "--config-file",
        str(config),
        "run",
        f"{served.address}/openapi.json",
        "-H",
        f"Authorization: Bearer {served.api_key}",
        "--checks",
        checks,
        "--generation-codec",
        codec,
        "--max-examples",
        EXAMPLES,
        "--exclude-path",
        ENDLESS,
        "--request-timeout",
        "30",
        "--seed",
        "1",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=580)
    assert done.returncode == 0, done.stdout[-6000:] + served.log()[-3000:]
    assert f"Tested: {sum(map(len, paths.values())) - len(paths[ENDLESS])}\n" in done.stdout
