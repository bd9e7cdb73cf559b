"""A claim is checked with public keys alone, and no change to it passes."""

from __future__ import annotations

import base64
import copy
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from engine.credentials.signer import make_trial_signer
from engine.errors import InputError
from engine.records.merkle import leaf_hash, node_hash
from engine.watermark.rates import ATTESTATION, DRAWS, OWNER, Attested, Condition, ConditionKind
from engine.watermark.statistics import log10_false_claim_bound, z_threshold
from service.claims.arithmetic import arithmetic_fault
from service.claims.document import document_words, summary_of
from service.claims.offline import Findings, Status, verify_report
from service.claims.report import report_html
from service.cli import verify_report as command
from service.trust import signing
from service.trust.canonical import canonical
from service.trust.commitments import claim_digest
from tests.service.claims.cases import ATTESTED, AUTHORITY, KINDS, PICTURES, VOUCHING, edit, nothing, reply
from tests.service.claims.conftest import Registry

Document = dict[str, Any]


def carriers(registry: Registry, found: dict[str, Any] | None = None, job: str = "job_1") -> dict[str, bytes]:
    """A claim in its three files."""
    claim = registry.issue(found, job)
    whole = {"document": claim.document, "jws": claim.jws, "timestamp": None}
    return {
        "jws": claim.jws.encode(),
        "json": json.dumps(whole).encode(),
        "html": report_html(claim.document, claim.jws, PICTURES).encode(),
    }


def failed(found: Findings) -> list[str]:
    return [check.code for check in found.checks if check.status is Status.FAIL]


@pytest.mark.parametrize("kind", KINDS)
def test_whole_claims_hold(registry: Registry, kind: str) -> None:
    for form, data in carriers(registry, reply(kind)).items():
        found = verify_report(data, registry.jwks)
        assert found.valid, (form, found.checks)
        assert found.document is not None
        assert found.document["verdict"] == kind
        assert found.signed_by == registry.jwks["keys"][0]["kid"]
        codes = [check.code for check in found.checks]
        around = {"jws": [], "json": ["document"], "html": ["pictures", "page"]}[form]
        inside = ["signature", "schema", "arithmetic", "meaning", "log", "registration", "history", "drawing"]
        assert codes == [*inside, *around]


def test_a_claim_about_nothing_holds(registry: Registry) -> None:
    for data in carriers(registry, nothing()).values():
        found = verify_report(data, registry.jwks)
        assert found.valid, found.checks
        assert "registration" not in [check.code for check in found.checks]


def test_claims_of_a_retired_key_hold_and_those_of_a_stranger_do_not(registry: Registry, tmp_path: Path) -> None:
    data = carriers(registry)["jws"]
    signing.rotate(registry.db, registry.master)
    assert verify_report(data, registry.jwks).valid
    stranger = Registry(_folder(tmp_path / "stranger"))
    assert failed(verify_report(data, stranger.jwks)) == ["signature"]
    assert failed(verify_report(data, {"keys": []})) == ["signature"]
    stranger.db.close()


def test_no_character_of_the_jws_can_be_changed(registry: Registry) -> None:
    text = carriers(registry)["jws"].decode()
    keys = registry.jwks
    for spot, old in enumerate(text):
        new = "B" if old == "A" else "A"
        found = verify_report((text[:spot] + new + text[spot + 1 :]).encode(), keys)
        assert failed(found) == ["signature"], spot
        assert found.document is None


@pytest.mark.parametrize("form", ["json", "html"])
def test_no_character_around_it_can_be_changed(registry: Registry, form: str) -> None:
    data, keys = carriers(registry)[form], registry.jwks

    @settings(max_examples=150, suppress_health_check=list(HealthCheck))
    @given(spot=st.integers(0, len(data) - 1), new=st.integers(0, 255))
    def check(spot: int, new: int) -> None:
        changed = data[:spot] + bytes([new]) + data[spot + 1 :]
        found = verify_report(changed, keys)
        if found.valid:  # JSON has more than one layout: what it says must then be the same
            assert changed == data or (form == "json" and json.loads(changed) == json.loads(data))

    check()


def test_a_page_with_other_words_or_pictures_fails(registry: Registry) -> None:
    page = carriers(registry)["html"]
    for old, new, codes in (
        (b"Watermark found", b"Watermark faked", ["page"]),
        (b"Studio Nord", b"Studio West", ["page"]),
        (base64.b64encode(PICTURES["suspect"]), base64.b64encode(PICTURES["heatmap"]), ["pictures"]),
        (b"</main>", b"<p>This is void.</p></main>", ["page"]),
        (b"\n", b"\r\n", ["page"]),
    ):
        assert old in page
        found = verify_report(page.replace(old, new), registry.jwks)
        assert failed(found) == codes
        assert found.document is not None  # what is signed can still be read


