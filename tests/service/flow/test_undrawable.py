"""A model of a hundred thousand Gaussians that each cover the picture: refused soon, and no veil for a thief."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from engine.formats import encode_model, read_model
from service.client import Client, ServiceError
from tests.scenes import screened
from tests.service import serving
from tests.service.flow.test_main_job import SCENE
from tests.service.serving import Served

VEILS = 100_000


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    made = serving.start(tmp_path_factory.mktemp("undrawable"), lean=True)
    yield made
    made.stop()


def veiled(model: bytes, folder: Path) -> bytes:
    """The model, unseen behind veils."""
    (folder / "model.splat").write_bytes(model)
    return encode_model(screened(read_model(folder / "model.splat").model, VEILS), "splat")


def test_it_is_refused_and_says_why(alice: Client, owner_key: str, tmp_path: Path) -> None:
    with pytest.raises(ServiceError, match=r"\d+ million are allowed; .* of its 101,000 Gaussians") as caught:
        alice.embed(veiled(SCENE, tmp_path), key_id=owner_key, profile="fast")
    assert (caught.value.code, caught.value.status) == ("invalid-request", 422)


@pytest.mark.long
def test_a_stolen_model_behind_veils_is_claimed(
    alice: Client, raw: httpx.Client, owner_key: str, tmp_path: Path
) -> None:
    """Its Gaussians tell; only the suspect's own picture is left out."""
    made = alice.embed(SCENE, key_id=owner_key, profile="fast")
    model = alice.download(made.asset_id, tmp_path / "marked").read_bytes()
    found = alice.verify(veiled(model, tmp_path))
    assert (found.verdict, found.asset_id) == ("marked", made.asset_id)
    assert set(alice.claim(found.claim_id).document["pictures"]) == {"asset", "heatmap"}
    alice.report(found.claim_id, tmp_path / "report.html")
    pack = raw.get(f"/v1/claims/{found.claim_id}/pack").content
    assert f"{found.claim_id}/notice.txt" in zipfile.ZipFile(io.BytesIO(pack)).namelist()
