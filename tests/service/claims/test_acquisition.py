"""A claim that names its suspect's acquisition: what it says of it, and what a reader can check offline."""

from __future__ import annotations

import base64
import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from engine.records.timestamps import make_query
from service.claims.issuing import IssuedClaim, issue_claim
from service.claims.offline import Check, Status, verify_report
from service.cli.verify_report import verify_report as command
from service.db.schema import acquisitions
from service.problems import Problem
from service.trust import audit
from service.trust.canonical import canonical, digest
from service.trust.commitments import ACQUISITION_MADE, acquisition_facts, forget
from tests.records.test_timestamps import Authority
from tests.service.claims.cases import edit, reply, verify_job
from tests.service.claims.conftest import Registry

SUSPECT = "12" * 32
ROW = {
    **{"id": "aq_1", "tenant": "acme", "api_key": "k", "url": "https://models.example/a.ply", "upload": None},
    **{"at": "2026-01-27T10:00:00.000000+00:00", "created_at": "2026-01-27T10:00:01.000000+00:00"},
    **{"payload_sha256": SUSPECT, "warc_sha256": "34" * 32, "bytes": 1, "warc_bytes": 1, "timestamp": None},
}


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    return Authority(tmp_path_factory.mktemp("authority"))


def acquire(registry: Registry, **changes: Any) -> None:
    row = ROW | changes
    with registry.db.write() as connection:
        connection.execute(acquisitions.insert().values(row))
        audit.append(connection, "acme", ACQUISITION_MADE, {"digest": digest(acquisition_facts(row))}, row["id"])


def issue(registry: Registry) -> IssuedClaim:
    with registry.db.write() as connection:
        job = verify_job(suspect=SUSPECT, acquisition_id="aq_1")
        return issue_claim(connection, registry.master, job, reply() | {"kept": {}})


def checked(jws: str, registry: Registry, *certificates: Any) -> Check:
    """What came of the acquisition; all else holds."""
    found = verify_report(jws.encode(), registry.jwks, certificates)
    (mine,) = (check for check in found.checks if check.code == "acquisition")
    assert all(
        check.status is not Status.FAIL for check in found.checks if check.code not in ("acquisition", "drawing")
    )
    return mine


def test_without_a_stamp_it_is_the_services_word(registry: Registry) -> None:
    acquire(registry)
    claim = issue(registry)
    assert claim.document["acquisition"] == acquisition_facts(ROW) | {"timestamp": None}
    assert [each["ok"] for each in claim.document["checks"] if each["code"] == "acquisition"] == [None]
    found = checked(claim.jws, registry)
    assert found.status is Status.NOT_CHECKED
    assert "only the service states" in found.text


def test_with_a_stamp_a_third_party_says_when(registry: Registry, authority: Authority, tmp_path: Path) -> None:
    acquire(registry, timestamp=authority.reply(make_query(canonical(acquisition_facts(ROW)))))
    claim = issue(registry)
    assert [each["ok"] for each in claim.document["checks"] if each["code"] == "acquisition"] == [True]
    assert checked(claim.jws, registry).status is Status.NOT_CHECKED
    assert checked(claim.jws, registry, *authority.roots).status is Status.PASS
    assert checked(claim.jws, registry, *Authority(tmp_path).roots).status is Status.FAIL


def test_the_command_says_what_was_checked(
    registry: Registry, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    authority = Authority(tmp_path, qualified=True)
    acquire(registry, timestamp=authority.reply(make_query(canonical(acquisition_facts(ROW)))))
    (tmp_path / "claim.jws").write_text(issue(registry).jws)
    (tmp_path / "jwks.json").write_text(json.dumps(registry.jwks))
    assert command(tmp_path / "claim.jws", tmp_path / "jwks.json", None, None, None, False) == 0
    assert "acquisition" in capsys.readouterr().out.splitlines()[-1]
    trusted = tmp_path / "ca.pem"
    command(tmp_path / "claim.jws", tmp_path / "jwks.json", trusted, None, trusted, False)
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "acquisition:" in line)
    assert line.startswith("ok")
    assert "a qualified time stamp" in line


def test_the_rate_and_the_conditions_stay(registry: Registry, authority: Authority) -> None:
    """That the suspect existed then does not show that it did not before."""
    plain = registry.issue(job="job_0").document
    acquire(registry, timestamp=authority.reply(make_query(canonical(acquisition_facts(ROW)))))
    document = issue(registry).document
    for name in ("conditions", "threshold", "verdict", "confidence", "would_be_claim_if_attested"):
        assert document[name] == plain[name]


@pytest.mark.parametrize(
    "change",
    [
        edit("acquisition", "url", to="https://else.example/"),
        edit("acquisition", "at", to="2020-01-01T00:00:00.000000+00:00"),
        edit("acquisition", "warc_sha256", to="56" * 32),
        edit("acquisition", to=None),
        edit("audit", "acquisition", to=None),
        edit("audit", "acquisition", "proof", to=[]),
        edit("audit", "acquisition", "entry", "index", to=10**6),
        edit("acquisition", "timestamp", to=base64.b64encode(b"no stamp").decode()),
        edit("acquisition", "timestamp", to="AAA"),
    ],
)
def test_what_was_changed_is_found(registry: Registry, change: Callable[[dict[str, Any]], None]) -> None:
    """Also where the service itself signs it."""
    acquire(registry)
    document = copy.deepcopy(issue(registry).document)
    change(document)
    found = verify_report(registry.sign(canonical(document)).encode(), registry.jwks)
    assert "acquisition" in [check.code for check in found.checks if check.status is Status.FAIL]


def test_the_acquisition_of_something_else(registry: Registry) -> None:
    acquire(registry, payload_sha256="78" * 32)
    assert checked(issue(registry).jws, registry).status is Status.FAIL


def test_one_that_was_logged_before_it_was_made(registry: Registry) -> None:
    acquire(registry, at="2999-01-01T00:00:00.000000+00:00")
    assert checked(issue(registry).jws, registry).status is Status.FAIL


def test_one_that_was_deleted_meanwhile(registry: Registry) -> None:
    acquire(registry)
    forget(registry.db, acquisitions, "acme", "aq_1")
    with pytest.raises(Problem, match="aq_1"):
        issue(registry)
