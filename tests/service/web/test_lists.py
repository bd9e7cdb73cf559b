"""Library, claims and the choice of models: names, pictures, search, and what lies beyond a hundred entries."""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from service.work.pictures import CAPTION_HEIGHT, PREVIEW_GAP, PREVIEW_SIZE
from tests.service.web.conftest import PHONE, Served, shoot, sign_in
from tests.service.web.journey import pixels
from tests.service.web.stock import stock
from tests.service.web.stubs import a_claim, a_job, an_asset, lists

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route

LONG_NAME = "Wohnzimmerschrankwand_" * 9
HOSTILE = "<img src=x onerror=window.hit=1>\u202e&lt;b&gt;\"'`"


def library(page: Page) -> None:
    page.get_by_role("link", name="Library").click()
    page.locator("#assets li").first.wait_for()


def test_a_thumbnail_is_the_marked_picture_of_the_preview(page: Page, served: Served) -> None:
    asset, _ = stock(served)
    library(page)
    box = page.locator(f"#assets [data-asset={asset}]")
    box.locator("img").wait_for()
    answer = page.request.get(f"{served.address}/v1/assets/{asset}/preview.png", headers=served.headers)
    sheet = Image.open(io.BytesIO(answer.body())).convert("RGB")
    shown = pixels(box)
    height, width = shown.shape[:2]
    left = PREVIEW_SIZE[0] + PREVIEW_GAP
    marked = sheet.crop((left, CAPTION_HEIGHT, left + PREVIEW_SIZE[0], CAPTION_HEIGHT + PREVIEW_SIZE[1]))
    wanted = np.asarray(marked.resize((width, height), Image.Resampling.BOX), dtype=np.float64)
    inner = np.s_[4:-4, 4:-4]  # the box has round corners
    assert wanted.std() > 20, "an empty picture"
    assert np.abs(shown[inner] - wanted[inner]).mean() < 8


def test_lists_go_on_beyond_a_hundred(page: Page) -> None:
    queries = lists(page, assets=[an_asset(number) for number in range(235, 0, -1)], claims=[])
    library(page)
    more = page.get_by_role("button", name="Show older models")
    for shown in range(20, 235, 20):
        page.locator("#assets li").nth(shown - 1).wait_for()
        assert page.locator("#assets li").count() == shown
        more.focus()
        page.keyboard.press("Enter")
        page.locator(f"#assets li:nth-child({shown + 1}) a:focus").wait_for()  # reading goes on where it was
    assert page.locator("#assets strong").all_inner_texts() == [f"Model {number}" for number in range(235, 0, -1)]
    assert more.is_hidden()
    assert [query["after"] for query in queries if "after" in query][-1] == [an_asset(16)["id"]]


def test_a_model_beyond_the_first_hundred_can_be_checked_against(page: Page) -> None:
    lists(page, assets=[an_asset(number) for number in range(235, 0, -1)])
    page.get_by_role("link", name="Check", exact=True).click()
    choice = page.get_by_label("Marked model", exact=True)
    older = page.get_by_role("button", name="Show older models")
    for shown in (101, 201):
        page.locator("#check-asset option").nth(shown - 1).wait_for(state="attached")
        assert choice.locator("option").count() == shown
        older.click()
    page.locator("#check-asset option").nth(235).wait_for(state="attached")
    assert choice.locator("option").count() == 236
    assert older.is_hidden()
    choice.select_option("Model 7")
    page.get_by_label("Find a marked model").fill("Model 12")
    page.get_by_label("Find a marked model").press("Tab")
    page.locator("#check-asset:not(:has(option:nth-child(20)))").wait_for()
    texts = choice.locator("option").all_inner_texts()
    assert texts[:2] == ["All my marked models", "Model 7"], "what was chosen stays"
    assert {"Model 12", "Model 120"} <= set(texts)
    assert choice.evaluate("select => select.selectedOptions[0].textContent") == "Model 7"


def test_search_and_verdict_ask_the_service(page: Page) -> None:
    found = [an_asset(3), an_asset(2, label="Garden", copy_name="Acme"), an_asset(1)]
    output = {"asset_id": found[1]["id"], "asset_label": "Garden", "copy_name": "Acme", "suspects": ["stolen.ply"]}
    claims = [a_claim(3, verdict="marked", headline="Watermark found", **output), a_claim(2), a_claim(1)]
    queries = lists(page, assets=found, claims=claims)
    library(page)
    first = page.locator("#claims li").first
    assert "stolen.ply against Garden, copy for Acme" in first.inner_text()
    page.get_by_label("Find", exact=True).fill("acme")
    page.locator("#assets li:only-child").wait_for()
    page.locator("#claims li:only-child").wait_for()
    assert page.locator("#assets strong").inner_text() == "Garden"
    assert "copy for Acme" in page.locator("#assets").inner_text()
    assert {query["path"][0] for query in queries if query.get("q") == ["acme"]} == {"/v1/assets", "/v1/claims"}
    page.get_by_label("Find", exact=True).fill("nowhere")
    page.locator("#assets .none").wait_for()
    assert page.locator("#claims").inner_text() == "No results."
    page.get_by_label("Find", exact=True).fill("")
    page.locator("#claims li").nth(2).wait_for()
    page.get_by_label("Verdict of the claims").select_option("Watermark found")
    page.locator("#claims li:only-child").wait_for()
    assert queries[-1]["verdict"] == ["marked"]


