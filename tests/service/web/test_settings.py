"""The first minutes: the page asks for the owner's name once; tabs and buttons follow scopes and routers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.service import serving
from tests.service.web.conftest import PHONE, Served, shoot, sign_in
from tests.service.web.journey import LONG, pixels
from tests.service.web.stock import ask, stock

if TYPE_CHECKING:
    from pathlib import Path

    from playwright.sync_api import Browser, Page, Route

NAME = 'Studio <img src=x onerror="document.title=1"> Nord'


def key_of(served: Served, *scopes: str) -> str:
    """A new API key with these scopes."""
    return str(ask(served, "/v1/api-keys", "POST", {"scopes": scopes})["token"])


def tabs(page: Page) -> list[str]:
    """The tabs that are shown."""
    return page.locator("#views a:visible").all_inner_texts()


def test_the_owner_is_asked_for_once(browser: Browser, tmp_path: Path) -> None:
    new = serving.start(tmp_path, workers=0)
    try:
        page = browser.new_page(viewport=PHONE)
        page.goto(new.address)
        sign_in(page, new.api_key)
        page.get_by_role("heading", name="Who is the owner?").wait_for()
        shoot(page, "owner")
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), "scrolls sideways"
        page.get_by_label("Name of the owner").fill(NAME)
        page.get_by_label("Public address").fill("https://marks.example/")
        page.get_by_role("button", name="Save", exact=True).click()
        page.get_by_role("heading", name="Mark a model").wait_for()
        me = ask(new, "/v1/me")
        assert (me["name"], me["service"]["public_url"]) == (NAME, "https://marks.example")
        page.get_by_role("button", name="Forget API key").click()
        sign_in(page, new.api_key)
        page.get_by_role("heading", name="Mark a model").wait_for()
        page.get_by_role("link", name="Settings").click()
        page.get_by_role("heading", name="Settings").wait_for()
        assert page.get_by_label("Name of the owner").input_value() == NAME
        assert page.locator("main img").count() == 0
        page.close()
    finally:
        new.stop()


def test_an_address_that_the_operator_set_is_shown_as_fixed(page: Page, served: Served) -> None:
    me = ask(served, "/v1/me")
    me["service"] |= {"public_url": "https://set.example", "may_set_public_url": False}
    page.route("**/v1/me", lambda route: route.fulfill(json=me))
    page.reload()
    page.get_by_role("link", name="Settings").click()
    page.get_by_role("heading", name="Settings").wait_for()
    address = page.get_by_label("Public address")
    assert (address.input_value(), address.is_disabled()) == ("https://set.example", True)
    assert page.get_by_text("Set by the operator").is_visible()


@pytest.mark.parametrize(
    ("scopes", "shown"),
    [
        (["embed"], ["Mark"]),
        (["verify"], ["Check"]),
        (["read"], ["Jobs", "Library"]),
        (["embed", "verify", "read"], ["Mark", "Check", "Jobs", "Library"]),
        (["originals"], []),
    ],
)
def test_tabs_follow_the_scopes(watched: Any, served: Served, scopes: list[str], shown: list[str]) -> None:
    page = watched.page
    page.get_by_label("API key", exact=True).fill(key_of(served, *scopes))
    page.get_by_role("button", name="Continue").click()
    page.locator("#key-state:visible").wait_for()
    page.wait_for_load_state("networkidle")
    assert tabs(page) == shown
    assert page.get_by_role("alert").count() == 0, "it asks for what the key may not have"
    if not shown:
        page.get_by_role("heading", name="Nothing to show").wait_for()
    if "embed" in scopes:
        assert page.locator("#mark-key").is_visible()
        assert page.get_by_role("button", name="Create a new key").is_hidden()


@pytest.mark.long
def test_buttons_of_parts_that_are_switched_off_are_not_shown(page: Page, served: Served) -> None:
    _, claim = stock(served)
    me = ask(served, "/v1/me")

    def marked(route: Route) -> None:
        """The unmarked original has no pack, so it is called a copy."""
        answer = route.fetch()
        plain = answer.json()
        plain["document"]["verdict"] = "marked"
        route.fulfill(response=answer, json=plain)

    for parts in (["packs", "shares"], []):
        me["service"]["parts"] = parts
        page.route("**/v1/me", lambda route: route.fulfill(json=me))
        page.route(f"**/v1/claims/{claim}", marked)
        page.goto(f"{served.address}/#claim/{claim}")
        page.reload()
        page.locator(".side-by-side img").nth(1).wait_for()
        for text in ("Request a takedown", "Share the report"):
            assert page.get_by_text(text).is_visible() == bool(parts), text


def test_a_key_without_originals_is_offered_none(watched: Any, served: Served) -> None:
    asset, _ = stock(served)
    page = watched.page
    page.goto(f"{served.address}/#asset/{asset}")
    sign_in(page, key_of(served, "read"))
    page.locator(".preview img").wait_for()
    assert page.locator(".viewer").count() == 0
    assert page.get_by_role("button", name="Download the record").count() == 0
    assert page.get_by_role("button", name="Download the marked model").is_visible()


def test_an_api_key_is_made_with_chosen_scopes_and_revoked(page: Page, served: Served) -> None:
    page.get_by_role("link", name="Settings").click()
    page.get_by_role("heading", name="Settings").wait_for()
    page.get_by_label("Name of the new API key").fill("Build <b>server</b>")
    page.get_by_role("button", name="Create an API key").click()
    page.get_by_text("No scope selected").wait_for()
    page.get_by_label("verify").check()
    page.get_by_role("button", name="Create an API key").click()
    made = page.get_by_label("The new API key", exact=True)
    made.wait_for()
    shoot(page, "settings")
    token = made.input_value()
    theirs = Served(served.address, token, served.folder, served.process)
    assert ask(theirs, "/v1/me")["key"]["scopes"] == ["verify"]
    page.get_by_role("button", name="Revoke Build <b>server</b>").click()
    page.locator("#said", has_text="Revoked").wait_for(state="attached")
    keys = {key["id"]: key["revoked_at"] for key in ask(served, "/v1/api-keys?limit=100")["items"]}
    assert keys[token.split("_")[1]] is not None


def test_all_of_the_model_is_in_the_3d_view(page: Page, served: Served) -> None:
    asset, _ = stock(served)
    page.goto(f"{served.address}/#asset/{asset}")
    page.locator(".viewer-stage[data-ready]").wait_for(timeout=LONG)
    page.evaluate("new Promise((r) => setTimeout(r, 700))")  # sorting ends a few frames later
    page.locator(".pane-name").evaluate_all("names => names.forEach((name) => name.remove())")
    for k in (0, 1):
        light = pixels(page.locator(".pane").nth(k)).max(axis=2)[:, 20:-20]  # without the round corners
        edges = np.concatenate([light[3:6].ravel(), light[-6:-3].ravel()])
        assert (edges > 40).mean() < 0.002, "cut off above or below"
        assert (light > 40).mean() > 0.05, "it is hardly seen"


def test_report_and_page_have_one_accent(page: Page, served: Served) -> None:
    _, claim = stock(served)
    page.goto(f"{served.address}/#claim/{claim}")
    page.locator(".verdict").wait_for()
    theirs = page.locator(".facts a").evaluate("link => getComputedStyle(link).color")
    html = page.evaluate(
        """async (claim) => {
          const headers = { Authorization: `Bearer ${sessionStorage.getItem("mark3dgs.api-key")}` };
          return (await fetch(`/v1/claims/${claim}/report`, { headers })).text();
        }""",
        claim,
    )
    report = page.context.new_page()
    report.set_content(html)
    report.evaluate("document.body.className = 'marked'")
    assert report.locator("h1").evaluate("h1 => getComputedStyle(h1).color") == theirs
    report.close()


def test_marking_makes_the_first_key(page: Page, served: Served, tmp_path: Path) -> None:
    """A new user fills in the form and sends it off; the key that it names is made on the way."""
    bad = tmp_path / "bad.ply"
    bad.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\nend_header\n")
    page.locator("#key-choice:visible, #key-make:visible").wait_for()
    if page.get_by_role("button", name="Create a new key").is_visible():
        page.get_by_role("button", name="Create a new key").click()
    page.get_by_label("Name of the new key").fill("On the way")
    page.get_by_label("Model file").set_input_files(bad)
    with page.expect_download() as download:
        page.get_by_role("button", name="Mark the model").click()
    assert download.value.suggested_filename.endswith(".key")
    page.get_by_role("alert").wait_for(timeout=LONG)  # of the model: that it is none was found after the key
    assert [key["label"] for key in ask(served, "/v1/keys")["items"]].count("On the way") == 1