def test_a_summary_that_says_something_else_fails(registry: Registry) -> None:
    claim = registry.issue()
    whole = {
        "document": claim.document,
        "jws": claim.jws,
        "timestamp": None,
        "summary": summary_of(claim.document).model_dump(),
    }
    found = verify_report(json.dumps(whole).encode(), registry.jwks)
    assert found.valid
    assert [check.code for check in found.checks][-2:] == ["document", "summary"]
    forged = json.dumps(whole | {"summary": whole["summary"] | {"headline": "Mark faked"}}).encode()
    assert failed(verify_report(forged, registry.jwks)) == ["summary"]


def test_a_document_beside_another_signature_fails(registry: Registry) -> None:
    one = json.loads(carriers(registry)["json"])
    two = json.loads(carriers(registry, reply("not_marked"), "job_2")["json"])
    mixed = json.dumps({**one, "document": two["document"]}).encode()
    assert failed(verify_report(mixed, registry.jwks)) == ["document"]
    twice = carriers(registry)["json"].replace(b'{"document"', b'{"jws": "x", "document"', 1)
    assert failed(verify_report(twice, registry.jwks)) == ["readable"]
    more = json.dumps({**one, "verdict": "not_marked"}).encode()
    assert failed(verify_report(more, registry.jwks)) == ["readable"]


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"hello",
        b"\xff\xfe",
        b"{",
        b"{}",
        b"[" * 100_000,
        b"{" * 100_000,
        b'{"a":' * 50_000,
        b"<html>",
        b"<",
        b"a.b.c",
        b'{"document": {}, "jws": 5}',
        b'{"document": {"x": NaN}, "jws": "a.b.c"}',
        b'{"document": {}, "jws": "a.b.c", "timestamp": "?"}',
        b"<pre id=jws>a</pre><pre id=jws>b</pre>",
    ],
)
def test_rubbish_is_refused_in_words(registry: Registry, data: bytes) -> None:
    found = verify_report(data, registry.jwks)
    assert failed(found) in (["readable"], ["signature"])
    assert found.checks[0].text


def relog(document: Document) -> None:
    """Make the entry fit the document again, as a holder of the signing key might."""
    entry = document["audit"]["entry"]
    entry["payload"]["digest"] = claim_digest(document)
    document["audit"]["proof"] = []
    document["audit"]["root"] = leaf_hash(canonical(entry)).hex()


REGISTERED = Condition(ConditionKind.REGISTERED_BEFORE, None, ATTESTATION).to_json()
LATER = "2999-01-01"
SINCE = Condition(ConditionKind.SUSPECT_SINCE, LATER, OWNER).to_json()

SIGNED_FORGERIES: list[tuple[Callable[[Document], None], str]] = [
    (edit("verdict", to="not_marked"), "arithmetic"),
    (edit("meets_dishonest_claimant_rate", to=False), "arithmetic"),
    (edit("confidence", to=0.5), "arithmetic"),
    (edit("threshold", "false_claim_rate", to=0.5), "arithmetic"),
    (edit("threshold", "basis", to="self_declared"), "arithmetic"),
    (edit("threshold", "basis", to="trusted"), "arithmetic"),
    (edit("attested", to=None), "arithmetic"),
    (edit("attested", "drawn", to=False), "arithmetic"),
    (edit("drawing", to=None), "arithmetic"),
    (edit("drawing", "token", to=base64.b64encode(b"no stamp").decode()), "drawing"),
    (edit("drawing", "token", to="?"), "schema"),
    (edit("drawing", "terms", to="34" * 32), "drawing"),
    (edit("original", "sha256", to="34" * 32), "drawing"),
    (edit("audit", "registration", "entry", "payload", "drawn_sha256", to="34" * 32), "drawing"),
    (edit("conditions", to=[REGISTERED]), "arithmetic"),
    (edit("conditions", to=[REGISTERED["text"]]), "schema"),
    (edit("schema_version", to=3), "schema"),
    (edit("would_be_claim_if_attested", to=True), "arithmetic"),
    (edit("derived_fraction", to=1.0), "arithmetic"),
    (edit("derived_but_unmarked", to=True), "arithmetic"),
    (edit("derivation", to=None), "arithmetic"),
    (edit("meaning", "says", to="It was stolen by Mallory."), "meaning"),
    (edit("meaning", "record_time", to="It stands whatever anybody says."), "meaning"),
    (edit("attested", "at", to="2020-01-01T00:00:00+00:00"), "registration"),
    (edit("original", "registered_at", to="2020-01-01T00:00:00+00:00"), "registration"),
    (edit("audit", "first_registration", to=None), "registration"),
    (edit("audit", "first_registration", "entry", "at", to="2020"), "registration"),
    (edit("audit", "first_registration", "proof", to=["00" * 32]), "registration"),
    (edit("log10_false_claim", to=-5000.5), "arithmetic"),
    (edit("tries", to=1), "arithmetic"),
    (edit("threshold", "z", to=1.0), "arithmetic"),
    (edit("message", "bit_accuracy", to=0.5), "arithmetic"),
    (edit("message", "reliability", to=[1.0]), "arithmetic"),
    (edit("evidence", to=[]), "arithmetic"),
    (edit("subject", "sha256", to=["34" * 32]), "log"),
    (edit("copy", to="Studio West"), "log"),
    (edit("audit", "proof", to=[]), "log"),
    (edit("audit", "root", to="00" * 32), "log"),
    (edit("audit", "root", to="xx"), "schema"),
    (edit("audit", "index", to=0), "log"),
    (edit("audit", "entry", "event", to="other"), "log"),
    (edit("audit", "entry", "at", to="2020"), "log"),
    (edit("audit", "registration", to=None), "registration"),
    (edit("audit", "registration", "entry", "at", to="2020"), "registration"),
    (edit("audit", "registration", "entry", "index", to=0), "registration"),
    (edit("audit", "registration", "entry", "subject", to="as_2"), "registration"),
    (edit("audit", "registration", "proof", to=["00" * 32]), "registration"),
    (edit("registered_at", to="2020-01-01T00:00:00+00:00"), "registration"),
    (edit("schema_version", to=5), "schema"),
    (edit("schema_version", to="1"), "schema"),
    (edit("confidence", to=1.5), "schema"),
    (edit("confidence", to="high"), "schema"),
    (edit("extra", to=1), "schema"),
    (edit("audit", to=None), "schema"),
    (edit("verdict", to="guilty"), "schema"),
    (relog, "registration"),
]


