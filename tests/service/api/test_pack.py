"""GET /v1/claims/{id}/pack: the owner's words come in by the address, and go no further than into the ZIP."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from itertools import count
from typing import Any

import pytest

from service.claims.issuing import issue_claim
from service.core import Service
from service.db.schema import assets, claims
from service.trust.api_keys import check
from service.trust.commitments import commit_asset
from tests.service.api.conftest import Api
from tests.service.claims.cases import DRAWN, PICTURES, asset_row, nothing, reply, verify_job

NUMBERS = count()


def claim_of(service: Service, api: Api, number: int, found: dict[str, Any], names: Sequence[str] = ()) -> str:
    """A claim of this tenant, with its pictures."""
    tenant = check(service.db, service.master, api.client.headers["Authorization"].removeprefix("Bearer ")).tenant
    kept = {}
    for name, data in PICTURES.items():
        with service.blobs.new_file() as file:
            file.write_bytes(data)
            kept[name] = service.blobs.put(file)
    with service.db.write() as connection:
        row = asset_row(id=f"as_pack{number}", tenant=tenant, job=f"job_of_as_pack{number}")
        row |= {"label": f"label of {number}", "report": "{}"}
        connection.execute(assets.insert().values(row))
        commit_asset(connection, row, DRAWN)
        job = verify_job(f"job_pack{number}", tenant, names=names)
        issuer = {"name": "Marks Ltd", "address": "https://marks.example"}
        claim = issue_claim(connection, service.master, job, found | {"kept": kept}, issuer)
    return claim.id


@pytest.fixture
def address(service: Service, api: Api) -> str:
    """Of the pack of a new claim."""
    number = next(NUMBERS)
    return f"/v1/claims/{claim_of(service, api, number, reply(asset=f'as_pack{number}'))}/pack"


def test_a_pack_of_a_claim(api: Api, address: str) -> None:
    query = {"copy_url": ["https://a.example/1", "https://a.example/2"], "note": "Mine & mine"}
    first, again = (api.client.get(address, params=query) for _ in range(2))
    assert first.status_code == 200, first.text
    assert (first.headers["content-type"], first.headers["cache-control"]) == ("application/zip", "no-store")
    assert first.headers["content-disposition"].endswith('-pack.zip"')
    assert first.content == again.content
    with zipfile.ZipFile(io.BytesIO(first.content)) as archive:
        notice = next(archive.read(name).decode() for name in archive.namelist() if name.endswith("/notice.txt"))
    assert "Found at: https://a.example/2" in notice
    assert "| Mine & mine" in notice
    assert "https://marks.example/.well-known/jwks.json" in notice


def test_what_is_no_address_is_a_422(api: Api, address: str) -> None:
    for query in ({"copy_url": "javascript:alert(1)"}, {"note": "x" * 1001}, {"copyurl": "https://a.example"}):
        answer = api.client.get(address, params=query)
        assert answer.status_code == 422, query
        assert answer.json()["type"] == "urn:mark3dgs:problem:invalid-request"


def test_others_have_no_pack_and_a_deleted_claim_has_none(api: Api, stranger: Api, address: str) -> None:
    assert stranger.client.get(address).status_code == 404
    assert api.client.delete(address.removesuffix("/pack")).status_code == 204
    assert api.client.get(address).status_code == 404


def test_a_claim_that_recognised_nothing_is_a_409(service: Service, api: Api) -> None:
    name = claim_of(service, api, next(NUMBERS), nothing())
    assert api.client.get(f"/v1/claims/{name}/pack").status_code == 409
    with service.db.read() as connection:
        assert connection.execute(claims.select().where(claims.c.id == name)).one().asset is None


def test_the_longest_words_fit_the_servers_line(api: Api, address: str) -> None:
    """uvicorn's HTTP parser takes 16 kB."""
    urls = [("https://a.example/" + "x" * 400)[:400]] * 10
    answer = api.client.get(address, params={"copy_url": urls, "original_url": urls[0], "note": "\u6a21" * 1000})
    assert answer.status_code == 200, answer.text
    assert len(str(answer.request.url)) < 15_000
