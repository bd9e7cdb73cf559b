"""The report: one page that needs nothing else, says what was signed, and cannot be made to say more."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from service.claims.report import report_html
from tests.service.claims.cases import KINDS, PICTURES, REGIONS, nothing, reply
from tests.service.claims.conftest import Registry


def page(registry: Registry, found: dict[str, Any] | None = None, job: str = "job_1") -> str:
    claim = registry.issue(found, job)
    return report_html(claim.document, claim.jws, PICTURES)


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_stands_alone(registry: Registry, kind: str) -> None:
    text = page(registry, reply(kind))
    assert not re.search(r"<script|<link|@import|url\(|javascript:|\bon\w+=", text, re.IGNORECASE)
    assert {match[:5] for match in re.findall(r'(?:src|href)="([^"]*)"', text)} == {"data:"}
    assert "default-src &#39;none&#39;" in text or "default-src 'none'" in text
    assert text.count("<img") == 4


def test_the_same_claim_gives_the_same_page(registry: Registry) -> None:
    assert page(registry) == page(registry)


def test_each_verdict_has_its_words(registry: Registry) -> None:
    marked, not_marked, undecided = (page(registry, reply(kind), f"job_{kind}") for kind in KINDS)
    assert "<h1>Watermark found</h1>" in marked
    assert "32/32" in marked
    assert "<h1>Your unmarked original</h1>" in not_marked
    assert "It does not acquit" in not_marked
    assert "chance gives about 16" in not_marked
    assert "<h1>Inconclusive</h1>" in undecided
    assert "derived from your asset" in undecided
    assert "no view of this asset was recognised" in undecided
    for text in (marked, not_marked, undecided):
        assert "1 in 2¹²⁸" in text
        assert "mark3dgs verify-report claim.jws --jwks jwks.json" in text
        assert "required here: 1 in 10⁹" in text
        assert "attested by the log of this service" in text


def test_a_claim_about_nothing_has_a_page(registry: Registry) -> None:
    text = page(registry, nothing())
    assert "nothing registered could be compared" in text
    assert "bit by bit" not in text


def test_names_from_outside_stay_text(registry: Registry) -> None:
    evil = '"><script>alert(1)</script>{{ 7 * 7 }}'
    registry.register(id="as_2", job="two", copy=evil)
    text = page(registry, reply(asset="as_2"))
    assert "<script" not in text
    assert "&lt;script&gt;alert(1)" in text
    assert "{{ 7 * 7 }}" in text


@pytest.mark.parametrize("bits", [16, 32, 48, 256])
def test_every_bit_is_drawn(registry: Registry, bits: int) -> None:
    found = reply("marked", bits)
    found["claim"]["message"] = f"{int(found['claim']['message'], 16) ^ 0b101:0{bits // 4}x}"
    text = page(registry, found)
    assert text.count('class="cell') == 2 * bits
    assert text.count('class="sure"') == bits
    message = registry.issue().document["message"]
    assert text.count('class="unlike"') == 2
    ones = [int(message[name], 16).bit_count() for name in ("hex", "registered")]
    assert text.count('class="cell one"') == sum(ones)


@pytest.mark.skipif(shutil.which("chromium") is None, reason="no Chromium on this machine")
def test_the_page_fits_a_phone_and_asks_for_nothing(registry: Registry, tmp_path: Path) -> None:
    sync_api = pytest.importorskip("playwright.sync_api")
    (tmp_path / "report.html").write_text(page(registry, reply("marked", 256)), encoding="utf-8")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": 360, "height": 700})
        said, calls = [], []
        tab.on("console", lambda message: said.append(message.text))
        tab.on("request", lambda request: calls.append(request.url[:5]))
        tab.goto((tmp_path / "report.html").as_uri())
        width = tab.evaluate("document.documentElement.scrollWidth")
        loaded = tab.evaluate("[...document.images].every((image) => image.naturalWidth === 8)")
        browser.close()
    assert (width, loaded, said) == (360, True, [])
    assert set(calls) <= {"file:", "data:"}


def test_the_map_of_regions_is_explained_and_that_of_before_as_it_was(registry: Registry) -> None:
    assert registry.issue().document["regions"] == REGIONS
    assert "hatched was not seen" in page(registry)
    before = page(registry, reply(regions=None), job="job_2")
    assert "hatched" not in before
    assert "blue against it" in before
