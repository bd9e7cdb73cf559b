"""The view Check beside its main job: whose file something is, and suspects by what they hold."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from tests.service.web.conftest import PHONE, shoot
from tests.service.web.journey import PLANT
from tests.service.web.stock import png

if TYPE_CHECKING:
    from playwright.sync_api import Page, Route

URN = "urn:c2pa:3fad1ead-8ed5-44d0-873b-ea5f58adea82"


def test_whose_file_is_this(page: Page, tmp_path: Path) -> None:
    """What the service answers is shown, with a way to each manifest; the file goes as it is."""
    page.get_by_role("link", name="Check", exact=True).click()
    page.get_by_text("Whose file is this?").click()
    page.get_by_label("Model or picture of unknown origin").set_input_files(PLANT)
    find = page.get_by_role("button", name="Find its credentials")
    find.click()
    page.get_by_text("No published model of this service looks like this file.").wait_for()
    sent: list[bytes | None] = []

    def answer(route: Route) -> None:
        sent.append(route.request.post_data_buffer)
        scores = ((URN, 100), (URN.replace("3", "4"), 50))
        route.fulfill(json={"matches": [{"manifestId": urn, "similarityScore": score} for urn, score in scores]})

    page.route("**/v1/matches/byContent", answer)
    picture = tmp_path / "gefunden auf ä.jpg"
    picture.write_bytes(png(7))
    page.get_by_label("Model or picture of unknown origin").set_input_files(picture)
    find.click()
    link = page.locator("#whose-found a").first
    link.wait_for()
    assert sent == [png(7)]
    assert link.get_attribute("href") == f"/v1/manifests/{URN.replace(':', '%3A')}"
    assert "clearly alike" in link.inner_text()
    assert "close to the limit" in page.locator("#whose-found a").last.inner_text()
    shoot(page, "whose")
    page.set_viewport_size(PHONE)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    shoot(page, "whose-phone")
    page.route(
        "**/v1/matches/byContent", lambda route: route.fulfill(status=413, json={"title": "Too large", "status": 413})
    )
    find.click()
    page.locator("#whose-found .problem", has_text="Too large").wait_for()


def test_a_suspect_is_what_it_holds(page: Page, tmp_path: Path) -> None:
    """A picture named .ply goes as a picture; a model among pictures is refused by its name."""
    asked: list[Any] = []

    def refuse(route: Route) -> None:
        asked.append(route.request.post_data_json)
        route.fulfill(status=409, json={"title": "stop here", "status": 409})

    page.route("**/v1/verify", refuse)
    page.get_by_role("link", name="Check", exact=True).click()
    picture, model = tmp_path / "picture.ply", tmp_path / "model.png"
    picture.write_bytes(png(8))
    model.write_bytes(PLANT.read_bytes()[: 32 * 500])
    files = page.get_by_label("Suspect model or screenshots")
    start = page.get_by_role("button", name="Check the suspect")
    for file, member in ((picture, "image_upload_ids"), (model, "upload_id")):
        files.set_input_files(file)
        start.click()
        page.locator("#check-problem", has_text="stop here").wait_for()
        assert member in asked.pop()
    files.set_input_files([picture, model])
    start.click()
    page.locator("#check-problem", has_text="model.png is no picture").wait_for()
    assert not asked
