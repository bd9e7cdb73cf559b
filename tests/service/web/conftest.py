"""The service as a user starts it, and a real Chromium in front of it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.service import serving
from tests.service.serving import Served
from tests.service.web.stock import ask

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
ARGUMENTS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-compositing",  # pages are painted without it at half the processor time
    "--in-process-gpu",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
]
SCREENSHOTS = Path(__file__).parents[3] / "out" / "screenshots"  # ignored by git, kept to be looked at
DESKTOP, PHONE = {"width": 1280, "height": 900}, {"width": 360, "height": 740}


@pytest.fixture(scope="package")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """`mark3dgs serve` with one worker in an empty folder."""
    if CHROMIUM is None:
        pytest.skip("the page is tested in Chromium, which is not here (Debian: apt-get install chromium)")
    made = serving.start(tmp_path_factory.mktemp("served"), lean=True)
    ask(made, "/v1/me", "PATCH", {"name": "Test Studio"})  # what the page asks first, else
    yield made
    made.stop()


@pytest.fixture(scope="package")
def browser(served: Served) -> Iterator[Browser]:
    """Chromium, drawing in software, without a way to any other host. Not for the session: a process can have one
    Playwright at a time, and tests of other packages start their own."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


@dataclass
class Watched:
    """A page, and what it did that a user would not see."""

    page: Page
    requests: list[str]
    errors: list[str]


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A fresh profile at desktop width."""
    context = browser.new_context(viewport=DESKTOP, accept_downloads=True)
    context.set_default_timeout(20_000)
    yield context
    context.close()


@pytest.fixture
def watched(context: BrowserContext, served: Served) -> Iterator[Watched]:
    """The page as first opened. Whatever a test does: no request to another host, no error in its scripts."""
    watched = Watched(context.new_page(), [], [])
    context.on("request", lambda request: watched.requests.append(request.url))
    watched.page.on("pageerror", lambda error: watched.errors.append(str(error)))
    watched.page.on(
        "console", lambda said: watched.errors.append(said.text) if "Content Security" in said.text else None
    )
    watched.page.goto(served.address)
    yield watched
    assert watched.errors == []
    away = [u for u in watched.requests if not u.startswith((served.address, "blob:", "data:"))]
    assert away == []
    assert len(watched.requests) > 5


@pytest.fixture
def page(watched: Watched, served: Served) -> Page:
    """The page, signed in."""
    sign_in(watched.page, served.api_key)
    return watched.page


def sign_in(page: Page, api_key: str) -> None:
    """Give the API key."""
    page.get_by_label("API key", exact=True).fill(api_key)
    page.get_by_role("button", name="Continue").click()
    page.locator("#views").wait_for()


def shoot(page: Page, name: str) -> None:
    """Keep a picture of the whole page."""
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SCREENSHOTS / f"{name}.png", full_page=True)
