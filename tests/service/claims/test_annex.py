"""The annex: one page of error rates beside a claim, whose numbers are those of docs/results."""

from __future__ import annotations

import html
import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.results_page import error_rates, read_results
from service.claims import annex
from service.claims.annex import annex_html
from service.claims.report import _plain
from tests.service.claims.cases import KINDS, nothing, reply
from tests.service.claims.conftest import Registry

RESULTS = read_results(Path(__file__).parents[3] / "docs" / "results")


def words(page: str) -> str:
    """The page without its tags."""
    return html.unescape(re.sub(r"<[^>]+>", "", page.partition("</style>")[2]))


def of_version(document: dict[str, Any], version: str) -> dict[str, Any]:
    return document | {"tool": {"name": "mark3dgs", "version": version}}


def test_the_shipped_numbers_are_those_of_the_results() -> None:
    assert annex._RATES.read_text(encoding="utf-8") == error_rates(RESULTS), "run engine.lab.evaluate.results_page"


def test_every_measured_error_rate_is_shown(registry: Registry) -> None:
    page = words(annex_html(registry.issue().document))
    shown = [result for result in RESULTS.values() if result.tested]
    assert len(shown) > 5
    for result in shown:
        rates = [bar for bar in result.bars if bar.rate]
        for text in (result.tested, result.commit, result.command, *(bar.measured for bar in rates)):
            assert _plain(text) in page
        assert page.count("Not met: ") == sum(not bar.met for each in shown for bar in each.bars if bar.rate)


def test_intervals_of_false_claims_follow_from_the_counts() -> None:
    for _, tested, claims, _ in RESULTS["06_false_claims"].rows:
        count, most, percent = re.fullmatch(r"(\d+) \(95 %: at most ([\d.e-]+)( %)?\)", claims).groups()  # type: ignore[union-attr]
        limit = share_interval(int(count), int(tested.replace(",", "")))[1]
        assert float(most) / (100 if percent else 1) == pytest.approx(limit, rel=0.03)


def test_the_claims_own_score_and_limits_are_on_it(registry: Registry) -> None:
    document = registry.issue().document
    page = words(annex_html(document))
    assert f"hypotheses tested: {document['tries']:,}; bound: below 10⁻³⁰⁰" in page
    assert f"z {document['evidence'][0]['z']:.1f}, required {document['threshold']['z']:.1f}" in page
    assert document["meaning"]["does_not_say"] in page
    assert not re.search(r"`|\]\(", page), "its numbers come out of Markdown"
    assert "has no score" in words(annex_html(registry.issue(nothing(), "job_2").document))


def test_it_says_whose_version_the_numbers_are(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(annex, "version", lambda _: "7.1")
    document = registry.issue().document
    assert "these numbers are those of version 7.1" in words(annex_html(of_version(document, "7.0")))
    assert "7.1, which also has these numbers" in words(annex_html(of_version(document, "7.1")))


@pytest.mark.skipif(shutil.which("chromium") is None, reason="no Chromium on this machine")
def test_it_is_one_page_that_asks_for_nothing(registry: Registry, tmp_path: Path) -> None:
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": 360, "height": 700})
        calls: list[str] = []
        tab.on("request", lambda request: calls.append(request.url))
        for kind in KINDS:
            document = json.loads(json.dumps(registry.issue(reply(kind), f"job_{'f' * 24}_{kind}").document))
            (tmp_path / f"{kind}.html").write_text(annex_html(of_version(document, "0.0.9")), encoding="utf-8")
            tab.goto((tmp_path / f"{kind}.html").as_uri())
            assert tab.evaluate("document.documentElement.scrollWidth") == 360
            pages = re.findall(rb"/Type\s*/Page\b", tab.pdf(prefer_css_page_size=True))
            assert len(pages) == 1, kind
        browser.close()
    assert len(calls) == len(KINDS)
