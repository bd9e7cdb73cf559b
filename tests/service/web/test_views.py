"""Every view: fits a phone, reads in both themes, and passes axe."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.service.web.conftest import DESKTOP, PHONE, Served, shoot, sign_in
from tests.service.web.journey import LONG
from tests.service.web.stock import stock
from tests.service.web.stubs import a_job, lists

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

AXE = (Path(__file__).parent / "axe" / "axe.min.js").read_text()
VIEWS = ("gate", "mark", "check", "jobs", "library", "settings", "asset", "claim")


@pytest.fixture(scope="package")
def stocked(served: Served) -> dict[str, str]:
    """Address of each view, with an asset and a claim in the service."""
    asset, claim = stock(served)
    return {name: f"#{name}" for name in VIEWS} | {"asset": f"#asset/{asset}", "claim": f"#claim/{claim}"}


def opened(browser: Browser, served: Served, address: str, view: str, **how: Any) -> Page:
    """A view, whole, in a fresh profile."""
    context = browser.new_context(**how)
    context.set_default_timeout(20_000)
    page = context.new_page()
    if view == "jobs":  # of every kind, at any time
        running = a_job(3, state="running", stage="embed", fraction=0.4)
        failed = {"type": "about:blank", "title": "The model cannot be read", "status": 422, "detail": "cut off"}
        ended = [a_job(2, state="failed", problem=failed), a_job(1, state="cancelled")]
        lists(page, jobs=[a_job(4, position=1), running, *ended])
    page.goto(f"{served.address}/{address}")
    if view != "gate":
        sign_in(page, served.api_key)
        page.locator("main > section:visible h1").wait_for()
    if view == "mark":
        page.get_by_text("Message and quality").click()
    if view == "asset":
        page.locator(".viewer-stage[data-ready]").wait_for(timeout=LONG)
        page.locator(".preview img").wait_for()
    if view == "library":
        page.locator("#claims a").first.wait_for()
        page.locator("#assets .thumb img").first.wait_for()
    if view == "claim":
        page.locator(".side-by-side img").nth(1).wait_for()
    if view == "settings":
        page.locator("#api-key-list li").first.wait_for()
    if view == "jobs":
        page.locator("#jobs-ended [data-job]").nth(1).wait_for()
    return page


@pytest.mark.parametrize("view", VIEWS)
def test_view(view: str, browser: Browser, served: Served, stocked: dict[str, str]) -> None:
    page = opened(browser, served, stocked[view], view, color_scheme="dark", reduced_motion="reduce")
    for name, theme, size in (("desktop-dark", "dark", DESKTOP), ("phone-light", "light", PHONE)):
        page.set_viewport_size(size)
        page.emulate_media(color_scheme=theme)
        shoot(page, f"{view}-{name}")
        wide = page.evaluate(
            """[document.documentElement.scrollWidth, window.innerWidth,
                [...document.querySelectorAll("main *")].filter((e) => e.getBoundingClientRect().right > innerWidth + 1)
                  .map((e) => e.outerHTML.slice(0, 80))]"""
        )
        assert wide[0] <= wide[1], f"scrolls sideways on {name}: {wide[2]}"
        if name == "desktop-dark":
            page.evaluate(AXE)
        found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
        said = [(rule["id"], [node["html"][:120] for node in rule["nodes"]]) for rule in found]
        assert said == [], name
    if view in ("asset", "claim"):
        _no_hole_in_the_facts(page)
    page.context.close()


def _no_hole_in_the_facts(page: Page) -> None:
    """Cells fill their table at any width: what they leave free shows as grey."""
    for width in (360, 600, 760, 960, 1280):
        page.set_viewport_size({"width": width, "height": 740})
        empty = page.evaluate(
            """[...document.querySelectorAll("main > section:not([hidden]) .facts")].map((list) => {
                 const area = (e) => e.clientWidth * e.clientHeight;
                 return 1 - [...list.children].reduce((sum, cell) => sum + area(cell), 0) / area(list);
               })"""
        )
        assert empty, "no facts are shown"
        assert max(empty) < 0.03, f"{width} pixels wide: {empty}"


def test_axe_sees_what_it_looks_for(browser: Browser, served: Served) -> None:
    page = browser.new_page()
    page.goto(served.address)
    page.evaluate("document.querySelector('label[for=api-key]').remove()")
    page.evaluate("document.querySelector('.lead').style.color = '#bbb'")
    page.evaluate(AXE)
    found = {rule["id"] for rule in page.evaluate("axe.run()")["violations"]}
    page.close()
    assert "color-contrast" in found


def test_nothing_moves_where_less_motion_is_wanted(browser: Browser, served: Served) -> None:
    for wanted, animation in (("reduce", "none"), ("no-preference", "along")):
        page = browser.new_page(reduced_motion=wanted)
        page.goto(served.address)
        name = "getComputedStyle(document.body.appendChild(document.createElement('progress'))).animationName"
        assert page.evaluate(name) == animation
        page.close()


@pytest.mark.long
def test_api_pages_are_dark_where_that_is_wanted(browser: Browser, served: Served) -> None:
    painted = """() => ["html", ".swagger-ui", ".opblock-summary-description", ".info .title"].map((name) => {
      const style = getComputedStyle(document.querySelector(name));
      return (name === "html" || name === ".swagger-ui" ? style.backgroundColor : style.color).match(/[\\d.]+/g)
        .slice(0, 3).reduce((sum, one) => sum + Number(one), 0) / 765;
    })"""
    page = browser.new_page(color_scheme="dark")
    page.goto(f"{served.address}/docs")
    page.locator(".opblock-summary-description").first.wait_for()
    shoot(page, "api-dark")
    ground, sheet, text, title = page.evaluate(painted)
    assert max(ground, sheet) < 0.2
    assert min(text, title) > 0.6
    page.emulate_media(color_scheme="light")
    page.locator("html:not(.dark-mode)").wait_for()
    ground, _, text, title = page.evaluate(painted)
    assert ground > 0.9 or ground == 0  # transparent: the browser's white
    assert max(text, title) < 0.4
    page.close()


@pytest.mark.long
def test_api_pages_draw_themselves(browser: Browser, served: Served) -> None:
    page = browser.new_page()
    calls: list[str] = []
    page.on("request", lambda request: calls.append(request.url))
    page.goto(f"{served.address}/docs")
    page.locator("#operations-embed-embed").wait_for(timeout=20_000)
    assert page.locator(".opblock").count() > 15
    assert [url for url in calls if not url.startswith((served.address, "data:", "blob:"))] == []
    page.close()
