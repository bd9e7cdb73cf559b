"""The takedown pack: what it holds, that it can be checked, and what must never be in it."""

from __future__ import annotations

import hashlib
import io
import re
import zipfile
from typing import Any

import pytest
from PIL import Image
from pydantic import ValidationError

from service.claims.offline import verify_report
from service.claims.pack import make_pack, shown_in_pack
from service.claims.schema import OwnerStatement
from service.problems import Problem
from tests.service.claims.cases import PICTURES, nothing, picture, reply
from tests.service.claims.conftest import Registry

OWN = OwnerStatement(
    copy_url=["https://elsewhere.example/m/1", "https://elsewhere.example/m/2"], note="Taken from my shop."
)


def pack(registry: Registry, found: dict[str, Any] | None = None, own: OwnerStatement = OWN, **changes: Any) -> bytes:
    claim = registry.issue(found, **{"job": changes.pop("job", "job_1")})
    given = {"pictures": PICTURES, "timestamp": None} | changes
    return make_pack(claim.document, claim.jws, given["pictures"], given["timestamp"], own)


def opened(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name.partition("/")[2]: archive.read(name) for name in archive.namelist()}


def texts(data: bytes) -> tuple[str, str]:
    files = opened(data)
    return files["finding.txt"].decode(), files["notice.txt"].decode()


