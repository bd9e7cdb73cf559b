"""What the page does when things go wrong, and without a mouse."""

from __future__ import annotations

import json
import re
import urllib.request
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tests.service.web.conftest import Served, Watched, shoot, sign_in
from tests.service.web.journey import LONG, PLANT, check, embed, make_key

if TYPE_CHECKING:
    from playwright.sync_api import Page, Request, Route


def test_a_wrong_api_key_is_refused_in_words(watched: Watched) -> None:
    page = watched.page
    page.get_by_label("API key", exact=True).fill("mk_0123456789abcdef_wrong")
    page.get_by_role("button", name="Continue").click()
    box = page.get_by_role("alert")
    box.wait_for()
    assert "API key" in box.inner_text()
    assert "Request" in box.inner_text()
    assert page.evaluate("sessionStorage.length") == 0
    assert page.get_by_label("API key", exact=True).is_visible()


def test_the_key_lives_in_this_tab_only_and_is_forgotten(page: Page, served: Served) -> None:
    page.reload()
    page.get_by_role("heading", name="Mark a model").wait_for()
    assert page.evaluate("[localStorage.length, document.cookie]") == [0, ""]
    page.get_by_role("button", name="Forget API key").click()
    page.get_by_label("API key", exact=True).wait_for()
    assert page.evaluate("sessionStorage.length") == 0
    assert page.get_by_role("navigation").count() == 0


def test_a_file_that_is_no_model_is_refused_in_words(page: Page, tmp_path: Path) -> None:
    make_key(page, "Errors")
    bad = tmp_path / "bad.ply"
    bad.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\nend_header\n")
    embed(page, bad, "Broken")
    box = page.get_by_role("alert")
    box.wait_for(timeout=LONG)
    assert "The model cannot be read" in box.inner_text()
    assert re.search(r"Request [0-9a-f]{16}|Job job_\w+", box.inner_text())
    assert page.evaluate("document.activeElement.className") == "problem"
    assert page.get_by_role("button", name="Mark the model").is_visible(), "the form is there to try again"
    shoot(page, "mark-problem")


def test_two_models_at_once_are_not_a_suspect(page: Page) -> None:
    page.get_by_role("link", name="Check", exact=True).click()
    page.get_by_label("Suspect model or screenshots").set_input_files([PLANT, PLANT.parent / "train_1000.ply"])
    page.get_by_role("button", name="Check the suspect").click()
    assert "More than one suspect" in page.get_by_role("alert").inner_text()


def test_a_broken_upload_goes_on_where_it_stopped_and_a_job_can_be_cancelled(page: Page, served: Served) -> None:
    half = 1_000_000
    offsets: list[int] = []

    def half_of_it(route: Route) -> None:
        part = urllib.request.Request(
            route.request.url,
            PLANT.read_bytes()[:half],
            method="PUT",
            headers={"Authorization": route.request.headers["authorization"], "Upload-Offset": "0"},
        )
        urllib.request.urlopen(part, timeout=30).close()
        route.abort("connectionreset")  # the browser never hears that half arrived

    def note(request: Request) -> None:
        if request.method == "PUT":
            offsets.append(int(request.headers["upload-offset"]))

    page.on("request", note)
    page.route("**/v1/uploads/*", half_of_it, times=1)
    make_key(page, "Interrupted")
    embed(page, PLANT, "Interrupted")
    page.get_by_text("Connection lost").wait_for()
    page.get_by_text("Queued").or_(page.get_by_text("Searching")).first.wait_for(timeout=LONG)
    assert offsets == [0, half]
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Mark the model").wait_for(timeout=LONG)
    states = page.evaluate(
        """async () => {
          const headers = { Authorization: `Bearer ${sessionStorage.getItem("mark3dgs.api-key")}` };
          return (await (await fetch("/v1/jobs", { headers })).json()).items.map((job) => job.state);
        }"""
    )
    assert states[0] == "cancelled"
    assert page.get_by_role("alert").count() == 0


def test_the_whole_form_works_from_the_keyboard(watched: Watched, served: Served) -> None:
    page, press = watched.page, watched.page.keyboard.press
    reached = []

    def tab_to(name: str) -> None:
        for _ in range(40):
            press("Tab")
            reached.append(focused(page))
            if name in reached[-1]:
                return
        raise AssertionError(f"{name!r} is not reached: {reached}")

    # From the start: asked for only when the key is pressed, Chromium may hear of it too late.
    page.on("filechooser", lambda chooser: chooser.set_files(PLANT))
    tab_to("API key")
    page.keyboard.type(served.api_key)
    press("Enter")
    page.get_by_role("heading", name="Mark a model").wait_for()
    assert focused(page) == "Mark a model", "a new view starts at its heading"
    tab_to("Model file")
    press("Space")
    page.locator("#mark-drop").get_by_text("plant.splat").wait_for()
    page.locator("#key-choice:visible, #key-make:visible").wait_for()
    if page.get_by_role("button", name="Create a new key").is_visible():
        tab_to("Create a new key")
        press("Enter")
    else:
        tab_to("Name of the new key")
    assert "Name of the new key" in focused(page)
    page.keyboard.type("By hand")
    press("Enter")
    page.locator("#mark-key:focus").wait_for()
    tab_to("Auto")
    press("ArrowRight")
    assert page.get_by_label("Fast").is_checked()
    tab_to("Mark the model")
    press("Enter")
    page.get_by_role("heading", name="Marking the model").wait_for()
    assert focused(page) == "Marking the model"
    tab_to("Cancel")
    press("Enter")
    page.get_by_role("button", name="Mark the model").wait_for(timeout=LONG)
    assert focused(page) == "Mark a model"


def test_only_auto_asks_what_must_still_show_the_mark(page: Page) -> None:
    asked: list[dict[str, Any]] = []

    def refuse(route: Route) -> None:
        asked.append(json.loads(route.request.post_data or ""))
        route.fulfill(status=422, json={"type": "about:blank", "title": "Refused", "status": 422})

    page.route("**/v1/embed", refuse)
    make_key(page, "Surviving")
    survive = page.get_by_label("What must still show the mark")
    assert survive.input_value() == "pictures"
    for profile, wanted in (("Auto", "worst"), ("Auto", "model"), ("Fast", None)):
        page.get_by_label("Model file").set_input_files(PLANT)
        page.get_by_label(profile).check()
        if wanted is None:
            assert survive.is_hidden()
        else:
            survive.select_option(wanted)
        page.get_by_role("button", name="Mark the model").click()
        page.get_by_role("alert").get_by_text("Refused").wait_for()
    assert [(each["profile"], each["survive"]) for each in asked] == [
        ("auto", "worst"),
        ("auto", "model"),
        ("fast", None),
    ]


def focused(page: Page) -> str:
    """How the element in focus is called."""
    return str(
        page.evaluate(
            """() => {
              const e = document.activeElement;
              return e.getAttribute("aria-label") ?? e.labels?.[0]?.innerText ?? e.innerText ?? "";
            }"""
        )
    ).strip()


def test_progress_survives_a_stream_that_does_not_come_through(watched: Watched, served: Served) -> None:
    sign_in(watched.page, served.api_key)
    watched.page.route("**/events", lambda route: route.abort())
    said = check(watched.page, PLANT.parent / "train_1000.ply")
    assert "no asset is registered" in said or said == "Not recognized"
    assert [url for url in watched.requests if url.endswith("/events")]
