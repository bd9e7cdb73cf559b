"""C2PA's matches/byContent: a copy that lost its credentials finds its manifest, where the owner published that."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from engine.credentials.manifest import ALG, embedded_manifest
from engine.credentials.native import parse
from engine.formats import encode_model, read_model
from engine.formats.gltf.metadata import read_metadata
from service.app import make_app
from service.core import Service
from service.settings import Settings
from service.trust import audit
from tests.service.api.conftest import _api
from tests.service.api.test_credentials import trial
from tests.service.rows import add_asset, put
from tests.service.work.conftest import FOREIGN, Marked, shot_of

OWNER, ASSET, MODEL = "owner", "as_1", {"Content-Type": "model/vnd.unknown"}


@pytest.fixture
def service(marked: Marked, tmp_path: Path) -> Iterator[Service]:
    """A service that signs, with the marked plant of an owner."""
    settings: Any = {"data_dir": tmp_path / "data", "public_url": "https://mark.example", "matches_per_hour": 8}
    made = Service.open(Settings(**settings, **trial(tmp_path / "acme", "Acme")))
    row = {"id": ASSET, "tenant": OWNER, "record_id": marked.reply["record_id"], "model_format": "ply"}
    row |= {f"{name}_sha256": put(made.blobs, marked.path(name).read_bytes()) for name in ("model", "record", "sketch")}
    row |= {"original_format": "splat", "original_sha256": put(made.blobs, marked.original.read_bytes())}
    add_asset(made.db, commit=True, **row)
    yield made
    made.close()


@pytest.fixture
def signed(service: Service) -> bytes:
    """The plant as its owner fetched it, with a manifest in it."""
    answer = client(service).get(f"/v1/assets/{ASSET}/model", params={"format": "sog"})
    assert answer.status_code == 200, answer.text
    return answer.content


def client(service: Service, tenant: str = OWNER, scopes: tuple[str, ...] = ("admin",)) -> TestClient:
    return _api(service, tenant, list(scopes)).client


def publish(service: Service, **said: Any) -> None:
    answer = client(service).put(f"/v1/assets/{ASSET}/credentials", json=said)
    assert (answer.status_code, answer.json()) == (200, {"by_content": False, "rights": ""} | said)


def found(asker: TestClient, content: bytes, media: str = "model/vnd.unknown", **query: Any) -> list[dict[str, Any]]:
    answer = asker.post("/v1/matches/byContent", content=content, headers={"Content-Type": media}, params=query)
    assert answer.status_code == 200, answer.text
    return list(answer.json()["matches"])


@pytest.fixture(scope="module")
def cropped(marked: Marked) -> bytes:
    """60 % of the marked model, in another format, and with no credentials."""
    model = read_model(marked.path("model")).model
    data = encode_model(model.take(model.means[:, 0] <= np.quantile(model.means[:, 0], 0.6)), "spz")
    assert embedded_manifest(data, "x") is None
    return data


@pytest.fixture(scope="module")
def shot(marked: Marked, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A JPEG of the marked model from a camera of its own."""
    return shot_of(marked, tmp_path_factory.mktemp("shot")).read_bytes()


def test_a_stripped_model_and_a_picture_find_the_manifest(
    service: Service, signed: bytes, cropped: bytes, shot: bytes, tmp_path: Path
) -> None:
    publish(service, by_content=True)
    asker = client(service, "a platform", ("read",))
    (match,) = found(asker, cropped)
    assert match["similarityScore"] == 100
    store = TestClient(make_app(service)).get(f"/v1/manifests/{match['manifestId']}").content
    assert store == embedded_manifest(signed, "x")
    seen = found(asker, shot, "image/jpeg")
    assert [each["manifestId"] for each in seen] == [match["manifestId"]]
    assert found(asker, FOREIGN.read_bytes()) == []
    assert found(asker, cropped, alg="com.adobe.trustmark.P") == []
    assert client(service).get(f"/v1/assets/{ASSET}/model", params={"format": "glb"}).status_code == 200
    both = found(asker, cropped, alg=ALG)
    assert len(both) == 2
    assert found(asker, cropped, maxResults=1) == both[:1]
    assert not list((tmp_path / "data" / "scratch").iterdir()), "nothing of a question is kept"


@pytest.mark.usefixtures("signed")
def test_the_answer_says_nothing_of_the_mark(service: Service, marked: Marked) -> None:
    publish(service, by_content=True)
    asker = client(service, "a platform", ("read",))
    with_mark = found(asker, marked.path("model").read_bytes())
    assert len(with_mark) == 1
    assert found(asker, marked.original.read_bytes()) == with_mark


@pytest.mark.usefixtures("signed")
def test_only_what_its_owner_published_is_found(service: Service, cropped: bytes) -> None:
    asker, own = client(service, "a platform", ("read",)), client(service)
    assert own.get(f"/v1/assets/{ASSET}/credentials").json() == {"by_content": False, "rights": ""}
    assert found(asker, cropped) == []
    publish(service, rights="(c) Acme")
    assert found(asker, cropped) == []
    publish(service, by_content=True)
    assert len(found(asker, cropped)) == 1
    publish(service, by_content=False)
    assert found(asker, cropped) == []
    publish(service, by_content=True)
    with service.db.read() as connection:
        entry = audit.find(connection, "asset.published", ASSET)
    assert entry is not None
    assert entry.tenant == OWNER
    assert own.delete(f"/v1/assets/{ASSET}").status_code == 204
    assert found(asker, cropped) == []


