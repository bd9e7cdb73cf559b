"""A picture out of a real viewer is read, whatever it was shown over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.flows.embed.profiles import profile
from engine.flows.verify.search import VerifyConfig, verify_images
from engine.flows.views.camera_rig import make_rig
from engine.formats import write_model
from engine.lab.evaluate.marked_scene import MarkedScene, mark_scene
from engine.raster import RasterSettings, render
from tests.pictures.rolling import rolled
from tests.viewers.shooting import CHROMIUM, studio
from tests.viewers.taking import background, filed

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="viewers run in Chromium, which is not here (Debian: chromium)"),
]

PLANT = Path(__file__).parents[1] / "data" / "plant.splat"
SIZE = (800, 600)


@pytest.fixture(scope="module")
def marked() -> MarkedScene:
    return mark_scene(PLANT, profile("fast", landmark_views=24))


@pytest.mark.long
def test_screenshots_of_the_supersplat_viewer_claim(marked: MarkedScene, tmp_path: Path) -> None:
    write_model(marked.marked, tmp_path / "plant.ply")
    camera = make_rig(marked.marked, 1, *SIZE, jitter=np.array([[0.2, 0.6, 0.1, 0.5]]))[0]
    rng = np.random.default_rng(0)
    with studio(tmp_path) as booth:
        for antialiased in (False, True):
            with booth.viewer("supersplat", "plant.ply", SIZE, aa=antialiased) as viewer:
                own = np.clip(render(marked.marked, camera, settings=RasterSettings(antialiased=antialiased)), 0, 1)
                shot = viewer.shoot(camera, 0.01, 100.0)
                assert -10.0 * np.log10(np.square(own - shot.black).mean()) > 33.0  # as it draws, so do we
                over = viewer.shoot(rolled(camera, np.pi), 0.01, 100.0) if antialiased else None
            for kind, seen in [("gradient", over)] if antialiased else [("white", shot), ("photo", shot)]:
                assert seen is not None
                picture = filed(seen.over(background(kind, rng, SIZE)), "jpeg 80")
                claim = verify_images([picture], marked.opened, VerifyConfig()).claim
                assert claim.verdict.value == "marked", (kind, antialiased, claim.z)
                assert claim.bit_accuracy == 1.0
