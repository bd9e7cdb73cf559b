"""Delivered models with Content Credentials, and the way back from a mark to its manifest."""

from __future__ import annotations

import asyncio
import io
import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from engine.cli.app import run
from engine.credentials.manifest import ALG, binding_value, embedded_manifest, model_type
from engine.credentials.native import parse
from engine.errors import InputError
from engine.formats import encode_model, read_model
from service.app import make_app
from service.assets.content_credentials import delivered, signer_of
from service.core import Service
from service.db.schema import assets, manifests
from service.settings import Settings
from service.trust.audit_check import verify_log
from service.uploads.retention import sweep
from tests.service.api.conftest import SMALL, Api, _api
from tests.service.api.test_deleting import age
from tests.service.rows import add_asset, put

TENANT, RECORD = "tenant of credentials", "3871513a0d27461d362f21a8244218b9"
VALUE = binding_value(RECORD)


def trial(folder: Path, name: str) -> dict[str, str]:
    """Settings of a signer made by the command."""
    folder.mkdir()
    files = {each: str(folder / f"{each}.pem") for each in ("certificates", "private-key", "authority")}
    assert run(["credentials", "trial", name, *(part for key in files for part in (f"--{key}", files[key]))]) == 0
    return {"credentials_certificates": files["certificates"], "credentials_key": files["private-key"]}


@pytest.fixture
def signing(tmp_path: Path) -> Iterator[Service]:
    """A service whose operator signs, with one asset."""
    service = Service.open(Settings(data_dir=tmp_path / "data", **trial(tmp_path / "acme", "Acme")))  # type: ignore[arg-type]
    model = encode_model(read_model(SMALL).model, "sog")
    row = {"tenant": TENANT, "record_id": RECORD, "model_format": "sog", "original_format": "ply"}
    row |= {f"{name}_sha256": put(service.blobs, name.encode()) for name in ("record", "preview", "sketch")}
    row |= {"model_sha256": put(service.blobs, model), "original_sha256": put(service.blobs, SMALL.read_bytes())}
    add_asset(service.db, commit=True, **row)
    yield service
    service.close()


def owner(service: Service) -> Api:
    return _api(service, TENANT, ["admin"])


def anybody(service: Service) -> TestClient:
    """Without a key."""
    return TestClient(make_app(service), raise_server_exceptions=False)


def found(service: Service, value: str = VALUE, alg: str = ALG) -> list[str]:
    """Manifests that anybody finds for a mark."""
    answer = anybody(service).get("/v1/matches/byBinding", params={"alg": alg, "value": value})
    assert answer.status_code == 200, answer.text
    return [each["manifestId"] for each in answer.json()["matches"]]


def test_a_sog_comes_signed_and_its_mark_leads_back(signing: Service, tmp_path: Path) -> None:
    client = owner(signing).client
    assert found(signing) == [], "before it went out there is nothing to find"
    answer = client.get("/v1/assets/as_1/model")
    assert answer.status_code == 200, answer.text
    path = tmp_path / "published.sog"
    path.write_bytes(answer.content)
    stored = signing.blobs.read(signing.db.engine.connect().execute(assets.select()).one().model_sha256)
    before, after = read_model(io.BytesIO(stored).getvalue()).model, read_model(path).model
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        assert getattr(before, name).tobytes() == getattr(after, name).tobytes()
    store = embedded_manifest(answer.content, "x")
    assert store is not None
    (name,) = found(signing)
    fetched = anybody(signing).get(f"/v1/manifests/{name}")
    assert (fetched.status_code, fetched.headers["content-type"]) == (200, "application/c2pa")
    assert fetched.content == store
    assert answer.headers["link"] == f'</v1/manifests/{name}>; rel="c2pa-manifest"'
    output = parse(path, model_type("sog"), store)
    assert (output["state"], output["signer"], output["bindings"]) == ("Valid", "Acme", [[ALG, VALUE]])
    again = client.get("/v1/assets/as_1/model", headers={"If-None-Match": answer.headers["etag"]})
    assert again.status_code == 304, "signed once"
    assert found(signing) == [name]


def test_a_glb_stays_as_it_is_and_its_manifest_lies_beside(signing: Service, tmp_path: Path) -> None:
    client = owner(signing).client
    signed = client.get("/v1/assets/as_1/model", params={"format": "glb"})
    bare = Settings(data_dir=signing.settings.data_dir)
    without = TestClient(make_app(replace(signing, settings=bare)), headers=client.headers)
    plain = without.get("/v1/assets/as_1/model", params={"format": "glb"})
    assert signed.content == plain.content
    assert "link" not in plain.headers
    path = tmp_path / "published.glb"
    path.write_bytes(signed.content)
    address = signed.headers["link"].split(">")[0].removeprefix("<")
    store = anybody(signing).get(address).content
    assert parse(path, "model/gltf-binary", store)["state"] == "Valid"
    path.write_bytes(signed.content[:-1] + b"\7")
    assert parse(path, "model/gltf-binary", store)["state"] == "Invalid"