def test_who_may_publish(service: Service) -> None:
    path, said = f"/v1/assets/{ASSET}/credentials", {"by_content": True}
    for tenant, scopes, status in ((OWNER, ("read",), 403), ("stranger", ("admin",), 404)):
        assert client(service, tenant, scopes).put(path, json=said).status_code == status
    assert client(service, "stranger").get(path).status_code == 404
    for wrong in ({"by_content": 1}, {"rights": "two\nlines"}, {"rights": "x" * 1001}, {"public": True}):
        assert client(service).put(path, json=wrong).status_code == 422, wrong
    assert client(service).get(path).json() == {"by_content": False, "rights": ""}


@pytest.mark.usefixtures("signed")
def test_budgets_end_with_429(service: Service, cropped: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    publish(service, by_content=True)
    few = replace(service, settings=service.settings.model_copy(update={"subject_verifies_per_day": 1}))
    asker = client(few, "curious", ("read",))
    assert len(found(asker, cropped)) == 1
    assert found(asker, FOREIGN.read_bytes()) == [], "what is like nothing counts for no asset"
    again = client(few, "curious", ("read",)).post("/v1/matches/byContent", content=cropped, headers=MODEL)
    assert again.status_code == 429, "another key of one tenant shares the budget of the original"
    assert len(found(client(few, "another", ("read",)), cropped)) == 1
    for _ in range(6):
        found(asker, b"x", alg="other")
    answer = asker.post("/v1/matches/byContent", content=cropped, headers=MODEL)
    assert (answer.status_code, int(answer.headers["Retry-After"]) > 0) == (429, True)


@pytest.mark.usefixtures("signed")
def test_what_is_neither_model_nor_picture(service: Service) -> None:
    publish(service, by_content=True)
    asker = client(service)
    for content, media, status in (
        (b"x" * 100, "model/gltf-binary", 422),
        (b"x" * 100, "", 422),  # as `curl -T` sends it
        (b"\x89PNG\r\n\x1a\n" + bytes(100), "image/png", 422),
        (b'{"frames": []}', "application/json", 415),
        (b"x", "video/mp4", 415),
        (b"x", "multipart/form-data; boundary=y", 415),
        (b"", "model/gltf-binary", 400),
    ):
        answer = asker.post("/v1/matches/byContent", content=content, headers={"Content-Type": media})
        assert answer.status_code == status, answer.text


def test_a_key_is_needed_and_the_switch_takes_all_away(service: Service, cropped: bytes) -> None:
    bare = TestClient(make_app(service), raise_server_exceptions=False)
    assert bare.post("/v1/matches/byContent", content=cropped, headers=MODEL).status_code == 401
    off = replace(service, settings=service.settings.model_copy(update={"routers": "shares"}))
    asker = client(off)
    assert asker.post("/v1/matches/byContent", content=cropped, headers=MODEL).status_code == 404
    assert asker.put(f"/v1/assets/{ASSET}/credentials", json={}).status_code == 404
    paths = make_app(off).openapi()["paths"]
    assert not any("matches" in path or path.endswith("/credentials") for path in paths)


def test_a_delivered_glb_names_its_manifest_and_the_rights(service: Service, tmp_path: Path) -> None:
    publish(service, rights="(c) 2026 Acme")
    fetch = lambda: client(service).get(f"/v1/assets/{ASSET}/model", params={"format": "glb"})  # noqa: E731
    first = fetch()
    address = first.headers["link"].split(">")[0].removeprefix("<")
    stated = read_metadata(first.content, file="x")
    assert stated is not None
    assert (stated.rights, stated.provenance) == ("(c) 2026 Acme", address)
    path = tmp_path / "published.glb"
    path.write_bytes(first.content)
    store = TestClient(make_app(service)).get(address.removeprefix("https://mark.example")).content
    read = parse(path, "model/gltf-binary", store)
    assert (read["state"], address.endswith(read["id"])) == ("Valid", True)
    assert fetch().content == first.content, "signed once"
    publish(service, rights="Public domain")
    other = fetch()
    later = read_metadata(other.content, file="x")
    assert later is not None
    assert (later.rights, later.provenance != stated.provenance) == ("Public domain", True)
    publish(service, rights="(c) 2026 Acme")
    assert fetch().content == first.content


@pytest.mark.parametrize("kind", ["usdc", "usdz"])
def test_a_model_is_fetched_as_openusd(service: Service, marked: Marked, kind: str) -> None:
    pytest.importorskip("pxr")
    answer = client(service).get(f"/v1/assets/{ASSET}/model", params={"format": kind})
    assert answer.status_code == 200, answer.text
    loaded = read_model(answer.content)
    assert loaded.format == kind
    np.testing.assert_array_equal(loaded.model.means, read_model(marked.path("model")).model.means)
