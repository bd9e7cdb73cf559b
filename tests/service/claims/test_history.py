"""A log that was made anew contradicts what it signed before: within a claim, and from one claim to another."""

from __future__ import annotations

import copy
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from service.claims.arithmetic import Status
from service.claims.offline import Findings, verify_report
from service.cli import verify_report as command
from service.db import Database
from service.settings import Settings
from service.trust import audit
from service.trust.canonical import canonical
from service.trust.master import MasterKey
from tests.service.claims.cases import nothing
from tests.service.claims.conftest import Registry


class Fork(Registry):
    """The same service, with the same keys, as it was: what it signs from here on is another story."""

    def __init__(self, before: Registry, folder: Path) -> None:
        shutil.copytree(Path(str(before.db.engine.url.database)).parent, folder)
        settings = Settings(data_dir=folder)
        self.db = Database(settings.database())
        self.master = MasterKey.open(settings, self.db)


@pytest.fixture
def fork(registry: Registry, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fork]:
    made = Fork(registry, tmp_path_factory.mktemp("fork") / "data")
    yield made
    made.db.close()


def issue(registry: Registry, job: str, about_nothing: bool = False) -> bytes:
    return registry.issue(nothing() if about_nothing else None, job).jws.encode()


def said(found: Findings, code: str) -> list[tuple[Status, str]]:
    return [(check.status, check.text) for check in found.checks if check.code == code]


def test_a_claim_proves_the_log_of_the_registration_and_of_the_claim_before(registry: Registry) -> None:
    first = registry.issue(job="job_1").document["audit"]
    second = registry.issue(job="job_2").document["audit"]
    registered = first["registration"]["entry"]["index"] + 1
    assert [each["size"] for each in first["earlier"]] == [registered]
    assert [(each["size"], each["root"]) for each in second["earlier"]] == [
        (registered, first["earlier"][0]["root"]),
        (first["size"], first["root"]),
    ]
    assert registry.issue(nothing(), "job_3").document["audit"]["earlier"][0]["size"] == second["size"]


def altered(audit: dict[str, Any], change: str) -> None:
    one = audit["earlier"][-1]
    if change == "root":
        one["root"] = "ab" * 32
    elif change == "size":
        one["size"] -= 1
    elif change == "proof":
        one["proof"] = one["proof"][:-1]
    else:
        one["proof"] = ["zz", *one["proof"]]


@pytest.mark.parametrize("change", ["root", "size", "proof", "rubbish"])
def test_a_signature_does_not_make_another_beginning_hold(registry: Registry, change: str) -> None:
    registry.issue(job="job_1")
    document = copy.deepcopy(registry.issue(job="job_2").document)
    altered(document["audit"], change)
    found = verify_report(registry.sign(canonical(document)).encode(), registry.jwks)
    assert [check.code for check in found.checks if check.status is Status.FAIL] == ["history"]


def test_claims_of_one_log_are_known_from_each_other(registry: Registry) -> None:
    """Those of one asset at once, others by the claims between them, in any order."""
    one, two, three = (issue(registry, f"job_{number}", number > 1) for number in (1, 2, 3))
    four = issue(registry, "job_4")
    for claim, others in ((four, [one]), (one, [four]), (three, [one, two]), (one, [three, two])):
        found = verify_report(claim, registry.jwks, others=others)
        assert found.valid
        assert [status for status, _ in said(found, "other claim")] == [Status.PASS] * len(others)
    found = verify_report(three, registry.jwks, others=[one])
    assert found.valid
    ((status, text),) = said(found, "other claim")
    assert (status, "the claims between" in text) == (Status.NOT_CHECKED, True)


def test_a_log_made_anew_contradicts_its_claims(registry: Registry, fork: Fork) -> None:
    with fork.db.write() as connection:
        audit.append(connection, "acme", "something.else", {})
    ours, theirs = issue(registry, "job_1"), issue(fork, "job_1")
    for claim in (ours, theirs):
        assert verify_report(claim, registry.jwks).valid, "each by itself holds"
    later = issue(registry, "job_2")
    fork_later = issue(fork, "job_3", about_nothing=True)
    found = verify_report(fork_later, registry.jwks, others=[later, theirs])
    assert not found.valid
    assert "is of another log" in said(found, "other claim")[0][1]
    assert said(found, "other claim")[1][0] is Status.PASS


def test_what_is_no_claim_is_named_by_its_number(registry: Registry) -> None:
    found = verify_report(issue(registry, "job_1"), registry.jwks, others=[issue(registry, "job_2"), b"nothing"])
    assert said(found, "other claim")[1][1].startswith("file 2 is no claim signed by these keys")
    assert not found.valid


def test_the_command_takes_other_claims(registry: Registry, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = []
    for number in (1, 2):
        path = tmp_path / f"{number}.jws"
        path.write_bytes(issue(registry, f"job_{number}"))
        files.append(path)
    keys = tmp_path / "jwks.json"
    keys.write_text(canonical(registry.jwks).decode())
    assert command.verify_report(files[1], keys, None, [files[0]]) == 0
    assert "is of the same log" in capsys.readouterr().out
