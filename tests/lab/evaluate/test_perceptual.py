"""The perceptual study: its metrics know what is the same, its quick version reports what was promised."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from engine.errors import InputError
from engine.lab.evaluate.cell_runner import run_cells
from engine.lab.evaluate.perceptual.perceptual_cells import flip_map, load_lpips, picture_text, sliding_mean
from engine.lab.evaluate.perceptual.perceptual_study import STUDY
from engine.lab.evaluate.report import write_report
from engine.lab.evaluate.study import Options

PLANT = str(Path(__file__).parents[2] / "data" / "plant.splat")


def test_flip_of_the_same_picture_is_nothing() -> None:
    image = np.random.default_rng(0).random((64, 80, 3)).astype(np.float32)
    assert flip_map(image, image).shape == (64, 80)
    assert flip_map(image, image).max() == 0.0
    assert flip_map(np.zeros_like(image), np.ones_like(image)).mean() > 0.9
    slight = flip_map(image, np.clip(image + 0.01, 0, 1)).mean()
    assert 0.0 < slight < flip_map(image, np.clip(image + 0.1, 0, 1)).mean()


def test_the_mean_of_each_square_is_that_of_its_pixels() -> None:
    plane = np.random.default_rng(1).random((9, 7)).astype(np.float32)
    means = sliding_mean(plane, 4)
    assert means.shape == (6, 4)
    assert means[5, 2] == pytest.approx(plane[5:9, 2:6].mean())
    assert sliding_mean(plane, 20) == pytest.approx(plane.mean())


def test_a_row_can_hold_a_picture() -> None:
    image = np.zeros((40, 60, 3), dtype=np.float32)
    image[:, 30:, 0] = 1.0
    back = np.asarray(Image.open(io.BytesIO(base64.b64decode(picture_text(image)))).convert("RGB"))
    assert back.shape == (40, 60, 3)
    assert back[20, 50, 0] > 200 > back[20, 10, 0] + 100


def test_lpips_says_what_it_lacks(tmp_path: Path) -> None:
    (tmp_path / "weights.pth").write_bytes(b"no weights")
    with pytest.raises(InputError, match=r"lpips|not the weights"):
        load_lpips(str(tmp_path / "weights.pth"))


@pytest.mark.long
def test_the_quick_study_keeps_its_bars(tmp_path: Path) -> None:
    options = Options((PLANT,), quick=True)
    rows = run_cells(STUDY.cells(options), tmp_path / "cells")
    said = write_report(STUDY, rows, options, tmp_path)
    assert [bar["met"] for bar in said["bars"]] == [True, True]
    free = [row for row in rows if row["kind"] == "free"]
    assert all(row["psnr"] > 44 and row["ssim"] > 0.997 and row["ms_ssim"] > 0.998 for row in free)
    assert all(0 < row["flip"] < 0.05 and row["flip"] < row["flip_99"] and row["lpips"] is None for row in free)
    assert {"figures/worst-patch-0.svg"} <= set(said["figures"])
    assert "LPIPS was not measured" in (tmp_path / "report.html").read_text()
    assert json.loads((tmp_path / "results.json").read_text())["summary"]["flip"] > 0


def test_each_scene_and_profile_is_a_cell() -> None:
    cells = STUDY.cells(Options(("/a/x.splat", "/b/x.splat"), seed=3, lpips_weights="/w.pth"))
    assert len({cell.name for cell in cells}) == len(cells) == 6
    assert {cell.arguments["lpips_weights"] for cell in cells} == {"/w.pth"}
    assert {cell.arguments["seed"] for cell in cells} == {3}
