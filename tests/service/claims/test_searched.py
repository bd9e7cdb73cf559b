"""A claim against all of an owner's assets speaks of one only where that one was recognised, and says who speaks."""

from __future__ import annotations

import json
from typing import Any

import pytest

from service.claims.document import document_words, of_what_was_found
from service.claims.issuing import IssuedClaim, issue
from service.claims.offline import verify_report
from service.claims.report import report_html
from service.core import Service
from service.jobs.port import Job, State
from service.settings import Settings
from service.trust.api_keys import issue as issue_key
from service.trust.api_keys import name_tenant
from service.trust.audit import Entry
from service.trust.canonical import canonical
from service.trust.commitments import claim_digest, commit_claim
from tests.service.claims.cases import PICTURES, reply
from tests.service.claims.conftest import Registry

KEPT = dict.fromkeys(PICTURES, "12" * 32)


def unrelated(**changes: Any) -> dict[str, Any]:
    """A reply about an asset that is not in the suspect."""
    found = reply("inconclusive")
    derivation = dict.fromkeys(found["claim"]["derivation"]) | {"derived": False}
    found["claim"] |= {"derivation": derivation, "derived_fraction": None}
    tried = [{"asset": name, "verdict": "inconclusive"} for name in ("as_1", "as_2")]
    searched = {"scope": "all", "assets": 41}
    return found | {"tried": tried, "searched": searched, "kept": KEPT} | changes


def issued(registry: Registry, found: dict[str, Any]) -> IssuedClaim:
    return registry.issue(of_what_was_found(found))


def test_of_all_one_that_was_not_recognised_is_not_named(registry: Registry) -> None:
    claim = issued(registry, unrelated())
    document = claim.document
    assert [document[name] for name in ("asset", "record_id", "original", "copy", "registered_at")] == [None] * 5
    assert document["audit"]["registration"] is None
    assert document["evidence"] == []
    assert set(of_what_was_found(unrelated())["kept"]) == {"suspect"}, "the others show an asset"
    assert unrelated()["regions"] is not None
    assert of_what_was_found(unrelated())["regions"] is None
    expected = {"scope": "all", "assets": 41, "compared": 2, "unreadable": 0, "recognised": False}
    assert document["searched"] == expected
    words = document_words(document)
    assert words.headline == "Not recognized"
    assert words.finding == "None of your 41 registered assets was recognized in the picture."
    assert "as_1" not in json.dumps(document)
    assert verify_report(claim.jws.encode(), registry.jwks).valid


def test_a_record_that_could_not_be_opened_is_counted(registry: Registry) -> None:
    tried = [{"asset": "as_1", "verdict": "inconclusive"}, {"asset": "as_2", "verdict": "could_not_check"}]
    document = issued(registry, unrelated(tried=tried)).document
    assert document["searched"]["unreadable"] == 1
    assert "1 could not be opened" in document["checks"][0]["text"]


def test_the_asset_that_was_named_is_spoken_of(registry: Registry) -> None:
    document = issued(registry, unrelated(searched={"scope": "one", "assets": 1})).document
    assert document["asset"] == "as_1"
    words = document_words(document)
    assert (words.headline, words.finding) == ("Not recognized", "Nothing of your asset was recognized in the picture.")


@pytest.mark.parametrize("kind", ["marked", "not_marked", "inconclusive"])
def test_the_asset_that_was_recognised_is_spoken_of(registry: Registry, kind: str) -> None:
    searched = {"scope": "all", "assets": 41}
    document = issued(registry, reply(kind, searched=searched)).document
    assert (document["asset"], document["searched"]["recognised"]) == ("as_1", True)


@pytest.mark.parametrize("changes", [{"recognised": True}, {"scope": "one"}])
def test_what_was_searched_follows_from_the_rest(registry: Registry, changes: dict[str, Any]) -> None:
    """Signed by the service's own key: still found."""
    document = issued(registry, unrelated()).document
    document["searched"] |= changes
    document["audit"]["entry"]["payload"]["digest"] = claim_digest(document)
    found = verify_report(registry.sign(canonical(document)).encode(), registry.jwks)
    assert "arithmetic" in {check.code for check in found.checks if check.status == "fail"}


def test_the_second_version_is_still_checked(registry: Registry) -> None:
    """Which did not say who issues a claim, for whom, and what was searched."""
    document = registry.issue().document
    audit = document.pop("audit")
    old = {name: value for name, value in document.items() if name not in ("issuer", "owner", "searched", "drawing")}
    old |= {"schema_version": 2, "claim_id": "cl_old"}
    entry, first = (Entry(**audit[name]["entry"]) for name in ("registration", "first_registration"))
    with registry.db.write() as connection:
        old["audit"] = commit_claim(connection, "acme", old, entry, first)
    found = verify_report(registry.sign(canonical(old)).encode(), registry.jwks)
    assert found.valid, found.checks
    assert {check.code: check.status for check in found.checks}["meaning"] == "not_checked"


def test_who_speaks_for_whom(registry: Registry, tmp_path: Any) -> None:
    """Issuer, address and owner, in claim and report."""
    settings = Settings(data_dir=tmp_path, issuer_name="Kiel Registry", public_url="https://marks.example")
    service = Service.open(settings)
    issue_key(service.db, service.master, "acme", ["read"])
    job = Job("job_9", "acme", "key", "verify", State.RUNNING, {"model": "12" * 32, "images": []})

    def ask(name: str) -> dict[str, Any]:
        result = issue(service, Job(**{**vars(job), "id": name}), of_what_was_found(reply() | {"kept": {}}))
        with service.db.read() as connection:
            from service.db.schema import claims

            row = connection.execute(claims.select().where(claims.c.id == result["claim_id"])).one()
        return json.loads(row.document) | {"jws": row.jws}

    assert ask("job_9")["owner"] == {"name": "acme"}, "who has no name is called by his id"
    name_tenant(service.db, "acme", "Studio Acme, Hamburg")
    document = ask("job_10")
    jws = document.pop("jws")
    assert document["issuer"] == {"name": "Kiel Registry", "address": "https://marks.example"}
    assert document["owner"] == {"name": "Studio Acme, Hamburg"}
    page = report_html(document, jws, {})
    assert all(text in page for text in ("Kiel Registry", "https://marks.example", "Studio Acme, Hamburg"))
    assert verify_report(page.encode(), registry.jwks).valid
    service.close()


def test_the_report_says_what_was_searched(registry: Registry) -> None:
    claim = issued(registry, unrelated())
    page = report_html(claim.document, claim.jws, PICTURES)
    assert "41 registered assets" in page
    assert verify_report(page.encode(), registry.jwks).valid
