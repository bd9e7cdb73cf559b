"""Deleting fills the hole from its neighbors: covered, in the right colors, and only where a surface was."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.edits.edit import EditTrack, delete
from engine.lab.sim.edits.inpainting import (
    complete_cells,
    enclosed,
    fit_surface,
    harmonic_fill,
    inpaint,
    ring_around,
    smooth,
)
from engine.lab.sim.edits.selection import select_sphere
from engine.model import Bool, Float32, Float64, GaussianModel, look_at
from engine.numerics.image_metrics import psnr
from engine.raster import prepare_view, render
from tests.lab.sim.edits.conftest import project_selection

CAMERA = look_at([0.2, 0.3, 3], [0, 0, 0], [0, 1, 0], 260.0, 160, 160)


def opacity(model: GaussianModel) -> Float32:
    return prepare_view(model, CAMERA).render(np.ones((len(model), 1), np.float32))[1]


@pytest.fixture(scope="module")
def patch(sheet: GaussianModel) -> Bool:
    return select_sphere(sheet, [0.1, 0.05, 0], 0.25)


def test_a_hole_is_covered_in_the_colors_around_it(sheet: GaussianModel, patch: Bool) -> None:
    hole = project_selection(sheet, patch, CAMERA) > 0.5
    cut, filled = delete(sheet, patch).model, inpaint(sheet, patch)
    assert opacity(sheet)[hole].mean() > 0.97
    assert opacity(cut)[hole].mean() < 0.4
    assert opacity(filled.model)[hole].mean() > 0.95
    images = [render(m, CAMERA) for m in (sheet, cut, filled.model)]
    whole, empty, mended = (np.where(hole[..., None], i, 0) for i in images)
    assert psnr(whole, mended) > psnr(whole, empty) + 6
    around = ~hole & (opacity(cut) > 0.9)
    assert psnr(images[0] * around[..., None], images[2] * around[..., None]) > 30  # the rim is not smeared over


def test_stripes_go_on_through_the_hole(sheet: GaussianModel, patch: Bool) -> None:
    filled = inpaint(sheet, patch)
    assert filled.edit.filling is not None
    new = filled.edit.filling
    truth = 0.5 * np.sin(12 * new.means[:, 0])
    assert np.corrcoef(truth, new.sh[:, 0, 1])[0, 1] > 0.6
    assert np.abs(new.means[:, 2] - 0.1 * new.means[:, 0] ** 2).max() < 0.02  # on the curved sheet


def test_filling_is_part_of_the_edit(sheet: GaussianModel, patch: Bool) -> None:
    filled, edit = inpaint(sheet, patch)
    again = inpaint(sheet, patch).model
    assert np.array_equal(filled.means, again.means)
    assert np.array_equal(filled.sh, again.sh)
    back = edit.undo(filled)
    assert np.array_equal(back.means, sheet.means)
    assert (edit.origin()[-len(edit.filling or ()) :] == -1).all()
    track = EditTrack((edit,))
    assert len(track.replay(sheet)) == len(filled)
    assert len(track.replay(sheet, filling=False)) == (~patch).sum()


def test_what_stood_out_leaves_no_hole(sheet: GaussianModel) -> None:
    """A block on the sheet's rim, half of it beyond: the sheet does not grow."""
    from engine.lab.sim.model_placement import join

    rng = np.random.default_rng(5)
    block = sheet.take(np.arange(600))
    block = block.with_(means=rng.uniform([0.8, -0.2, 0.05], [1.2, 0.2, 0.45], (600, 3)))
    both = join(sheet, block)
    chosen = np.arange(len(both)) >= len(sheet)
    filled = inpaint(both, chosen)
    new = filled.edit.filling
    assert new is None or (new.means[:, 0] < 1.1).all()


def test_lonely_gaussians_leave_nothing_to_fill(sheet: GaussianModel) -> None:
    few = sheet.take(np.arange(30))
    assert inpaint(few, np.arange(30) < 20).edit.filling is None
    with pytest.raises(InputError, match="no model"):
        inpaint(few, np.ones(30, dtype=np.bool_))


def test_the_surface_is_the_sheet(sheet: GaussianModel, patch: Bool) -> None:
    ring = sheet.take(ring_around(sheet, patch, 0.2, 50))
    surface = fit_surface(ring, sheet.take(patch), 0.25, np.random.default_rng(0))
    assert surface is not None
    inside = sheet.means[patch]
    assert np.abs(surface.local(inside)[:, 2]).max() < 0.01
    assert np.allclose(surface.world(surface.local(inside)), inside, atol=1e-6)
    slope = np.stack([-0.2 * inside[:, 0], np.zeros(len(inside)), np.ones(len(inside))], axis=1)
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    assert np.abs((surface.normals(surface.local(inside)[:, :2]) * slope).sum(axis=1)).min() > 0.999


def striped() -> tuple[Float64, Bool, Bool]:
    colors = np.repeat((np.arange(40) % 8 < 4)[None, :, None], 40, axis=0) * np.ones(3)
    wanted = np.zeros((40, 40), dtype=np.bool_)
    wanted[14:26, 14:26] = True
    return colors, ~wanted, wanted


def test_cells_are_completed_along_the_texture() -> None:
    colors, known, wanted = striped()
    source, done = complete_cells(colors, known, wanted)
    assert np.array_equal(done, wanted)
    copied = colors[source[done][:, 0], source[done][:, 1]]
    assert known[source[done][:, 0], source[done][:, 1]].all()
    assert (copied == colors[done]).all(axis=1).mean() > 0.95
    assert not complete_cells(colors, np.zeros_like(known), wanted)[1].any()


def test_only_surrounded_cells_are_enclosed() -> None:
    known = np.zeros((20, 20), dtype=np.bool_)
    known[5:15, 5:15] = True
    known[8:12, 8:12] = False
    found = enclosed(known, ~known)
    assert found[8:12, 8:12].all()
    assert found.sum() == 16


def test_harmonic_filling_is_harmonic() -> None:
    y, x = np.mgrid[:16, :16].astype(np.float64)
    values = np.stack([x, y, x * x - y * y], axis=-1)  # all harmonic on the grid
    wanted = np.zeros((16, 16), dtype=np.bool_)
    wanted[4:12, 5:11] = True
    filled = harmonic_fill(values, ~wanted, wanted)
    assert np.abs(filled - values).max() < 1e-2
    assert np.abs(smooth(np.ones((16, 16, 1)), ~wanted, 2.0) - 1).max() < 1e-9