@pytest.mark.parametrize(("forge", "code"), SIGNED_FORGERIES)
def test_a_signature_does_not_make_a_contradiction_hold(
    registry: Registry, forge: Callable[[Document], None], code: str
) -> None:
    document = copy.deepcopy(registry.issue().document)
    forge(document)
    found = verify_report(registry.sign(canonical(document)).encode(), registry.jwks)
    assert code in failed(found), found.checks
    assert not found.valid


def resigned(registry: Registry, document: Document) -> Findings:
    """Checked after its issuer made log and meaning fit again, but for the registration."""
    document["meaning"] = document_words(document).meaning
    relog(document)
    return verify_report(registry.sign(canonical(document)).encode(), registry.jwks)


WORD = replace(ATTESTED, drawn=False)


@pytest.mark.parametrize(
    ("attested", "seen", "stated"), [(None, "", REGISTERED), (WORD, "", REGISTERED), (WORD, LATER, SINCE)]
)
def test_conditions_are_checked_against_basis_rate_and_dates(
    registry: Registry, attested: Attested | None, seen: str, stated: Document
) -> None:
    weak = reply(strength=0.12, attested=attested, seen=seen)
    document = copy.deepcopy(registry.issue(weak).document)
    assert document["would_be_claim_if_attested"]
    assert document["conditions"] == [stated]
    assert verify_report(registry.sign(canonical(document)).encode(), registry.jwks).valid
    other = SINCE if stated == REGISTERED else REGISTERED
    forged = [[], [other], [stated, stated], [{**stated, "text": "nobody knows"}], [{**stated, "by": "owner"}]]
    forged += [[{**stated, "date": "2020-01-01"}], [{**stated, "by": "attestation"}]]
    dated = [Condition(ConditionKind.SUSPECT_SINCE, date, OWNER).to_json() for date in ("2026-11-03", "2020", "soon")]
    for conditions in (*forged, *([each] for each in dated)):
        if conditions != [stated]:
            found = resigned(registry, {**document, "conditions": conditions})
            assert "arithmetic" in failed(found), conditions


def test_an_attested_date_carries_a_rate_in_earlier_claims_only(registry: Registry) -> None:
    """Nobody can attest that a suspect did not exist before."""
    document = copy.deepcopy(registry.issue().document)
    document["threshold"]["basis"] = "attested"
    document["attested"]["drawn"], drawing = False, document.pop("drawing")
    fault = arithmetic_fault({**document, "drawing": None})
    assert "version 4" in fault
    assert "time stamp" in fault
    assert arithmetic_fault({**document, "schema_version": 3}) == ""
    document["attested"]["drawn"] = True
    assert arithmetic_fault({**document, "drawing": drawing}) == ""


def test_requests_to_who_drew_are_counted(registry: Registry) -> None:
    """A claim that counts its routes alone has forgotten that its record may be the best of many."""
    document = copy.deepcopy(registry.issue().document)
    z, tries = document["evidence"][0]["z"], document["tries"] // DRAWS
    bound = log10_false_claim_bound(z, tries)
    document |= {"tries": tries, "log10_false_claim": bound, "confidence": -math.expm1(bound * math.log(10))}
    document["threshold"]["z"] = z_threshold(1e-9, tries)
    assert "hypotheses" in arithmetic_fault(document)


