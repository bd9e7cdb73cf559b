"""Selections: boxes, spheres, segments and masks lifted to 3-D."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.lab.sim.edits import selection
from engine.lab.sim.edits.selection import (
    LEAST_WEIGHT,
    lift_masks,
    mask_shares,
    segment,
    segment_at,
    select_box,
    select_sphere,
)
from engine.lab.sim.model_placement import join
from engine.model import GaussianModel, look_at
from tests.lab.sim.edits.conftest import project_selection


def test_a_box_holds_what_is_inside(sheet: GaussianModel) -> None:
    chosen = select_box(sheet, [-0.5, -2, -2], [0.25, 2, 2])
    assert (chosen == ((sheet.means[:, 0] >= -0.5) & (sheet.means[:, 0] <= 0.25))).all()


@pytest.mark.parametrize(("low", "high"), [([1, 0, 0], [0, 1, 1]), ([0, 0, np.nan], [1, 1, 1]), ([0, 0], [1, 1])])
def test_malformed_boxes_are_refused(sheet: GaussianModel, low: list[float], high: list[float]) -> None:
    with pytest.raises(InputError):
        select_box(sheet, low, high)


def test_a_sphere_holds_what_is_near(sheet: GaussianModel) -> None:
    chosen = select_sphere(sheet, [0.3, 0, 0], 0.4)
    distance = np.linalg.norm(sheet.means - np.array([0.3, 0, 0]), axis=1)
    assert 0 < chosen.sum() < len(sheet)
    assert distance[chosen].max() <= 0.4 < distance[~chosen].min()
    with pytest.raises(InputError, match="radius"):
        select_sphere(sheet, [0, 0, 0], 0.0)


def two_lumps() -> GaussianModel:
    """200 red Gaussians left, 100 blue ones right."""
    rng = np.random.default_rng(0)
    right = np.arange(300) >= 200
    means = 0.1 * rng.standard_normal((300, 3)) + np.where(right, 2.0, -2.0)[:, None] * [1, 0, 0]
    sh = np.where(right[:, None], [-1.0, -1, 1], [1.0, -1, -1])[:, None]
    f = np.float32
    return GaussianModel(
        means.astype(f),
        np.full((300, 3), -3, f),
        np.tile(np.array([1, 0, 0, 0], f), (300, 1)),
        np.full(300, 3, f),
        sh.astype(f),
    )


def test_segments_part_lumps_and_come_by_size() -> None:
    model = two_lumps()
    labels = segment(model, 2)
    assert (labels == (np.arange(300) >= 200)).all()
    assert (segment_at(model, labels, [2.0, 0, 0]) == (np.arange(300) >= 200)).all()
    assert segment_at(model, labels, [[2.0, 0, 0], [-2.0, 0, 0]]).all()


def test_color_parts_what_lies_in_one_place(monkeypatch: pytest.MonkeyPatch) -> None:
    model = two_lumps()
    model = model.with_(means=model.means * np.array([0, 1, 1]))
    for weight, parted in ((3.0, True), (0.0, False)):
        monkeypatch.setattr(selection, "COLOR_WEIGHT", weight)
        assert bool((segment(model, 2) == (np.arange(300) >= 200)).all()) == parted


def test_segments_are_the_same_each_time(scene: MarkedScene) -> None:
    first, again = segment(scene.marked, 8), segment(scene.marked, 8)
    assert (first == again).all()
    assert len(np.unique(first)) == 8
    with pytest.raises(InputError, match="segments"):
        segment(scene.marked, 0)


def test_masks_lift_to_the_gaussians_they_show(sheet: GaussianModel) -> None:
    truth = select_sphere(sheet, [0, 0, 0], 0.4)
    cameras = [look_at([x, 0.3, 4], [0, 0, 0], [0, 1, 0], 300.0, 160, 160) for x in (-1, 0, 1)]
    masks = [project_selection(sheet, truth, camera) >= 0.5 for camera in cameras]
    found = lift_masks(sheet, cameras, masks)
    hits = (found & truth).sum()
    assert hits / found.sum() > 0.95
    assert hits / truth.sum() > 0.95


def test_hidden_gaussians_follow_their_neighbors(sheet: GaussianModel) -> None:
    behind = sheet.with_(means=sheet.means - np.array([0, 0, 0.02]))
    camera = look_at([0, 0, 4], [0, 0, 0], [0, 1, 0], 300.0, 160, 160)
    opaque = sheet.with_(opacity_logits=np.full(len(sheet), 9.0))
    both = join(opaque, behind)
    mask = np.zeros((160, 160), dtype=np.bool_)
    mask[:, 80:] = True
    _, weight = mask_shares(both, [camera], [mask])
    extra = lift_masks(both, [camera], [mask]) & (weight < LEAST_WEIGHT)
    assert extra.sum() > 100
    assert (both.means[extra, 0] > -0.1).all()


def test_masks_refuse_other_sizes_and_values(sheet: GaussianModel) -> None:
    camera = look_at([0, 0, 4], [0, 0, 0], [0, 1, 0], 300.0, 32, 32)
    with pytest.raises(InputError, match="shape"):
        lift_masks(sheet, [camera], [np.ones((32, 31))])
    with pytest.raises(InputError, match="0 to 1"):
        lift_masks(sheet, [camera], [np.full((32, 32), 255)])
    with pytest.raises(InputError, match="one mask"):
        lift_masks(sheet, [camera], [])
