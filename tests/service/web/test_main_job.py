"""The whole job in a browser: mark, turn, download, steal, check, read the claim."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from engine.cli.app import run
from tests.scenes import sparse_plant
from tests.service.web.conftest import shoot
from tests.service.web.journey import LONG, check, embed, make_key, pane_pictures

if TYPE_CHECKING:
    from playwright.sync_api import Page


def test_mark_turn_download_steal_check(page: Page, tmp_path: Path) -> None:
    plant = tmp_path / "plant.splat"
    plant.write_bytes(sparse_plant())

    # 1. mark
    assert make_key(page, "Studio").strip()
    embed(page, plant, "Potted plant", "Acme")
    page.get_by_role("heading", name="Marking the model").wait_for()
    page.locator(".progress-done li").first.wait_for(timeout=LONG)  # a stage is listed once it took a while
    shoot(page, "mark-progress")
    page.get_by_role("heading", name="Marked: Potted plant").wait_for(timeout=LONG)
    assert float(page.locator(".facts dd").first.inner_text().split(" dB")[0]) >= 46.9
    assert page.evaluate("document.activeElement.tagName") == "H1"

    # 2. both models are drawn, alike, and turn together
    before = pane_pictures(page)
    for picture in before:
        assert picture.std() > 20, "an empty view"
    assert 0 < np.abs(before[0] - before[1]).mean() < 4, "the views differ in more than the mark"
    shoot(page, "mark-result")
    page.locator(".viewer-stage").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    after = pane_pictures(page)
    assert np.abs(after[0] - before[0]).mean() > 5, "it did not turn"
    assert np.abs(after[0] - after[1]).mean() < 4, "the views do not turn together"
    box = page.locator(".viewer-stage").bounding_box()
    assert box
    page.mouse.move(box["x"] + 300, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 120, box["y"] + 240, steps=4)
    page.mouse.up()
    dragged = pane_pictures(page)
    assert np.abs(dragged[0] - after[0]).mean() > 5, "dragging did nothing"
    assert np.abs(dragged[0] - dragged[1]).mean() < 4

    # 3. files
    page.locator(".preview img").wait_for()
    assert page.locator(".preview img").evaluate("image => image.decode().then(() => image.naturalWidth)") > 300
    marked, record = tmp_path / "marked.ply", tmp_path / "plant.record"
    page.get_by_label("Format of the marked model").select_option("ply")
    for button, path in (("Download the marked model", marked), ("Download the record", record)):
        with page.expect_download() as download:
            page.get_by_role("button", name=button).click()
        assert download.value.suggested_filename.startswith("Potted-plant-marked.")
        download.value.save_as(path)
    assert record.stat().st_size > 100_000

    # 4. stolen: cut, turned, scaled, in another format
    turned, stolen = tmp_path / "turned.ply", tmp_path / "stolen.spz"
    assert run(["attack", "similarity", str(marked), str(turned), "--seed", "3"]) == 0
    assert run(["attack", "crop", str(turned), str(stolen), "--strength", "0.25", "--seed", "3"]) == 0
    assert check(page, stolen) == "Watermark found"
    result = page.locator("#check-result")
    assert "copy made for “Acme”" in result.inner_text()
    assert "32/32 bits" in result.inner_text().replace("\n", " ")
    assert result.locator(".scale.met").count() == 1
    assert page.evaluate("document.activeElement.textContent") == "Watermark found"
    result.locator("figcaption", has_text="Suspect").get_by_text("stolen.spz").wait_for()
    shoot(page, "claim")

    # 5. the claim leaves the house
    with page.expect_download() as download:
        result.get_by_role("button", name="Download the signed claim").click()
    assert Path(download.value.path()).read_text().count(".") == 2
    with page.context.expect_page() as opened:
        result.get_by_role("button", name="Open the full report").click()
    opened.value.wait_for_url("blob:**")
    assert "Acme" in opened.value.locator("body").inner_text()
    opened.value.screenshot(path=tmp_path / "report.png")
    opened.value.close()
    with page.context.expect_page() as opened:
        result.get_by_role("button", name="Open the error rates").click()
    opened.value.get_by_role("heading", name="How often the method errs").wait_for()
    assert opened.value.locator("main").evaluate("(element) => getComputedStyle(element).maxWidth") == "860px"
    opened.value.close()

    result.get_by_text("Request a takedown from a platform").click()
    result.get_by_label("Address of the copy").fill("https://a.example/1\nnonsense")
    pack = result.get_by_role("button", name="Download the takedown pack")
    pack.click()
    result.get_by_role("alert").wait_for()
    result.get_by_label("Address of the copy").fill("https://a.example/1\nhttps://a.example/2")
    result.get_by_label("Your statement").fill("Bought & copied")
    shoot(page, "claim-pack")
    with page.expect_download() as download:
        pack.click()
    assert download.value.suggested_filename.endswith("-pack.zip")
    with zipfile.ZipFile(download.value.path()) as archive:
        notice = next(archive.read(name).decode() for name in archive.namelist() if name.endswith("notice.txt"))
        assert any(name.endswith("comparison.png") for name in archive.namelist())
    assert "Found at: https://a.example/2" in notice
    assert "| Bought & copied" in notice

    # 6. both are found again
    page.get_by_role("link", name="Library").click()
    page.locator("#claims a").first.wait_for()
    shoot(page, "library")
    page.locator("#assets a", has_text="Potted plant").first.click()
    page.get_by_role("heading", name="Potted plant").wait_for()
    assert "all kept" in page.locator("#view-item").inner_text()
    page.go_back()
    page.locator("#claims a").first.click()
    page.get_by_role("heading", name="Watermark found").wait_for()

    # 7. an original that was never marked
    assert check(page, plant) == "Your unmarked original"
    shoot(page, "claim-negative")

    # 8. a picture of the marked one that shows too little, and then another one beside it
    page.get_by_role("link", name="Library").click()
    weak, further = tmp_path / "weak.jpg", tmp_path / "further.png"
    assert run(["render", str(marked), str(further)]) == 0
    Image.open(further).convert("RGB").resize((200, 150), Image.Resampling.LANCZOS).save(weak, quality=15)
    assert check(page, weak) == "Inconclusive"
    shoot(page, "claim-short-for-real")
    page.get_by_label("Further pictures").set_input_files(further)
    page.get_by_role("button", name="Check all pictures together").click()
    page.get_by_role("heading", name="Watermark found").wait_for(timeout=LONG)
    page.locator("figcaption", has_text="Suspect").get_by_text("weak.jpg and 1 more").wait_for()
