"""Selections: boxes, spheres, segments and masks lifted to 3-D."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.lab.sim.edits.selection import lift_masks, mask_shares, segment, segment_at, select_box, select_sphere
from engine.lab.sim.model_placement import join
from engine.model import GaussianModel, look_at
from tests.lab.sim.edits.conftest import project_selection


def test_a_box_holds_what_is_inside(sheet: GaussianModel) -> None:
    chosen = select_box(sheet, [-0.5, -2, -2], [0.25, 2, 2])
    assert (chosen == ((sheet.means[:, 0] >= -0.5) & (sheet.means[:, 0] <= 0.25))).all()


def test_a_box_can_be_turned(sheet: GaussianModel) -> None:
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # x of the box is y of the scene
    plain = select_box(sheet, [-0.5, -0.1, -2], [0.5, 0.1, 2])
    turned = select_box(sheet, [-0.5, -0.1, -2], [0.5, 0.1, 2], turn)
    assert np.abs(sheet.means[plain, 1]).max() <= 0.1
    assert np.abs(sheet.means[turned, 0]).max() <= 0.1
    assert np.abs(sheet.means[turned, 1]).max() > 0.4


@pytest.mark.parametrize(("low", "high"), [([1, 0, 0], [0, 1, 1]), ([0, 0, np.nan], [1, 1, 1]), ([0, 0], [1, 1])])
def test_malformed_boxes_are_refused(sheet: GaussianModel, low: list[float], high: list[float]) -> None:
    with pytest.raises(InputError):
        select_box(sheet, low, high)


def test_a_box_refuses_mirrors(sheet: GaussianModel) -> None:
    with pytest.raises(InputError, match="proper"):
        select_box(sheet, [-1, -1, -1], [1, 1, 1], np.diag([1.0, 1.0, -1.0]))


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


def test_color_parts_what_lies_in_one_place() -> None:
    model = two_lumps()
    model = model.with_(means=model.means * np.array([0, 1, 1]))
    by_color = segment(model, 2, color_weight=3.0)
    assert (by_color == (np.arange(300) >= 200)).all()
    assert not (segment(model, 2, color_weight=0.0) == by_color).all()


def test_segments_follow_the_seed_alone(scene: MarkedScene) -> None:
    first, again = segment(scene.marked, 8, seed=1), segment(scene.marked, 8, seed=1)
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


def test_a_higher_threshold_keeps_off_the_edge(sheet: GaussianModel) -> None:
    camera = look_at([0, 0, 4], [0, 0, 0], [0, 1, 0], 300.0, 160, 160)
    mask = np.zeros((160, 160), dtype=np.bool_)
    mask[:, :80] = True
    wide, narrow = (lift_masks(sheet, [camera], [mask], threshold=t) for t in (0.05, 0.95))
    assert narrow.sum() < wide.sum()
    assert not (narrow & ~wide).any()
    share, weight = mask_shares(sheet, [camera], [mask])
    assert ((share > 0.05) & (share < 0.95) & (weight > 0)).any()


def test_hidden_gaussians_follow_their_neighbors(sheet: GaussianModel) -> None:
    behind = sheet.with_(means=sheet.means - np.array([0, 0, 0.02]))
    camera = look_at([0, 0, 4], [0, 0, 0], [0, 1, 0], 300.0, 160, 160)
    opaque = sheet.with_(opacity_logits=np.full(len(sheet), 9.0))
    both = join(opaque, behind)
    mask = np.zeros((160, 160), dtype=np.bool_)
    mask[:, 80:] = True
    seen = lift_masks(both, [camera], [mask], hidden=False)
    all_ = lift_masks(both, [camera], [mask])
    extra = all_ & ~seen
    assert extra.sum() > 100
    assert (both.means[extra, 0] > -0.1).all()


@pytest.mark.parametrize("threshold", [0.0, 1.0, np.nan])
def test_masks_refuse_bad_thresholds(sheet: GaussianModel, threshold: float) -> None:
    camera = look_at([0, 0, 4], [0, 0, 0], [0, 1, 0], 300.0, 32, 32)
    with pytest.raises(InputError, match="threshold"):
        lift_masks(sheet, [camera], [np.ones((32, 32))], threshold=threshold)


def test_masks_refuse_other_sizes_and_values(sheet: GaussianModel) -> None:
    camera = look_at([0, 0, 4], [0, 0, 0], [0, 1, 0], 300.0, 32, 32)
    with pytest.raises(InputError, match="shape"):
        lift_masks(sheet, [camera], [np.ones((32, 31))])
    with pytest.raises(InputError, match="0 to 1"):
        lift_masks(sheet, [camera], [np.full((32, 32), 255)])
    with pytest.raises(InputError, match="one mask"):
        lift_masks(sheet, [camera], [])
