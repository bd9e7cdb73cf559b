"""From `mark3dgs serve` to a takedown pack for a screenshot, as a new user: `python -m tests.service.web.walk FOLDER`.

Prints the seconds since the start at which each step was done; pictures of the page and the pack stay in the folder.
A person reads and types besides. `--picture docs/page.png` makes the guide's picture anew.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model
from engine.raster import render
from engine.usecases.files import write_picture
from tests.service import serving
from tests.service.web.conftest import ARGUMENTS, CHROMIUM, DESKTOP, sign_in
from tests.service.web.journey import LONG, PLANT, check, embed, make_key, pane_pictures

SHOWN = {"x": 0, "y": 0, "width": 1280, "height": 1100}


def walk(folder: Path, picture: Path | None = None) -> dict[str, float]:
    """Seconds by step. `picture`: where the page after marking is to be shown."""
    began, done = time.perf_counter(), dict[str, float]()
    served = serving.start(folder)
    done["the service answers"] = time.perf_counter() - began
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
            page = browser.new_page(accept_downloads=True, viewport=DESKTOP)

            def step(name: str) -> None:
                done[name] = time.perf_counter() - began
                page.screenshot(path=folder / f"{len(done):02}-{name.replace(' ', '-')}.png", full_page=True)

            page.goto(served.address)
            sign_in(page, served.api_key)
            step("signed in")
            page.get_by_label("Name of the owner").fill("Studio Acme")
            page.get_by_role("button", name="Save", exact=True).click()
            page.get_by_role("heading", name="Mark a model").wait_for()
            step("owner named")
            make_key(page, "Studio")
            step("owner key made")
            embed(page, PLANT, "Potted plant", "Acme")
            page.get_by_role("heading", name="Marked: Potted plant").wait_for(timeout=LONG)
            step("marked")
            if picture is not None:
                pane_pictures(page)  # once both are drawn
                page.evaluate("scrollTo(0, 0)")
                page.screenshot(path=folder / "page.png", clip=SHOWN, full_page=True)
                small = Image.open(folder / "page.png").convert("RGB").resize((960, 825), Image.Resampling.LANCZOS)
                small.quantize(256).save(picture, optimize=True)
            with page.expect_download() as download:
                page.get_by_role("button", name="Download the marked model").click()
            download.value.save_as(folder / "marked.splat")
            step("downloaded")
            model = read_model(folder / "marked.splat").model
            shot, posted = render(model, make_rig(model, 1, 1200, 800)[0]), folder / "posted.jpg"
            write_picture(np.clip(shot, 0.0, 1.0), posted, posted, 85)
            assert check(page, posted) == "Watermark found"
            step("screenshot checked")
            page.get_by_text("Request a takedown from a platform").click()
            page.get_by_label("Address of the copy").fill("https://example.com/stolen/1")
            with page.expect_download() as download:
                page.get_by_role("button", name="Download the takedown pack").click()
            download.value.save_as(folder / "pack.zip")
            step("takedown pack")
    finally:
        served.stop()
    return done


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="an empty or new one")
    parser.add_argument("--picture", type=Path, help="PNG file: the page after marking")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    sys.stdout.write(json.dumps(walk(arguments.folder, arguments.picture), indent=1) + "\n")
