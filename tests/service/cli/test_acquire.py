"""`mark3dgs acquire`: what it writes, and what it refuses."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from engine.errors import InputError
from engine.records.timestamps import check_stamp
from service.cli.acquire import acquire
from service.problems import Problem
from tests.records.test_timestamps import Authority, serving
from tests.service.acquisitions.conftest import answer, sites  # noqa: F401
from tests.service.acquisitions.test_fetching import Sites, warc_records

Capsys = pytest.CaptureFixture[str]


def acquired(capsys: Capsys, source: str, out: Path, **options: Any) -> dict[str, Any]:
    given = {"save": None, "seconds": 5.0, "max_bytes": 1000, "tsa": None, "private": True} | options
    assert acquire(source, out, **given, json=True) == 0
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    return report


def test_an_address(sites: Sites, tmp_path: Path, capsys: Capsys) -> None:  # noqa: F811
    authority, site, out = Authority(tmp_path), sites(answer(b"ply")), tmp_path / "a.warc.gz"
    with serving(authority.reply) as tsa:
        report = acquired(capsys, site.url("/x.ply"), out, save=tmp_path / "x.ply", tsa=tsa)
    assert (tmp_path / "x.ply").read_bytes() == b"ply"
    assert report["payload_sha256"] == hashlib.sha256(b"ply").hexdigest()
    assert report["warc_sha256"] == hashlib.sha256(out.read_bytes()).hexdigest()
    assert warc_records(out.read_bytes())[1][0]["WARC-Target-URI"] == site.url("/x.ply")
    check_stamp((tmp_path / "a.warc.gz.tsr").read_bytes(), out.read_bytes(), authority.roots)


def test_a_file(tmp_path: Path, capsys: Capsys) -> None:
    (tmp_path / "x.ply").write_bytes(b"ply")
    report = acquired(capsys, str(tmp_path / "x.ply"), tmp_path / "a.warc.gz")
    assert (report["url"], report["bytes"]) == (None, 3)
    assert warc_records((tmp_path / "a.warc.gz").read_bytes())[1][1] == b"ply"


def test_nothing_is_written_of_what_is_refused(sites: Sites, tmp_path: Path, capsys: Capsys) -> None:  # noqa: F811
    site, out = sites(answer(bytes(1001))), tmp_path / "a.warc.gz"
    with pytest.raises(Problem, match="not public"):
        acquired(capsys, site.url(), out, private=False)
    with pytest.raises(Problem, match="more bytes"):
        acquired(capsys, site.url(), out)
    with pytest.raises(InputError, match="no-such"):
        acquired(capsys, str(tmp_path / "no-such.ply"), out)
    assert list(tmp_path.iterdir()) == []


def test_evidence_is_not_replaced_and_a_missing_stamp_is_said(tmp_path: Path, capsys: Capsys) -> None:
    (tmp_path / "saved.ply").write_bytes(b"ply")
    source, out = str(tmp_path / "saved.ply"), tmp_path / "a.warc.gz"
    with serving(lambda _: b"", status=503) as tsa, pytest.raises(InputError, match=r"a\.warc\.gz is written without"):
        acquired(capsys, source, out, tsa=tsa)
    before = out.read_bytes()
    with pytest.raises(InputError, match="exists"):
        acquired(capsys, source, out)
    assert out.read_bytes() == before
