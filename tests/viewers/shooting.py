"""Pictures of a model file as a viewer in headless Chromium draws it: `Studio`.

Shown over black and over white, a picture tells how much of every pixel is the model's; what it looks like over
anything else follows (`Shot.over`).
"""

from __future__ import annotations

import functools
import http.server
import shutil
import subprocess
import tarfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from engine.model import Camera, Float32

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
ROOT = Path(__file__).parents[2]
PACKAGES = ROOT / "out" / "packages"  # ignored by git
VIEWERS = {
    "supersplat": "@playcanvas/supersplat-viewer@1.36.2",
    "spark": "@sparkjsdev/spark@2.2.0",
    "three": "three@0.187.0",  # what Spark builds on
}
"""Fetched from the npm registry once; of the first only the style sheet is needed, for its interface."""
TURNED = np.diag([-1.0, -1.0, 1.0])
"""Both viewers show a model turned by half a turn about z: it was captured with y down."""
MOST_MILLISECONDS = 180_000
"""For one picture: a viewer that draws on the processor shares it with what else runs."""


@dataclass(frozen=True, eq=False)
class Shot:
    """What a viewer shows from one camera, (H, W, 3) each, 0 to 1: over black and over white."""

    black: Float32
    white: Float32

    @property
    def alpha(self) -> Float32:
        """(H, W) how much of each pixel is the model's, or the interface's."""
        return np.asarray(np.clip(1.0 - (self.white - self.black).mean(axis=2), 0.0, 1.0), dtype=np.float32)

    def over(self, background: Float32) -> Float32:
        """The same over a picture (H, W, 3) or a colour (3,)."""
        return np.clip(self.black + (1.0 - self.alpha[..., None]) * background, 0.0, 1.0).astype(np.float32)


@dataclass(eq=False)
class Viewer:
    """A page that shows one model."""

    page: Page
    width: int
    height: int

    def shoot(self, camera: Camera, near: float, far: float) -> Shot:
        """What it shows from a camera of its size in the model's frame; `near` and `far` in scene units."""
        return Shot(*(self._draw(camera, near, far, level) for level in (0.0, 1.0)))

    def _draw(self, camera: Camera, near: float, far: float, level: float) -> Float32:
        assert (camera.width, camera.height) == (self.width, self.height)
        # OpenGL's camera looks along -z with y up.
        to_world = TURNED @ camera.viewmat[:3, :3].T @ np.diag([1.0, -1.0, -1.0])
        pose = {
            "position": (TURNED @ camera.position).tolist(),
            "rotation": Rotation.from_matrix(to_world).as_quat().tolist(),
            "fov": float(np.degrees(2.0 * np.arctan(0.5 * camera.height / camera.K[1, 1]))),
            "near": near,
            "far": far,
            "background": [level] * 3,
        }
        self.page.evaluate("(pose) => window.look(pose)", pose)
        png = self.page.screenshot(type="png", timeout=MOST_MILLISECONDS)
        return np.asarray(Image.open(BytesIO(png)).convert("RGB"), dtype=np.float32) / 255.0


@dataclass(eq=False)
class Studio:
    """A browser, and a server of the viewers' code and of the models in a folder."""

    browser: Browser
    address: str

    @contextmanager
    def viewer(
        self, kind: str, model: str, size: tuple[int, int], *, tone: str = "none", ui: bool = False, aa: bool = False
    ) -> Iterator[Viewer]:
        """A viewer, "supersplat" or "spark", of a model file of the folder, `size` width and height in pixels.

        `tone`, `ui` and `aa` (antialiasing) are SuperSplat's.
        """
        page = self.browser.new_page(viewport={"width": size[0], "height": size[1]})
        try:
            page.goto(f"{self.address}/pages/{kind}.html")
            page.wait_for_function("window.ready === true")
            options: dict[str, Any] = {"tone": tone, "ui": ui, "aa": aa}
            page.evaluate("([url, name, o]) => window.show(url, name, o)", [f"/models/{model}", model, options])
            yield Viewer(page, *size)
        finally:
            page.close()


@contextmanager
def studio(models: Path) -> Iterator[Studio]:
    """A browser for the model files of a folder."""
    from playwright.sync_api import sync_playwright

    viewer = ROOT / "service/web/viewer"  # SuperSplat's, as the page has it; its style sheet is fetched
    roots = {"pages": Path(__file__).parent / "pages", "viewer": viewer, "packages": PACKAGES, "models": models}
    handler = functools.partial(_Files, roots)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars"]
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
            yield Studio(browser, f"http://127.0.0.1:{server.server_port}")
            browser.close()
    finally:
        server.shutdown()


def fetch_viewers() -> bool:
    """Lay the viewers' packages where the studio serves them; False where there is no npm, nothing to
    fetch from, or a Python (before 3.11.4) that cannot unpack what strangers packed within a folder."""
    PACKAGES.mkdir(parents=True, exist_ok=True)
    for name, package in VIEWERS.items():
        if (PACKAGES / name).exists():
            continue
        if shutil.which("npm") is None or not hasattr(tarfile, "data_filter"):
            return False
        done = subprocess.run(["npm", "pack", package], cwd=PACKAGES, capture_output=True, text=True, check=False)
        if done.returncode:
            return False
        archive = PACKAGES / done.stdout.split()[-1]
        with tarfile.open(archive) as file:
            file.extractall(PACKAGES, filter="data")
        archive.unlink()
        (PACKAGES / "package").rename(PACKAGES / name)
    return True


class _Files(http.server.SimpleHTTPRequestHandler):
    """Files below several roots, by the first part of the path."""

    def __init__(self, roots: dict[str, Path], *args: Any, **named: Any) -> None:
        self._roots = roots
        super().__init__(*args, **named)

    def translate_path(self, path: str) -> str:
        first, _, rest = path.split("?")[0].lstrip("/").partition("/")
        root = self._roots.get(first, Path("/nowhere"))
        wanted = (root / rest).resolve()
        return str(wanted if wanted.is_relative_to(root.resolve()) else root / "missing")

    def log_message(self, format: str, *args: Any) -> None:
        pass
