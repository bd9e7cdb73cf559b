"""Every view: fits a phone, reads in both themes, and passes axe."""

from __future__ import annotations

import json
import time
import urllib.request
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.service.web.conftest import DESKTOP, PHONE, Served, shoot, sign_in
from tests.service.web.journey import LONG, PLANT

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

AXE = (Path(__file__).parent / "axe" / "axe.min.js").read_text()
VIEWS = ("gate", "mark", "check", "library", "asset", "claim")


def ask(served: Served, path: str, method: str = "GET", body: Any = None, **headers: str) -> Any:
    """JSON of the API."""
    data = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
    kind = {"Content-Type": "application/json"} if not isinstance(body, bytes) else {}
    request = urllib.request.Request(
        served.address + path,
        data,
        method=method,
        headers={"Authorization": f"Bearer {served.api_key}", **kind, **headers},
    )
    with urllib.request.urlopen(request, timeout=120) as response:
        return json.load(response)


def done(served: Served, path: str, body: dict[str, Any]) -> dict[str, Any]:
    """Result of a job."""
    job = ask(served, path, "POST", body)
    while job["state"] in ("queued", "running"):
        time.sleep(0.2)
        job = ask(served, f"/v1/jobs/{job['id']}")
    assert job["state"] == "succeeded", job
    return dict(job["result"])


@pytest.fixture(scope="session")
def stocked(served: Served) -> dict[str, str]:
    """Address of each view, with an asset and a claim in the service."""
    if not ask(served, "/v1/claims")["items"]:
        data = PLANT.read_bytes()
        upload = ask(served, "/v1/uploads", "POST", {"name": PLANT.name, "size": len(data)})["id"]
        ask(served, f"/v1/uploads/{upload}", "PUT", data)
        key = ask(served, "/v1/keys", "POST", {"label": "Views"})["id"]
        body = {"upload_id": upload, "key_id": key, "profile": "fast", "label": "Plant"}
        done(served, "/v1/embed", body)
        done(served, "/v1/verify", {"upload_id": upload})
    asset, claim = (ask(served, f"/v1/{name}")["items"][0]["id"] for name in ("assets", "claims"))
    return {name: f"#{name}" for name in VIEWS} | {"asset": f"#asset/{asset}", "claim": f"#claim/{claim}"}


def opened(browser: Browser, served: Served, address: str, view: str, **how: Any) -> Page:
    """A view, whole, in a fresh profile."""
    context = browser.new_context(**how)
    context.set_default_timeout(20_000)
    page = context.new_page()
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
    return page


@pytest.mark.parametrize("view", VIEWS)
def test_view(view: str, browser: Browser, served: Served, stocked: dict[str, str]) -> None:
    for name, theme, size in (("desktop-dark", "dark", DESKTOP), ("phone-light", "light", PHONE)):
        page = opened(browser, served, stocked[view], view, viewport=size, color_scheme=theme, reduced_motion="reduce")
        shoot(page, f"{view}-{name}")
        wide = page.evaluate(
            """[document.documentElement.scrollWidth, window.innerWidth,
                [...document.querySelectorAll("main *")].filter((e) => e.getBoundingClientRect().right > innerWidth + 1)
                  .map((e) => e.outerHTML.slice(0, 80))]"""
        )
        assert wide[0] <= wide[1], f"scrolls sideways on {name}: {wide[2]}"
        page.evaluate(AXE)
        found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
        said = [(rule["id"], [node["html"][:120] for node in rule["nodes"]]) for rule in found]
        assert said == [], name
        page.context.close()


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


def test_api_pages_draw_themselves(browser: Browser, served: Served) -> None:
    page = browser.new_page()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(f"{served.address}/docs")
    page.locator("#operations-embed-embed").wait_for(timeout=20_000)
    assert page.locator(".opblock").count() > 15
    assert [url for url in asked if not url.startswith((served.address, "data:", "blob:"))] == []
    page.close()