def test_an_answer_that_comes_late_does_not_replace_a_later_one(page: Page) -> None:
    lists(page, assets=[an_asset(2, label="slow"), an_asset(1, label="quick")], claims=[])
    library(page)
    held: list[Route] = []
    slow = re.compile(r"/v1/assets\?.*q=slow")
    page.route(slow, lambda route: held.append(route))
    with page.expect_request(slow):
        page.get_by_label("Find", exact=True).fill("slow")
    page.get_by_label("Find", exact=True).fill("quick")
    page.locator("#assets li:only-child", has_text="quick").wait_for()
    with page.expect_response(slow):
        held[0].fallback()
    page.evaluate("new Promise((resolve) => setTimeout(resolve, 100))")
    assert page.locator("#assets strong").all_inner_texts() == ["quick"]


@pytest.mark.parametrize("forgotten", [False, True])
def test_keys_that_come_late_replace_nothing(page: Page, forgotten: bool) -> None:
    held: list[Route] = []
    page.route("**/v1/keys*", lambda route: held.append(route))
    page.get_by_role("link", name="Check", exact=True).click()
    page.get_by_role("link", name="Mark", exact=True).click()
    while not held:
        page.wait_for_timeout(20)
    if forgotten:
        page.get_by_role("button", name="Forget API key").click()
    else:
        lists(page, keys=[{"id": "key_1", "label": "Later", "fingerprint": "0123456789"}])
        page.get_by_role("link", name="Check", exact=True).click()
        page.get_by_role("link", name="Mark", exact=True).click()
        page.locator("#mark-key", has_text="Later").wait_for(state="attached")
    key = {"id": "key_0", "label": "Earlier", "fingerprint": "0123456789"}
    with page.expect_response("**/v1/keys*"):
        held[0].fulfill(json={"items": [key], "next": None})
    page.evaluate("new Promise((resolve) => setTimeout(resolve, 100))")
    assert page.locator("#mark-key option").all_inner_texts() == ([] if forgotten else ["Later (01234567)"])


def test_nothing_of_it_stays_once_the_key_is_forgotten(page: Page) -> None:
    asset = an_asset(1, label="Secret garden")
    jobs = [
        a_job(2, state="succeeded", result={"asset_id": asset["id"]}),
        a_job(1, state="running", stage="Secret garden"),
    ]
    keys = [{"id": "key_1", "label": "Secret garden", "fingerprint": "0123456789"}]
    lists(page, assets=[asset], claims=[a_claim(1, headline="Secret garden")], jobs=jobs, keys=keys)
    for view, held in (
        ("Mark", "#mark-key"),
        ("Check", "#check-asset"),
        ("Library", "#claims"),
        ("Jobs", "#jobs-ended"),
    ):
        page.get_by_role("link", name=view, exact=True).click()
        page.locator(held, has_text="Secret garden").wait_for(state="attached")
    page.route(
        "**/v1/claims/cl_1", lambda route: route.fulfill(status=404, json={"title": "Secret garden", "status": 404})
    )
    page.evaluate("location.hash = '#claim/cl_1'")
    page.get_by_role("alert").wait_for()
    page.evaluate("import('/static/js/session.js').then(({ nameJob }) => nameJob('job_1', 'Secret garden'))")
    assert page.evaluate("sessionStorage.length") == 2
    page.get_by_role("button", name="Forget API key").click()
    page.get_by_label("API key", exact=True).wait_for()
    assert "Secret" not in page.content()
    assert page.evaluate("sessionStorage.length") == 0


def test_names_are_text_and_long_ones_stay_in_their_place(browser: Browser, served: Served) -> None:
    for label in (HOSTILE, LONG_NAME):
        context = browser.new_context(viewport=PHONE)
        page = context.new_page()
        named = {"asset_label": label, "copy_name": label, "suspects": [label], "headline": label, "finding": label}
        failure = {"title": label, "detail": label, "type": "about:blank", "status": 422}
        jobs = [a_job(2, state="running", stage=label), a_job(1, state="failed", problem=failure)]
        asset = an_asset(1, label=label, copy_name=label)
        lists(page, assets=[asset], claims=[a_claim(1, asset_id=asset["id"], **named)], jobs=jobs)
        page.goto(served.address)
        sign_in(page, served.api_key)
        for view, list_name in (("Library", "#claims"), ("Jobs", "#jobs-ended"), ("Check", "#check-asset")):
            page.get_by_role("link", name=view, exact=True).click()
            page.locator(list_name, has_text=label[:60]).wait_for(state="attached")
            assert page.evaluate("[window.hit, document.querySelectorAll('main [onerror]').length]") == [None, 0]
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), f"{view} scrolls sideways"
            shoot(page, f"names-{view}-{label[:4].strip('<')}")
        context.close()
