"""Pictures of a claim: suspect and asset from one camera, their difference, and nothing that is unmarked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from engine.flows.embed.copy_mark import mark_again
from engine.flows.records.opened_record import open_record
from engine.formats import read_model, write_model
from engine.lab.sim.attacks import model_attack
from engine.raster import render
from engine.watermark.keys import OwnerKey
from service.work.pictures import EVIDENCE_SIZE, SUSPECT_GAIN, choose_view
from tests.service.work.conftest import FOREIGN, KEY, Ask, Marked, shot_of


def drawn(folder: Path, name: str) -> np.ndarray:
    with Image.open(folder / f"{name}.png") as picture:
        return np.asarray(picture.convert("RGB"), dtype=np.float64) / 255.0


@pytest.mark.long
def test_the_marked_model_is_drawn_again_from_its_record(marked: Marked) -> None:
    opened = open_record(marked.path("record").read_bytes(), OwnerKey(bytes.fromhex(KEY)))
    again, published = mark_again(opened), read_model(marked.path("model")).model
    for name, close in (("sh", 0.015), ("means", 1e-4), ("log_scales", 0.002)):
        ours, theirs, plain = (getattr(model, name) for model in (again, published, opened.reference))
        # Bytes stay bytes, and clipped ones where they are.
        assert np.quantile(np.abs(ours - theirs), 0.98 if name == "sh" else 1.0) < close, name
        assert np.abs(plain - theirs).max() > 1.5 * close, f"{name} carries nothing: the test is blind"


def test_a_moved_piece_is_seen_from_the_camera_of_the_asset(verify: Ask, marked: Marked, tmp_path: Path) -> None:
    model = read_model(marked.path("model")).model
    piece = model_attack("crop").apply(model_attack("similarity").apply(model, 3.0, rng=1), 0.3, rng=2)
    write_model(piece, tmp_path / "piece.ply")
    reply = verify(model=str(tmp_path / "piece.ply"))
    assert reply["files"].keys() == {"suspect", "asset", "difference", "heatmap"}
    suspect, asset, difference = (drawn(tmp_path, name) for name in ("suspect", "asset", "difference"))
    assert suspect.shape == asset.shape == difference.shape
    there = suspect.max(axis=2) > 0.3
    assert there.mean() > 0.02
    assert np.median(np.abs(suspect - asset)[there]) < 0.01
    np.testing.assert_allclose(difference, np.clip(0.5 + SUSPECT_GAIN * (suspect - asset), 0, 1), atol=0.03)


def test_no_picture_shows_the_unmarked_model(verify: Ask, marked: Marked, tmp_path: Path) -> None:
    """The suspect is the leaked original: it alone looks so."""
    verify(model=str(marked.original))
    published, original = (read_model(path).model for path in (marked.path("model"), marked.original))
    camera = choose_view(published, *EVIDENCE_SIZE)
    asset = drawn(tmp_path, "asset")
    far, near = (np.square(asset - np.clip(render(m, camera), 0, 1)).mean() for m in (original, published))
    assert near < 3e-6  # rounding to 8 bits alone has 1.3e-6
    assert far > 3 * near


@pytest.mark.parametrize("turned", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_screenshot_lies_over_the_asset(verify: Ask, marked: Marked, tmp_path: Path, turned: bool) -> None:
    """Over another background, cut, and turned over left to right."""
    shot = shot_of(marked, tmp_path, 0.35, lambda image: np.ascontiguousarray(image[60:, ::-1]) if turned else image)
    empty = tmp_path / "empty.png"
    Image.new("RGB", (90, 90), (90, 120, 60)).save(empty)
    assert "difference" in verify(images=[str(empty), str(shot)])["files"]
    with Image.open(tmp_path / "suspect.png") as suspect:
        assert suspect.size[0] == 800, "the picture that shows it is shown, not the first"
    difference = drawn(tmp_path, "difference")
    grey = np.abs(difference - 0.5).max(axis=2) < 0.15
    assert grey.mean() > 0.9


@pytest.mark.long
def test_what_was_not_laid_over_has_no_difference(verify: Ask, tmp_path: Path) -> None:
    assert verify(model=str(FOREIGN))["files"].keys() == {"suspect", "asset", "heatmap"}
