"""Claims of the first version, signed before derivation and attested dates were in them, are still checked and read."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from service.claims.annex import annex_html
from service.claims.document import document_words
from service.claims.offline import Status, verify_report
from service.claims.report import report_html
from service.trust.canonical import canonical
from service.trust.commitments import commit_claim, registration_of
from tests.service.claims.cases import KINDS, PICTURES, reply
from tests.service.claims.conftest import Registry

NEW = {
    (): ("attested", "derivation", "would_be_claim_if_attested", "issuer", "owner", "searched", "regions", "drawing"),
    ("threshold",): ("basis",),
    ("evidence", 0): ("change",),
    ("audit",): ("first_registration",),
}
"""Members that the first version did not have, by where they stand."""


def first_version(registry: Registry, kind: str) -> tuple[dict[str, Any], str]:
    """A claim as it was signed then."""
    document = copy.deepcopy(registry.issue(reply(kind)).document)
    del document["audit"]
    document |= {"schema_version": 1, "claim_id": "cl_old"}
    document["meaning"]["record_time"] = "in the words of then"
    with registry.db.write() as connection:
        entry = registration_of(connection, "as_1")
        for path, names in NEW.items():
            if path != ("audit",):
                _strip(document, path, names)
        document["audit"] = commit_claim(connection, "acme", document, entry)
    _strip(document, ("audit",), NEW[("audit",)])
    return document, registry.sign(canonical(document))


def _strip(document: dict[str, Any], path: tuple[Any, ...], names: tuple[str, ...]) -> None:
    place: Any = document
    for step in path:
        place = place[step]
    for name in names:
        del place[name]


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_checked(registry: Registry, kind: str) -> None:
    document, jws = first_version(registry, kind)
    found = verify_report(jws.encode(), registry.jwks)
    assert found.valid, found.checks
    assert found.document == document
    states = {check.code: check.status for check in found.checks}
    assert states["meaning"] is Status.NOT_CHECKED
    assert states["arithmetic"] is states["registration"] is Status.PASS


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_read(registry: Registry, kind: str) -> None:
    document, jws = first_version(registry, kind)
    words = document_words(document)
    assert words.headline
    assert any("attested by the log of this service" in fact.text for fact in words.facts)
    assert "in the words of then" in report_html(document, jws, PICTURES)
    assert "How often the method errs" in annex_html(document)