def test_who_drew_is_believed_by_certificates_alone(registry: Registry) -> None:
    data = carriers(registry)["jws"]
    status = {given: verify_report(data, registry.jwks, given).checks for given in ((), tuple(VOUCHING))}
    found = {given: next(each for each in checks if each.code == "drawing") for given, checks in status.items()}
    assert [each.status for each in found.values()] == [Status.NOT_CHECKED, Status.PASS]
    assert "Test stamps" in found[tuple(VOUCHING)].text
    stranger = make_trial_signer("Stranger", 2)[0].certificate
    assert failed(verify_report(data, registry.jwks, [stranger])) == ["drawing"]


@pytest.mark.parametrize(("claimed", "registered", "faults"), [(1, 0, []), (0, 1, ["registration"])])
def test_an_asset_registered_after_its_claim_does_not_count(
    registry: Registry, claimed: int, registered: int, faults: list[str]
) -> None:
    """A log of two entries, whole and signed, in either order."""
    document = copy.deepcopy(registry.issue().document)
    audit = document["audit"]
    claim, registration = audit["entry"], audit["registration"]["entry"]
    claim["index"], registration["index"] = claimed, registered
    leaves = {entry["index"]: leaf_hash(canonical(entry)) for entry in (claim, registration)}
    audit.update(index=claimed, size=2, root=node_hash(leaves[0], leaves[1]).hex(), earlier=[])
    audit["proof"] = [leaves[registered].hex()]
    proven = {"entry": registration, "proof": [leaves[claimed].hex()]}
    audit.update(registration=proven, first_registration=proven)
    found = verify_report(registry.sign(canonical(document)).encode(), registry.jwks)
    assert failed(found) == faults


@pytest.mark.parametrize("payload", [b"", b"5", b"[]", b"null", b"{", b"{}", b'{"schema_version": 1}', b"\xff"])
def test_a_signed_something_is_no_claim(registry: Registry, payload: bytes) -> None:
    assert failed(verify_report(registry.sign(payload).encode(), registry.jwks)) in (["schema"], ["signature"])


def test_a_later_version_is_not_called_a_forgery(registry: Registry) -> None:
    document = registry.issue().document | {"schema_version": 5, "more": True}
    found = verify_report(registry.sign(canonical(document)).encode(), registry.jwks)
    assert "a later version of this program" in found.checks[-1].text


def test_another_layout_is_no_second_claim(registry: Registry) -> None:
    spaced = json.dumps(registry.issue().document, sort_keys=True).encode()
    found = verify_report(registry.sign(spaced).encode(), registry.jwks)
    assert failed(found) == ["schema"]


def test_a_stamp_of_something_else_fails(registry: Registry) -> None:
    whole = json.loads(carriers(registry)["json"])
    whole["timestamp"] = base64.b64encode(b"not a stamp").decode()
    assert failed(verify_report(json.dumps(whole).encode(), registry.jwks)) == ["timestamp"]


# --- the command ---------------------------------------------------------------------------------------------


def test_the_command_answers_with_its_exit_code(
    registry: Registry, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys, claim = tmp_path / "jwks.json", tmp_path / "claim"
    keys.write_text(json.dumps(registry.jwks))
    for data in carriers(registry).values():
        claim.write_bytes(data)
        assert command.verify_report(claim, keys) == 0
        assert capsys.readouterr().out.endswith("\nVALID, as far as it was checked (not: drawing)\n")
        assert command.verify_report(claim, keys, AUTHORITY) == 0
        said = capsys.readouterr().out
        assert said.endswith("\nVALID\n")
        assert "Studio Nord" in said
    jws = carriers(registry)["jws"]
    # Not at the very end: the highest byte of an Ed25519 signature is zero in one of sixteen.
    claim.write_bytes(jws[:-40] + (b"B" if jws[-40:-39] == b"A" else b"A") + jws[-39:])
    assert command.verify_report(claim, keys, json=True) == 3
    output = json.loads(capsys.readouterr().out)
    assert (output["valid"], output["document"], output["checks"][0]["code"]) == (False, None, "signature")


@pytest.mark.parametrize("text", ["", "{}", '{"keys": []}', '{"keys": [5]}', '{"keys": 5}', "[]", "[" * 100_000])
def test_what_is_no_key_set_is_wrong_usage(registry: Registry, tmp_path: Path, text: str) -> None:
    keys, claim = tmp_path / "jwks.json", tmp_path / "claim"
    keys.write_text(text)
    claim.write_bytes(carriers(registry)["jws"])
    with pytest.raises(InputError, match="no set of public keys"):
        command.verify_report(claim, keys)


def _folder(path: Path) -> Path:
    path.mkdir()
    return path
