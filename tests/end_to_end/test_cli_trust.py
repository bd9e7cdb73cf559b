"""Whose word counts, on the command line: attested dates, two rates, disputes."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from engine.cli.app import run
from engine.watermark.statistics import CHANCE_RATE, DISHONEST_CLAIMANT_RATE
from tests.end_to_end.conftest import Marked
from tests.records.test_timestamps import Authority, serving

Capsys = pytest.CaptureFixture[str]


def test_without_an_attested_date_the_strict_rate_applies(marked: Marked, capsys: Capsys) -> None:
    code, claim = marked.verify(capsys, marked.model, "--false-claim-rate", "0.5")
    assert code == 0
    assert (claim["false_claim_rate"], claim["rate_basis"]) == (DISHONEST_CLAIMANT_RATE, "self_declared")
    assert claim["attested"] is None
    code, said = marked.ask(
        capsys, "verify", marked.model, *("--record", marked.record, "--key", marked.key, "--suspect-seen", "yesterday")
    )
    assert code == 2
    assert "no date" in said["error"]["message"]


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the time stamps")
def test_no_date_of_the_owners_own_changes_the_rate(marked: Marked, capsys: Capsys, tmp_path: Path) -> None:
    authority, record, query = Authority(tmp_path), tmp_path / "stamped.record", tmp_path / "query.tsq"
    shutil.copy(marked.record, record)
    code, report = marked.ask(capsys, "attest", record, "--query", query)
    assert (code, report["attestations"], report["added"]) == (0, 0, 0)
    (tmp_path / "reply.tsr").write_bytes(authority.reply(query.read_bytes()))
    trust = ("--tsa-certificates", tmp_path / "ca.pem")
    for added in (1, 0):
        code, report = marked.ask(capsys, "attest", record, "--attestation", tmp_path / "reply.tsr", *trust)
        assert (code, report["attestations"], report["added"]) == (0, 1, added)
        assert "Test stamps" in report["witnesses"][0]["by"]
    _, report = marked.ask(capsys, "attest", record, *trust, "--trusted-list", tmp_path / "ca.pem")
    assert "a plain time stamp" in report["witnesses"][0]["by"]
    assert record.stat().st_mode & 0o777 == 0o600
    tomorrow = (datetime.now(UTC) + timedelta(days=1)).date().isoformat()
    for options, basis, rate in (
        ((*trust, "--suspect-seen", tomorrow), "dated", DISHONEST_CLAIMANT_RATE),
        ((*trust, "--suspect-seen", "2020-01-01"), "younger", DISHONEST_CLAIMANT_RATE),
        (trust, "undated", DISHONEST_CLAIMANT_RATE),
        (("--suspect-seen", tomorrow), "self_declared", DISHONEST_CLAIMANT_RATE),
    ):
        code, claim = marked.ask(capsys, "verify", marked.model, "--record", record, "--key", marked.key, *options)
        assert (code, claim["rate_basis"], claim["false_claim_rate"]) == (0, basis, rate)
    assert "no certificate was given" in claim["notes"][-1]
    beside = ("--attestation", tmp_path / "reply.tsr", *trust, "--suspect-seen", tomorrow)
    assert marked.verify(capsys, marked.model, *beside)[1]["rate_basis"] == "dated"


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the time stamps")
def test_where_a_time_stamping_service_drew_a_claim_needs_less(marked: Marked, capsys: Capsys, tmp_path: Path) -> None:
    authority, model, record = Authority(tmp_path), tmp_path / "drawn.ply", tmp_path / "drawn.record"
    quick = ("--profile", "fast", "--set", "views=2", "--set", "view_size=128", "--set", "landmark_views=0")
    made = ("embed", marked.scene, model, "--key", marked.key, "--record", record, *quick, "--tsa")
    with serving(lambda _: b"", status=503) as url:
        code, said = marked.ask(capsys, *made, url)
    assert (code, model.exists(), record.exists()) == (2, False, False)
    assert "no time stamp" in said["error"]["message"]
    with serving(authority.reply) as url:
        assert run([*map(str, made), url]) == 0
    assert f"--earlier {record}" in " ".join(capsys.readouterr().out.split())
    again = (*made[:2], tmp_path / "later.ply", *made[3:6], tmp_path / "later.record", *made[7:-1], "--earlier", record)
    assert marked.ask(capsys, *again)[0] == 0, "no stamp is requested"
    assert (tmp_path / "later.ply").read_bytes() == model.read_bytes(), "another watermark"
    ask = ("verify", model, "--record", record, "--key", marked.key)
    for trust, basis, rate in (
        (("--tsa-certificates", tmp_path / "ca.pem"), "drawn", CHANCE_RATE),
        ((), "self_declared", DISHONEST_CLAIMANT_RATE),
    ):
        code, claim = marked.ask(capsys, *ask, *trust)
        assert (code, claim["rate_basis"], claim["false_claim_rate"]) == (0, basis, rate)


@pytest.mark.long
def test_the_thief_who_marks_again_and_dates_back_loses(marked: Marked, capsys: Capsys, tmp_path: Path) -> None:
    key, record, model, page = (tmp_path / name for name in ("his.key", "his.record", "his.ply", "dispute.html"))
    marked.ask(capsys, "keygen", key)
    made = ("embed", marked.model, model, "--key", key, "--record", record, "--profile", "fast")
    quick = ("--set", "views=3", "--set", "view_size=256", "--set", "landmark_views=0")
    assert marked.ask(capsys, *made, *quick, "--registered-at", "2001-01-01")[0] == 0
    ours = ("--record", marked.record, "--key", marked.key, "--model", marked.model)
    his = ("--record", record, "--key", key, "--model", model)
    code, found = marked.ask(capsys, "dispute", *his, *ours, "--report", page)
    assert (code, found["first"]) == (0, "b")
    assert ["re-marking", "a"] in found["seen"]
    assert found["dates"]["a"]["self_declared"] == "2001-01-01"
    assert "Party B came first" in page.read_text(encoding="utf-8")
    capsys.readouterr()
    assert run(["dispute", *map(str, (*ours, *his))]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert text.startswith("Party A came first.")
    assert "2001, 00:00:00 UTC (self-declared)" in text
    code, said = marked.ask(capsys, "dispute", *ours)
    assert code == 2
    assert "two parties" in said["error"]["message"]
