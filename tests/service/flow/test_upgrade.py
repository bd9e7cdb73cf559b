"""The data folder of the first version (tests/data/README.md says how it came about), served by this one."""

from __future__ import annotations

import json
import tarfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.client import Client
from tests.service import serving
from tests.service.flow.commands import client_of, mark3dgs
from tests.service.flow.test_main_job import SCENE
from tests.service.serving import ROOT, Served

ARCHIVE = ROOT / "tests" / "data" / "first_version.tar.xz"


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("upgraded")
    with tarfile.open(ARCHIVE) as archive:
        if hasattr(tarfile, "data_filter"):
            archive.extractall(folder, filter="data")
        else:  # Python before 3.11.4; the archive is ours
            archive.extractall(folder)
    made = serving.start(folder, api_key=(folder / "api.key").read_text().strip(), lean=True, WATCH_MINUTES="0")
    yield made
    made.stop()


@pytest.fixture(scope="module")
def owner(served: Served) -> Client:
    """Whoever used the first version, with the API key of then."""
    return Client(served.address, served.api_key)


@pytest.fixture(scope="module")
def old(owner: Client) -> str:
    """The asset of then."""
    (asset,) = (each for each in owner.assets() if each.label == "Plant")
    return asset.id


@pytest.fixture(scope="module")
def model(owner: Client, old: str, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Its marked model."""
    return owner.download(old, tmp_path_factory.mktemp("old") / "model").read_bytes()


def test_asset_and_log_are_whole(served: Served, owner: Client, old: str) -> None:
    asset = owner.asset(old)
    assert (asset.copy_name, asset.model_format, len(asset.message)) == ("acme", "splat", 4)
    done = mark3dgs(served, "audit", "verify", "--json")
    output = json.loads(done.stdout)
    assert (done.returncode, output["faults"]) == (0, [])
    assert output["files"] >= 8, "originals, models, records, previews, sketches and pictures of the claim"


def test_the_claim_of_then_is_read_and_checked_offline(served: Served, owner: Client, old: str, tmp_path: Path) -> None:
    name = owner.claims()[-1].id
    claim = owner.claim(name)
    assert (claim.document["schema_version"], claim.document["verdict"]) == (1, "marked")
    assert claim.document["asset"] == old
    owner.jws(name, tmp_path / "claim.jws")
    owner.report(name, tmp_path / "report.html")
    (tmp_path / "jwks.json").write_text(json.dumps(owner.call("GET", "/.well-known/jwks.json")))
    for name in ("claim.jws", "report.html"):
        done = mark3dgs(served, "verify-report", str(tmp_path / name), "--jwks", str(tmp_path / "jwks.json"))
        assert done.returncode == 0, done.stdout + done.stderr


def test_a_model_marked_then_is_claimed(owner: Client, old: str, model: bytes) -> None:
    for found in (owner.verify(model), owner.verify(model, asset_id=old)):
        assert (found.verdict, found.asset_id) == ("marked", old)
    assert owner.claim(found.claim_id).document["message"]["matching"] == 16


def test_its_owner_is_told_when_a_stranger_marks_it_again(
    served: Served, owner: Client, old: str, model: bytes
) -> None:
    """Records and sketches of then take part in the screening."""
    made = client_of(served, "stranger").embed(model, profile="fast", bits=16)
    assert made.already_carries == []
    until = time.monotonic() + 60
    while not (notices := owner.notices()):
        assert time.monotonic() < until, served.log()
        time.sleep(0.1)
    assert [(notice.asset_id, notice.uploaded_as) for notice in notices] == [(old, made.asset_id)]


@pytest.mark.long
def test_new_marks_stand_beside_the_old(owner: Client, old: str, model: bytes, tmp_path: Path) -> None:
    key_id = owner.call("GET", "/v1/keys")["items"][0]["id"]
    original = owner.download(old, tmp_path / "original", version="original").read_bytes()
    other = owner.embed(SCENE, key_id=key_id, profile="fast")
    copy = owner.embed(original, key_id=key_id, profile="fast", bits=16, copy_name="globex")
    for asset in (other.asset_id, copy.asset_id):
        marked = owner.download(asset, tmp_path / asset).read_bytes()
        assert owner.verify(marked).asset_id == asset
    assert owner.verify(model).asset_id == old, "copies of one original are told apart"
