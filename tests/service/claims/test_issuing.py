"""Issuing: logged, signed and stored together, and once."""

from __future__ import annotations

import json
import threading

import pytest
import sqlalchemy as sa
from pydantic import ValidationError

from engine.records import signatures
from engine.records.timestamps import Stamped
from service.claims import issuing
from service.claims.document import document_words
from service.claims.issuing import IssuedClaim, links_of, stamp_claim
from service.claims.schema import ClaimDocument
from service.db.schema import assets, audit, claims
from service.problems import Problem
from service.settings import Settings
from service.trust.audit_check import verify_log
from service.trust.canonical import canonical
from tests.service.claims.cases import KINDS, nothing, reply
from tests.service.claims.conftest import Registry


def count(registry: Registry, table: sa.Table) -> int:
    with registry.db.read() as connection:
        return int(connection.execute(sa.select(sa.func.count()).select_from(table)).scalar_one())


@pytest.mark.parametrize("kind", KINDS)
def test_a_claim_is_logged_signed_and_stored(registry: Registry, kind: str) -> None:
    claim = registry.issue(reply(kind))
    payload, _ = signatures.verify(claim.jws, registry.jwks)
    assert json.loads(payload) == claim.document
    assert canonical(claim.document) == payload
    assert claim.document["verdict"] == kind
    assert claim.document["asset"] == "as_1"
    with registry.db.read() as connection:
        row = connection.execute(claims.select()).one()
    assert (row.id, row.job, row.tenant, row.asset, row.jws) == (claim.id, "job_1", "acme", "as_1", claim.jws)
    assert row.document.encode() == payload
    report = verify_log(registry.db)
    assert report.ok, report.text()
    assert (report.assets, report.claims) == (1, 1)


def test_links_lead_to_a_pack_where_there_are_packs(registry: Registry) -> None:
    document = registry.issue().document
    assert "pack" in links_of(document, Settings())
    assert "pack" not in links_of(document, Settings(routers="shares"))


def test_both_layers_of_the_evidence_are_signed(registry: Registry) -> None:
    found = reply()
    found["claim"]["layers"] = {"tint": 8.25, "grain": 31.5, "both": 32.0}
    document = registry.issue(found).document
    assert document["layers"] == found["claim"]["layers"]
    words = [fact.text for fact in document_words(document).facts]
    assert "color z 8.2, geometry z 31.5, combined z 32.0" in words


def test_one_job_has_one_claim(registry: Registry) -> None:
    first = registry.issue()
    entries = count(registry, audit)
    assert registry.issue(reply("not_marked")) == first
    assert (count(registry, claims), count(registry, audit)) == (1, entries)
    assert registry.issue(job="job_2").id != first.id


def test_two_workers_with_one_job_issue_one_claim(registry: Registry) -> None:
    found: list[IssuedClaim] = []
    threads = [threading.Thread(target=lambda: found.append(registry.issue())) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4
    assert all(claim == found[0] for claim in found)
    assert count(registry, claims) == 1


def test_the_first_registration_of_the_original_is_the_log_s_word(registry: Registry) -> None:
    """A row that says it is older does not make it so."""
    registry.register(id="as_0", job="other", registered_at="2025-01-01T00:00:00.000000+00:00")
    registry.register(id="as_x", job="foreign", tenant="other", registered_at="2024-01-01T00:00:00.000000+00:00")
    first, second = registry.issue().document, registry.issue(reply(asset="as_0"), "job_2").document
    for document in (first, second):
        proven = document["audit"]["first_registration"]["entry"]
        assert (proven["subject"], proven["at"]) == ("as_1", document["original"]["registered_at"])
    assert second["registered_at"] > second["original"]["registered_at"] == first["registered_at"]


def test_without_a_comparison_nothing_is_claimed(registry: Registry) -> None:
    document = registry.issue(nothing()).document
    assert (document["verdict"], document["confidence"], document["asset"]) == ("inconclusive", 0.0, None)
    assert document["audit"]["registration"] is None
    assert document["checks"][0]["ok"] is False
    ClaimDocument.model_validate(document)


def test_an_asset_of_another_tenant_is_no_ground_for_a_claim(registry: Registry) -> None:
    with pytest.raises(Problem, match="not this tenant's"):
        registry.issue(tenant="other")
    assert count(registry, claims) == 0


def test_an_asset_that_the_log_does_not_know_is_no_ground_for_a_claim(registry: Registry) -> None:
    with registry.db.write() as connection:
        connection.execute(assets.update().values(id="as_2"))
    with pytest.raises(Problem, match="the audit log does not know"):
        registry.issue(reply(asset="as_2"))


def test_when_signing_fails_nothing_is_left(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    entries = count(registry, audit)

    def fail(*_: object) -> str:
        raise Problem("internal", "no")

    monkeypatch.setattr(issuing, "sign", fail)
    with pytest.raises(Problem):
        registry.issue()
    assert (count(registry, claims), count(registry, audit)) == (0, entries)


def test_a_stamp_is_kept_and_asked_for_once(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    claim = registry.issue()
    replies = [Stamped(None, "no time stamp: busy"), Stamped(b"token"), Stamped(b"another")]
    monkeypatch.setattr(issuing, "stamp", lambda url, jws: replies.pop(0))
    assert stamp_claim(registry.db, "http://tsa", claim) == "no time stamp: busy"
    assert stamp_claim(registry.db, "http://tsa", claim) == ""
    assert stamp_claim(registry.db, "http://tsa", claim) == ""
    assert len(replies) == 1
    with registry.db.read() as connection:
        assert connection.execute(sa.select(claims.c.timestamp)).scalar_one() == b"token"


@pytest.mark.parametrize("text", ["", "yesterday", "2026-11-27", "2026-11-27T12:00:00"])
def test_a_claim_names_the_moment_it_was_made(registry: Registry, text: str) -> None:
    document = registry.issue().document
    ClaimDocument.model_validate(document)
    with pytest.raises(ValidationError, match="created_at"):
        ClaimDocument.model_validate(document | {"created_at": text})
