"""A few Gaussians far away cost the others nothing in any format, and are reported where they are left out."""

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial import cKDTree

from engine.formats import FORMATS, encode_model, read_model
from engine.formats.file_writing import loss_note, stray_rows
from engine.model import SH_C0, GaussianModel
from tests.formats.models import random_model


def scene(strays: int, reach: float, n: int = 3000) -> tuple[GaussianModel, npt.NDArray[np.intp]]:
    """A dense model one unit across, Gaussians of a hundredth, with some strays; and their rows."""
    rng = np.random.default_rng(strays)
    means = rng.uniform(-0.5, 0.5, (n, 3)).astype(np.float32)
    rows = np.sort(rng.choice(n, strays, replace=False))
    means[rows] = reach * (1 + rng.uniform(0, 1, (strays, 3)))
    sizes = rng.normal(np.log(0.01), 0.3, (n, 3)).astype(np.float32)
    return random_model(0, n).with_(means=means, log_scales=sizes), rows


@pytest.mark.parametrize("strays", [1, 3, 6])
@pytest.mark.parametrize("reach", [1e3, 1e5, 1e6, -1e11])
@pytest.mark.parametrize("format", FORMATS)
def test_strays_cost_the_others_nothing(format: str, reach: float, strays: int) -> None:
    model, rows = scene(strays, reach)
    near = np.delete(model.means, rows, axis=0)
    back = read_model(encode_model(model, format)).model.means
    kept = back[np.abs(back).max(axis=1) > 10]
    back = back[np.abs(back).max(axis=1) < 10]
    assert len(back) == len(near)
    alone = read_model(encode_model(model.take(np.delete(np.arange(3000), rows)), format)).model.means
    lost, least = (float(cKDTree(found).query(near)[0].max()) for found in (back, alone))
    assert lost <= max(least * 1.5, 0.01 / 20)
    notes = [note for note in loss_note(model, format) if "left out" in note]
    if len(kept):
        assert notes == []
        order = np.argsort(kept[:, 0]), np.argsort(model.means[rows, 0])
        np.testing.assert_allclose(kept[order[0]], model.means[rows][order[1]], rtol=1e-3)
    else:
        (note,) = notes
        assert note.startswith(f"{strays} Gaussian")
        assert f"row {rows[0]})" in note
    assert (len(kept) == strays) or format not in ("ply", "splat", "glb")


def test_what_belongs_to_a_scene_is_no_stray() -> None:
    model, rows = scene(6, 1e6)
    assert np.flatnonzero(stray_rows(model.means)).tolist() == rows.tolist()
    sky = model.means.copy()
    sky[:300] *= 1e6  # every tenth: no accident
    assert not stray_rows(sky).any()
    assert not stray_rows(np.zeros((100, 3), np.float32)).any()
    assert not stray_rows(random_model(0, 500).means).any()


@pytest.mark.parametrize("format", FORMATS)
def test_a_stray_color_costs_its_neighbors_nothing_in_silence(format: str) -> None:
    model = random_model(0, 2000)
    told = [note for note in loss_note(model, format) if "levels" in note]
    assert told == []
    model.sh[700, 0] = [3000, -2000, 0]
    back = read_model(encode_model(model, format)).model
    found, meant = (np.clip(0.5 + SH_C0 * each.sh[:, 0], 0, 1) for each in (back, model))
    there = cKDTree(back.means).query(model.means)[1]
    off = np.flatnonzero(np.abs(found[there] - meant).max(axis=1) > 5 / 255)
    told = [note for note in loss_note(model, format) if "levels" in note]
    assert len(told) == (len(off) > 0) == (format == "compressed.ply")
    assert all(int(note.split()[0]) >= len(off) > 100 for note in told)