def test_what_is_never_signed(signing: Service) -> None:
    client = owner(signing).client
    for query in ({"format": "splat"}, {"version": "original"}, {"version": "original", "format": "glb"}):
        answer = client.get("/v1/assets/as_1/model", params=query)
        assert answer.status_code == 200, answer.text
        assert "link" not in answer.headers, query
    assert found(signing) == []


def test_who_asks_for_nothing_of_ours_finds_nothing(signing: Service) -> None:
    owner(signing).client.get("/v1/assets/as_1/model")
    assert len(found(signing)) == 1
    for value, alg in ((VALUE, "com.adobe.trustmark.P"), (binding_value("00" * 16), ALG), ("%", ALG), ("", ALG)):
        assert found(signing, value, alg) == []
    assert anybody(signing).get("/v1/manifests/urn:c2pa:nothing").status_code == 404
    assert anybody(signing).get("/v1/matches/byBinding", params={"alg": ALG}).status_code == 422
    known = anybody(signing).get("/v1/services/supportedAlgorithms").json()
    assert known == {"watermarks": [{"alg": ALG}]}


def test_another_certificate_signs_anew_and_the_old_manifest_stays(signing: Service, tmp_path: Path) -> None:
    first = owner(signing).client.get("/v1/assets/as_1/model")
    later = signing.settings.model_copy(update=trial(tmp_path / "next", "Next"))
    renewed = replace(signing, settings=later)
    second = owner(renewed).client.get("/v1/assets/as_1/model")
    assert first.headers["etag"] != second.headers["etag"]
    names = found(renewed)
    assert len(names) == 2
    assert [
        f"</v1/manifests/{name}>" in answer.headers["link"] for name, answer in zip(names, (second, first), strict=True)
    ] == [True, True]


def test_deleting_takes_the_manifest_along(signing: Service) -> None:
    client = owner(signing).client
    client.get("/v1/assets/as_1/model")
    (name,) = found(signing)
    age(signing)
    sweep(signing)
    assert anybody(signing).get(f"/v1/manifests/{name}").status_code == 200, "what is named stays"
    assert client.get("/v1/assets/as_1/model").status_code == 200
    assert client.delete("/v1/assets/as_1").status_code == 204
    assert found(signing) == []
    assert anybody(signing).get(f"/v1/manifests/{name}").status_code == 404
    age(signing)
    assert sweep(signing)[1] == 7, "all files of the asset, the signed one and the manifest"


def test_what_is_signed_while_the_asset_goes_is_not_found(signing: Service) -> None:
    with signing.db.read() as connection:
        row = connection.execute(assets.select()).one()
    assert owner(signing).client.delete("/v1/assets/as_1").status_code == 204
    assert asyncio.run(delivered(signing, row, row.model_sha256, "sog")).headers == {}
    with signing.db.write() as connection:
        assert connection.execute(manifests.select()).first() is None
        orphan = {column.name: "x" for column in manifests.columns} | {"id": "urn:c2pa:x", "binding": RECORD}
        connection.execute(manifests.insert().values(orphan))  # as if the power had failed between two steps
    assert found(signing) == []
    assert anybody(signing).get("/v1/manifests/urn:c2pa:x").status_code == 404


def test_the_audit_hashes_manifests(signing: Service) -> None:
    owner(signing).client.get("/v1/assets/as_1/model")
    assert verify_log(signing.db, signing.blobs).ok
    (name,) = found(signing)
    digest = next(
        path
        for path in (signing.blobs.folder or SMALL).rglob("*")
        if path.is_file() and b"c2pa" in path.read_bytes()[:64]
    )
    digest.write_bytes(b"x")
    report = verify_log(signing.db, signing.blobs)
    assert f"the manifest {name} of as_1" in report.text()


@pytest.mark.parametrize("fault", ["gone", "expired", "no key"])
def test_an_owner_gets_the_own_model_whatever_the_certificate(
    fault: str, signing: Service, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain = Path(signing.settings.credentials_certificates)
    if fault == "gone":
        chain.unlink()
    elif fault == "expired":
        from datetime import UTC, datetime, timedelta

        class Later(datetime):
            @classmethod
            def now(cls, tz: Any = None) -> datetime:
                return datetime.now(UTC) + timedelta(days=91)

        monkeypatch.setattr("engine.credentials.signer.datetime", Later)
    service = (
        replace(signing, settings=signing.settings.model_copy(update={"credentials_key": ""}))
        if fault == "no key"
        else signing
    )
    with caplog.at_level(logging.ERROR):
        answer = owner(service).client.get("/v1/assets/as_1/model")
    assert answer.status_code == 200
    assert "link" not in answer.headers
    assert embedded_manifest(answer.content, "x") is None
    assert "no Content Credentials for as_1" in caplog.text
    with pytest.raises(InputError):  # and `serve` does not start with it
        signer_of(service.settings)


def test_two_who_ask_at_once_get_the_same_file(signing: Service) -> None:
    """Also from processes that know nothing of one another."""
    from concurrent.futures import ThreadPoolExecutor

    clients = [owner(replace(signing, making={})).client for _ in range(3)]
    with ThreadPoolExecutor(3) as threads:
        answers = list(threads.map(lambda client: client.get("/v1/assets/as_1/model"), clients))
    assert len({answer.headers["etag"] for answer in answers}) == 1
    assert len(found(signing)) == 1
