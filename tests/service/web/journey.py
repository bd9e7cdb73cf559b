"""The main job as a user does it, in steps that the tests share."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from playwright.sync_api import Locator, Page

PLANT = Path(__file__).parents[2] / "data" / "plant.splat"
LONG = 240_000
"""Milliseconds that a job may take on a busy machine."""


def make_key(page: Page, label: str) -> str:
    """Make an owner key with a copy; what the copy holds."""
    page.locator("#key-choice:visible, #key-make:visible").wait_for()
    if page.get_by_role("button", name="Create a new key").is_visible():
        page.get_by_role("button", name="Create a new key").click()
    page.get_by_label("Name of the new key").fill(label)
    with page.expect_download() as download:
        page.get_by_role("button", name="Create the key", exact=True).click()
    assert download.value.suggested_filename.endswith(".key")
    return Path(download.value.path()).read_text()


def embed(page: Page, file: Path, label: str, copy: str = "") -> None:
    """Fill in the form and send it off."""
    page.get_by_label("Model file").set_input_files(file)
    page.get_by_label("Name optional").fill(label)
    page.get_by_label("Recipient").fill(copy)
    page.get_by_label("Fast").check()
    page.get_by_role("button", name="Mark the model").click()


def check(page: Page, *files: Path) -> str:
    """Check a suspect; the verdict."""
    page.get_by_role("link", name="Check", exact=True).click()
    page.locator("#check-form:visible, #check-result:visible").first.wait_for()  # the page turns after the click
    if page.get_by_role("button", name="Check another").is_visible():
        page.get_by_role("button", name="Check another").click()
    page.get_by_label("Suspect model or screenshots").set_input_files(files)
    page.get_by_role("button", name="Check the suspect").click()
    page.locator("#check-result h1, #check-problem .problem").first.wait_for(timeout=LONG)
    return page.locator("#check-result h1, #check-problem .problem").first.inner_text()


def pane_pictures(page: Page) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What both views of the 3D viewer show, without their names."""
    page.locator(".viewer-stage[data-ready]").wait_for(timeout=LONG)
    page.evaluate("new Promise((r) => setTimeout(r, 700))")  # sorting ends a few frames after a move
    left, right = (pixels(page.locator(".pane").nth(k))[60:] for k in (0, 1))
    return left, right


def pixels(locator: Locator) -> NDArray[np.float64]:
    """A picture of an element, 0..255."""
    return np.asarray(Image.open(io.BytesIO(locator.screenshot())).convert("RGB"), dtype=np.float64)