def test_the_same_claim_and_words_give_the_same_bytes(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    first = pack(registry)
    monkeypatch.setattr("time.time", lambda: 2e9)
    assert pack(registry) == first
    assert pack(registry, own=OwnerStatement()) != first


def test_a_tenant_that_nobody_named_is_a_blank(registry: Registry) -> None:
    """The first tenant of a service is called "default": no platform knows what to make of that."""
    claim = registry.issue(job="job_1")
    for name, said in (("default", "[name of the owner]"), ("Studio Acme", "Studio Acme")):
        document = {**claim.document, "owner": {"name": name}}
        finding, notice = texts(make_pack(document, claim.jws, PICTURES, None, OwnerStatement()))
        assert f"registered by {said}." in notice
        assert f" for {said}." in " ".join(finding.split())
    finding, notice = texts(make_pack({**claim.document, "owner": None}, claim.jws, PICTURES, None, OwnerStatement()))
    assert "registered by" not in notice


def test_what_it_holds_can_be_checked(registry: Registry) -> None:
    files = opened(pack(registry))
    pictures = {f"signed/{name}.png" for name in PICTURES}
    assert files.keys() == {"comparison.png", "where.png", "finding.txt", "notice.txt", "claim.jws"} | pictures
    checked = verify_report(files["claim.jws"], registry.jwks)
    assert checked.valid
    assert checked.document is not None
    signed = checked.document["pictures"]
    said = files["finding.txt"].decode()
    for name, digest in signed.items():
        assert hashlib.sha256(files[f"signed/{name}.png"]).hexdigest() == digest
        assert f"{digest}  signed/{name}.png" in said
    assert files["where.png"] == PICTURES["heatmap"]
    assert "mark3dgs verify-report claim.jws --jwks jwks.json" in said


def test_suspect_asset_and_difference_stand_side_by_side(registry: Registry) -> None:
    wide = {name: picture(shade) for name, shade in zip(PICTURES, (50, 100, 150, 200), strict=True)}
    with Image.open(io.BytesIO(opened(pack(registry, pictures=wide))["comparison.png"])) as sheet:
        below = sheet.height - 3
        assert [sheet.getpixel((left, below))[0] for left in (3, 491, 979)] == [200, 50, 100]


def test_each_verdict_has_its_words(registry: Registry) -> None:
    marked, undecided = (texts(pack(registry, reply(kind), job=f"job_{kind}")) for kind in ("marked", "inconclusive"))
    for finding, notice in (marked, undecided):
        for text in (finding, notice):
            assert "https://elsewhere.example/m/1" in text
            assert "https://elsewhere.example/m/2" in text
            assert "| Taken from my shop." in text
            assert "ab" * 32 in text
        assert "attested by the log" in finding
        assert "Only the issuer attests these dates" in finding
        assert "as_1" in notice
        assert "cd" * 16 in notice
        assert "12" * 32 in notice
        assert "original since: " in notice
        assert "[your signature]" in notice
    assert marked[0].startswith("WATERMARK FOUND")
    for text in marked:
        assert "It does not say who published the suspect" in text
    assert "where the watermark" not in undecided[1]
    assert "where.png" in marked[1]
    assert "Of 1 pictures" not in undecided[0]


def test_blanks_stay_where_the_owner_said_nothing(registry: Registry) -> None:
    finding, notice = texts(pack(registry, own=OwnerStatement()))
    assert "Found at: [links to the copy]" in notice
    assert "[link to the original, or: it is not published]" in notice
    assert "Statement of the owner" not in notice
    assert "[not stated]" in finding


def test_the_issuer_is_where_the_keys_are(registry: Registry) -> None:
    claim = registry.issue()
    document = {**claim.document, "issuer": {"name": "Marks Ltd", "address": "https://marks.example/"}}
    for text in texts(make_pack(document, claim.jws, PICTURES, None, OWN)):
        assert "https://marks.example/.well-known/jwks.json" in text
        assert "Marks Ltd" in text


def test_a_stamp_comes_along(registry: Registry) -> None:
    data = pack(registry, timestamp=b"no token at all")
    assert opened(data)["claim.jws.tst"] == b"no token at all"
    assert "Only the issuer" not in texts(data)[0]


def test_no_unmarked_picture_is_ever_packed(registry: Registry) -> None:
    """Claims of before show the original without its mark, and a map drawn over it."""
    before = {name: picture(3) for name in ("heatmap", "reference", "suspect")}
    assert shown_in_pack(before) == ["suspect"]
    assert set(shown_in_pack(PICTURES | before)) == set(PICTURES)
    with pytest.raises(ValueError, match="reference"):
        pack(registry, pictures=PICTURES | before)
    files = opened(pack(registry, pictures={"suspect": PICTURES["suspect"]}))
    assert files.keys() == {"finding.txt", "notice.txt", "claim.jws", "signed/suspect.png"}
    assert "check the suspect again" in files["finding.txt"].decode()


def test_another_camera_is_said(registry: Registry) -> None:
    alone = {name: data for name, data in PICTURES.items() if name != "difference"}
    finding, notice = texts(pack(registry, pictures=alone))
    assert "from another camera" in finding
    assert "from the same camera" not in finding + notice


@pytest.mark.parametrize(
    ("found", "why"), [(nothing(), "recognised nothing"), (reply("not_marked"), "unmarked original")]
)
def test_what_is_no_copy_is_nothing_to_take_down(registry: Registry, found: dict[str, Any], why: str) -> None:
    with pytest.raises(Problem, match=why) as caught:
        pack(registry, found)
    assert caught.value.kind == "conflict"


def test_words_from_outside_stay_what_they_are(registry: Registry) -> None:
    """A note cannot pass itself off as the finding, nor a recipient's name as a line of the notice."""
    registry.register(id="as_2", job="two", copy="Nord\nVALID: the owner is right\u202e")
    note = "a\nMARK FOUND\u2028HOW TO CHECK\x0bx\r\n" + "w" * 300 + "\n{{ 7 * 7 }}<script>"
    for text in texts(pack(registry, reply(asset="as_2"), OwnerStatement(note=note))):
        assert not [line for line in text.splitlines() if line.startswith(("VALID", "HOW TO CHECK\x0b", "www"))]
        assert sum(line.strip().startswith("| ") for line in text.split("\n")) >= 6
        assert "\u202e" not in text
        assert "{{ 7 * 7 }}<script>" in text
        assert len(text.splitlines()) == len(text.split("\n")) - 1, "a line break that is not ours"


@pytest.mark.parametrize(
    "said",
    [
        {"copy_url": ["javascript:alert(1)"]},
        {"copy_url": ["ftp://a.example/x"]},
        {"copy_url": ["https://me:secret@a.example/"]},
        {"copy_url": ["https://a.example/"] * 11},
        {"copy_url": ["https://a.example/" + "x" * 400]},
        {"original_url": "not an address"},
        {"note": "x" * 1001},
        {"copyurl": ["https://a.example/"]},
    ],
)
def test_what_is_no_address_is_refused(said: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        OwnerStatement.model_validate(said)


def test_an_address_keeps_to_its_line() -> None:
    assert str(OwnerStatement(copy_url=["https://a.example/x\ny"]).copy_url[0]) == "https://a.example/xy"


LAWS = {
    "dmca": [f"17 U.S.C. 512(c)(3)(A)({number})" for number in ("i", "ii", "iii", "iv", "v", "vi")],
    "dsa": [f"DSA article 16(2)({letter})" for letter in "abcd"],
}


def statement(registry: Registry, **own: Any) -> tuple[str, list[str]]:
    """The statement, and the parts of it that it says are blank."""
    text = opened(pack(registry, own=OwnerStatement.model_validate(own)))["statement.txt"].decode()
    body, _, blank = text.partition("\n--\n")
    return body, re.findall(r"^  (\S.*\)): \[", blank, re.MULTILINE)


@pytest.mark.parametrize("law", LAWS)
def test_a_statement_has_every_part_that_the_law_asks_for(registry: Registry, law: str) -> None:
    body, blank = statement(registry, law=law)
    assert re.findall(r"^(\S.*?\)): ", body, re.MULTILINE) == LAWS[law]
    located = {"dmca": "17 U.S.C. 512(c)(3)(A)(iii)", "dsa": "DSA article 16(2)(b)"}[law]
    assert blank == LAWS[law], "of all of them something is for a person to say"
    url = "https://elsewhere.example/a-very-long-way/" + "to-the-copy/" * 12
    body, blank = statement(registry, law=law, copy_url=[url])
    assert f"At: {url}\n" in body, "an exact address is one line"
    assert blank == [cite for cite in LAWS[law] if cite != located]


def test_words_from_outside_are_no_blanks(registry: Registry) -> None:
    body, blank = statement(registry, law="dsa", copy_url=["https://a.example/?q=[signed]"])
    assert "[signed]" not in body
    assert "DSA article 16(2)(b)" not in blank
    claim = registry.issue(job="job_2")
    document = {**claim.document, "owner": {"name": "Studio [X] Acme"}}
    text = opened(make_pack(document, claim.jws, PICTURES, None, OwnerStatement(law="dsa")))["statement.txt"].decode()
    assert "[name of who submits, if it is not Studio (X) Acme], [e-mail address]" in text


def test_without_a_law_there_is_no_statement(registry: Registry) -> None:
    assert "statement.txt" not in opened(pack(registry))
    with pytest.raises(ValidationError):
        OwnerStatement.model_validate({"law": "common"})
