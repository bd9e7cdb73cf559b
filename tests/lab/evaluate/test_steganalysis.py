"""Steganalysis: detectors against known answers, regions and their features, and the quick study."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model
from engine.lab.evaluate.cell_runner import run_cells
from engine.lab.evaluate.intervals import area, area_interval
from engine.lab.evaluate.report import write_report
from engine.lab.evaluate.steganalysis.copy_differences import compare_copies
from engine.lab.evaluate.steganalysis.learned_detectors import divide, float_born, measure_regions
from engine.lab.evaluate.steganalysis.picture_detectors import DETECTORS, chi_square, fuse, replace_lsb
from engine.lab.evaluate.steganalysis.steganalysis_study import STUDY
from engine.lab.evaluate.study import Options
from engine.raster import render

PLANT = str(Path(__file__).parents[2] / "data" / "plant.splat")
TRAIN = Path(PLANT).parent / "train_1000.ply"


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    """8-bit renders of the shipped scene."""
    model = read_model(PLANT).model
    images = [np.clip(render(model, camera), 0, 1) for camera in make_rig(model, 6, 400, 400)]
    return [np.rint(255 * image).astype(np.uint8) for image in images]


@pytest.mark.parametrize("name", ["primary sets", "sample pairs", "RS"])
@pytest.mark.parametrize("rate", [0.0, 0.05, 0.25, 0.5, 1.0])
def test_the_true_rate_is_recovered(name: str, rate: float, pictures: list[np.ndarray]) -> None:
    rng = np.random.default_rng(1)
    found = [fuse(replace_lsb(picture, rate, rng))[name] for picture in pictures]
    assert np.mean(found) == pytest.approx(rate, abs=0.02 if rate < 1 else 0.05)


def test_chi_square_sees_what_is_written_from_the_top(pictures: list[np.ndarray]) -> None:
    rng = np.random.default_rng(2)
    picture = np.ascontiguousarray(pictures[0][..., 1])
    assert chi_square(picture) < 0.01
    half = picture.copy()
    half[:200] = replace_lsb(picture[:200], 1.0, rng)
    assert 0.3 < chi_square(half) < 0.7
    assert chi_square(replace_lsb(picture, 1.0, rng)) > 0.9


def test_the_fusion_tells_embedded_pictures(pictures: list[np.ndarray]) -> None:
    rng = np.random.default_rng(3)
    plain = np.array([fuse(picture)["fusion"] for picture in pictures])
    lsb = np.array([fuse(replace_lsb(picture, 0.05, rng))["fusion"] for picture in pictures])
    assert area(plain, lsb) > 0.99
    assert (lsb < 0.05).all()  # three of four see 5 %, chi-square none


def test_flat_and_odd_pictures() -> None:
    flat = np.full((16, 16), 7, dtype=np.uint8)
    assert all(abs(detect(flat)) < 1e-9 for detect in DETECTORS.values())
    with pytest.raises(InputError, match="uint8"):
        DETECTORS["RS"](np.zeros((8, 8)))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="H, W, C"):
        fuse(flat)


def test_replaced_bits_change_half_of_their_places() -> None:
    picture = np.full((400, 400, 3), 100, dtype=np.uint8)
    changed = replace_lsb(picture, 0.5, np.random.default_rng(0)) != picture
    assert changed.mean() == pytest.approx(0.25, abs=0.005)


def test_area_is_the_probability_of_the_right_order() -> None:
    assert area(np.array([0.0, 1.0]), np.array([2.0, 3.0])) == 1.0
    assert area(np.array([0.0, 1.0]), np.array([0.0, 1.0])) == 0.5
    assert area(np.array([2.0]), np.array([1.0])) == 0.0


def test_the_interval_covers_the_area() -> None:
    rng, covered = np.random.default_rng(4), 0
    for trial in range(60):
        scores = zip(rng.normal(0, 1, (40, 1)), rng.normal(0.5, 1, (40, 1)), strict=True)
        low, high = area_interval(list(scores), draws=150, seed=trial)
        covered += low <= 0.638 <= high  # Phi(0.5 / sqrt 2)
    assert covered >= 52


def test_regions_are_compact_and_see_a_lattice() -> None:
    model = read_model(PLANT).model
    regions = divide(model)
    sizes = np.bincount(regions.label, minlength=regions.count)
    assert sizes.min() > 256
    assert sizes.max() < 1024
    spread = np.linalg.norm([model.means[regions.label == 3].std(axis=0)])
    assert spread < 0.3 * np.linalg.norm(model.means.std(axis=0))
    born = float_born(model, np.random.default_rng(0))
    moved, old = born.sh[:, 0] - model.sh[:, 0], model.sh[:, 0]
    clipped = (old == old.max(axis=0)) | (old == old.min(axis=0))
    assert np.abs(moved[~clipped]).max() < 0.0071  # half a step of 1 / 255 in DC units
    white = old[:, 0] == old[:, 0].max()
    assert white.sum() > 10 * (old[:, 0] == np.sort(np.unique(old[:, 0]))[-2]).sum(), "plant is clipped at white"
    assert moved[white, 0].min() > -0.0071, "what was clipped lay beyond"
    assert 0.1 < moved[white, 0].mean() < 0.6
    lattice, floats = measure_regions(model, regions), measure_regions(born, regions)
    assert lattice.shape == floats.shape
    assert np.isfinite(lattice).all()
    assert lattice[:, -6].min() > 0.9  # nearly every value occurs often
    assert floats[:, -6].max() < 0.1
    np.testing.assert_array_equal(measure_regions(model, regions), lattice)


@pytest.mark.long
def test_the_quick_study_reports_what_it_finds(tmp_path: Path) -> None:
    options = Options((PLANT,), quick=True)
    rows = run_cells(STUDY.cells(options), tmp_path / "cells")
    said = write_report(STUDY, rows, options, tmp_path)
    bars = {bar["what"]: bar for bar in said["bars"]}
    assert all(bar["met"] for name, bar in bars.items() if name.startswith("Detectors check"))
    assert said["summary"]["auc"]["fusion"]["low"] <= 0.6
    learned = [row for row in rows if "auc" in row]
    assert {row["classifier"] for row in learned} == {"logistic regression", "random forest"}
    assert all(row["low"] <= row["auc"] <= row["high"] for row in learned)


def test_cells_of_several_scenes() -> None:
    names = [cell.name for cell in STUDY.cells(Options(("/a/x.splat", "/b/x.sog")))]
    assert len(set(names)) == len(names)
    assert "insider-1-own-format" in names
    some = [cell.name for cell in STUDY.cells(Options(("/a/x.splat", "/b/x.sog"), settings=("differences",)))]
    assert some == ["differences-0", "differences-1"]
    with pytest.raises(InputError, match="no part 'copies'"):
        STUDY.cells(Options(("/a/x.splat",), settings=("copies",)))


@pytest.mark.slow
def test_differences_of_copies_tell_their_own_layer_and_not_the_owners() -> None:
    rows = {row["secret"]: row for row in compare_copies(str(TRAIN), "fast", "floats", 2, 0)}
    assert rows["check: signs"]["difference_auc"] > 0.75
    assert rows["signs"]["difference_auc"] == pytest.approx(0.5, abs=0.02)
    assert rows["signs"]["cases"] == 12_000
    assert rows["borders"]["difference_auc"] == pytest.approx(0.5, abs=0.05)
