"""The service as a user starts it, and a real Chromium in front of it."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
SCREENSHOTS = Path(__file__).parents[3] / "out" / "screenshots"  # ignored by git, kept to be looked at
DESKTOP, PHONE = {"width": 1280, "height": 900}, {"width": 360, "height": 740}


@dataclass(frozen=True)
class Served:
    """A running service."""

    address: str
    api_key: str


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """`mark3dgs serve` with one worker in an empty folder."""
    if CHROMIUM is None:
        pytest.skip("the page is tested in Chromium, which is not here (Debian: apt-get install chromium)")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    folder = tmp_path_factory.mktemp("served")
    log = folder / "log.txt"
    environment = {k: v for k, v in os.environ.items() if not k.startswith("MARK3DGS_")}
    environment |= {"MARK3DGS_DATA_DIR": str(folder / "data")}
    with log.open("w") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "service.cli", "serve", "--port", str(port)],
            cwd=Path(__file__).parents[3], env=environment, stdout=out, stderr=subprocess.STDOUT,
        )  # fmt: skip
    address = f"http://127.0.0.1:{port}"
    try:
        wait_until_up(process, address, log)
        found = re.search(r"mk_\w+", log.read_text())
        assert found, log.read_text()
        yield Served(address, found[0])
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            raise


def wait_until_up(process: subprocess.Popen[bytes], address: str, log: Path) -> None:
    """Return once /healthz answers."""
    for _ in range(300):
        try:
            urllib.request.urlopen(f"{address}/healthz", timeout=1).close()
            return
        except OSError:
            assert process.poll() is None, log.read_text()
            time.sleep(0.1)
    raise AssertionError(f"not up within 30 s: {log.read_text()}")


@pytest.fixture(scope="session")
def browser(served: Served) -> Iterator[Browser]:
    """Chromium, drawing in software, without a way to any other host."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM,
            args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
                  "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"],
        )  # fmt: skip
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
    page.get_by_label("API key").fill(api_key)
    page.get_by_role("button", name="Continue").click()
    page.locator("#views").wait_for()


def shoot(page: Page, name: str) -> None:
    """Keep a picture of the whole page."""
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SCREENSHOTS / f"{name}.png", full_page=True)
