"""Discs made from the real plant: they look like it, carry a mark and keep it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.embed.profiles import profile
from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model
from engine.lab.evaluate.marked_scene import bench_key
from engine.lab.sim.variants import variant_table as measuring
from engine.lab.sim.variants.synthetic import fit_colors, widen
from engine.lab.sim.variants.variant_table import measure_discs
from engine.model import GaussianModel, look_at
from engine.numerics.gaussians import flatten
from engine.numerics.image_metrics import psnr
from engine.raster import RasterSettings, render

SCENE = Path(__file__).parents[3] / "data" / "plant.splat"


@pytest.fixture(scope="module")
def plant() -> GaussianModel:
    """Every fourth Gaussian: enough of a scene to be fast."""
    whole = read_model(SCENE).model
    return whole.take(np.arange(0, len(whole), 4))


def likeness(model: GaussianModel, original: GaussianModel) -> float:
    cameras = make_rig(original, 3, 256, 256, jitter=np.random.default_rng(9).random((3, 4)))
    return float(np.mean([psnr(render(original, c), render(model, c)) for c in cameras]))


@pytest.fixture(scope="module")
def made(plant: GaussianModel) -> GaussianModel:
    """As `make_discs`, for small pictures."""
    cameras = make_rig(plant, 4, 256, 256)
    return fit_colors(widen(flatten(plant), cameras), plant, cameras, 2)


def test_every_step_brings_the_discs_closer(plant: GaussianModel, made: GaussianModel) -> None:
    cameras = make_rig(plant, 4, 256, 256)
    flat = flatten(plant)
    wide = widen(flat, cameras)
    assert likeness(wide, plant) > likeness(flat, plant) + 2.0
    assert likeness(made, plant) > likeness(wide, plant) + 0.1
    assert likeness(made, plant) > 30.0
    assert made.is_flat
    for name in ("means", "quats", "log_scales", "opacity_logits"):
        np.testing.assert_array_equal(getattr(made, name), getattr(wide, name))


def test_widening_adds_the_dilation() -> None:
    """A disc that faces the camera gets 0.3 square pixels; the one behind it is hidden."""
    disc = GaussianModel(
        np.array([[0, 0, 2.0], [0, 0, -2.0]]),
        np.log([[0.01, 0.02, 1e-8]] * 2),
        np.array([[1.0, 0, 0, 0]] * 2),
        np.zeros(2),
        np.zeros((2, 1, 3)),
    )
    wide = widen(disc, [look_at((0, 0, 0), (0, 0, 1), (0, -1, 0), 100.0, 64, 64)])
    pixels = wide.scales[:, :2] * 100.0 / 2.0
    np.testing.assert_allclose(pixels[0] ** 2, [0.5**2 + 0.3, 1.0**2 + 0.3], rtol=1e-5)
    np.testing.assert_allclose(wide.scales[1, :2], [0.01, 0.02], rtol=1e-6)
    assert RasterSettings().eps2d == 0.3
    with pytest.raises(InputError, match="camera"):
        widen(disc, [])


def test_the_row_of_table_4(plant: GaussianModel, made: GaussianModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measuring, "DISC_MODEL_CASES", (("crop to 10 %", "crop", 0.1), (".spz", "convert", "spz")))
    monkeypatch.setattr(measuring, "DISC_PICTURE_CASES", (("one picture, JPEG 30", "jpeg", 30.0),))
    config = profile("fast", views=3, view_size=320, landmark_views=0, psnr_db=50.0)
    row = measure_discs(plant, made, bench_key(0), config, views=2, size=256)
    assert [reading.case for reading in row.readings] == [
        "none",
        "none, renders at the pose key",
        "crop to 10 %",
        ".spz",
        "one picture",
        "one picture, drawn as thin Gaussians",
        "one picture, JPEG 30",
    ]
    assert {reading.verdict for reading in row.readings} == {"marked"}
    assert row.readings[0].bit_accuracy == 1.0
    assert row.readings[0].z > 50
    assert 0.0 < row.psnr_drop < 0.3
    assert row.psnr_before > 30.0
    assert 50.0 < row.psnr_of_mark < 56.0
    with pytest.raises(InputError, match="two scales"):
        measure_discs(plant, plant, bench_key(0), config)
