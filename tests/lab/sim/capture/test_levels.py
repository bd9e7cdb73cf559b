"""Levels of detail and half precision: smaller, still alike, and still marked."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.embed.profiles import profile
from engine.flows.verify.search import verify_model
from engine.lab.evaluate.marked_scene import MarkedScene, mark_scene
from engine.lab.sim.capture.lod import (
    LevelOfDetail,
    half_precision,
    level_of_quality,
    levels_of_detail,
    rank_by_weight,
    reduce_to,
)
from engine.model import Camera, Float64, GaussianModel, look_at
from engine.numerics.image_metrics import psnr
from engine.raster import render
from engine.watermark.claim import Verdict

PLANT = Path(__file__).parents[3] / "data" / "plant.splat"


@cache
def plant() -> MarkedScene:
    """The real scene, marked; extraction is informed: it uses the owner's record."""
    return mark_scene(PLANT, profile("fast", landmark_views=0))


def front(model: GaussianModel, size: int = 96, far: float = 3.2) -> list[Camera]:
    center = np.median(model.means, axis=0)
    eyes = [center + np.array([far * np.cos(a), -0.15 * far, far * np.sin(a)]) for a in (0.3, 2.4, 4.5)]
    return [look_at(eye, center, (0, -1, 0), 1.1 * size, size, size) for eye in eyes]


def weights_slowly(model: GaussianModel, camera: Camera) -> Float64:
    """Sum of squared weights: the image is linear in colors, so each Gaussian alone in white shows its weight."""
    total = np.zeros(len(model))
    for k in range(len(model)):
        colors = np.zeros((len(model), 1, 3), np.float32)
        colors[:] = -0.5 / 0.28209479177387814
        colors[k] = 0.5 / 0.28209479177387814
        total[k] = (render(model.with_(sh=colors), camera)[..., 0].astype(np.float64) ** 2).sum()
    return total


def test_ranking_is_what_leaving_out_costs(model: GaussianModel) -> None:
    cameras = front(model, 32)[:2]
    few = model.take(np.arange(0, len(model), 8))
    expected = sum(weights_slowly(few, camera) for camera in cameras)
    np.testing.assert_allclose(rank_by_weight(few, cameras), expected, rtol=1e-3, atol=1e-4)


def test_the_best_are_kept_in_their_order(model: GaussianModel) -> None:
    ranking = np.random.default_rng(0).permutation(len(model)).astype(float)
    level, kept = reduce_to(model, ranking, 100, merge=False)
    np.testing.assert_array_equal(kept, np.flatnonzero(ranking >= len(model) - 100))
    np.testing.assert_array_equal(level.means, model.means[kept])


def test_merging_keeps_the_moments() -> None:
    """Two equal discs side by side become the one that has their mean, their spread and their mass."""
    scale = np.log(np.array([[0.2, 0.1, 0.01]] * 2, np.float32))
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1))
    sh = np.array([[[0.2, 0.4, 0.6]], [[0.4, 0.4, 0.0]]], np.float32)
    pair = GaussianModel(np.array([[0, 0, 0], [0.2, 0, 0]], np.float32), scale, quats, np.full(2, -1.0), sh)
    (one, kept) = reduce_to(pair, np.array([2.0, 1.0]), 1)
    assert kept.tolist() == [0]
    np.testing.assert_allclose(one.means, [[0.1, 0.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(one.scales, [[np.sqrt(0.2**2 + 0.1**2), 0.1, 0.01]], rtol=1e-5)
    np.testing.assert_allclose(one.sh, [[[0.3, 0.4, 0.3]]], atol=1e-6)
    mass = pair.opacities[0] * 0.2 * 0.1 * 2
    np.testing.assert_allclose(one.opacities * one.scales[:, 0] * one.scales[:, 1], mass, rtol=1e-5)
    far = pair.with_(means=np.array([[0, 0, 0], [9.0, 0, 0]], np.float32))
    np.testing.assert_array_equal(reduce_to(far, np.array([2.0, 1.0]), 1)[0].means, far.means[:1])
    unseen = reduce_to(pair, np.array([2.0, 0.0]), 1)[0]
    np.testing.assert_array_equal(unseen.means, pair.means[:1])


@cache
def levels(merge: bool) -> dict[float, LevelOfDetail]:
    shares, cameras = (0.5, 0.25, 0.1), front(plant().marked, 200, 1.3)
    return dict(zip(shares, levels_of_detail(plant().marked, shares, cameras=cameras, merge=merge), strict=True))


def test_levels_are_alike_and_merging_helps() -> None:
    n = len(plant().marked)
    for share, least in ((0.5, 34.0), (0.25, 28.0), (0.1, 22.0)):
        merged, dropped = levels(True)[share], levels(False)[share]
        assert len(merged.model) == len(merged.kept) == len(dropped.model) == round(share * n)
        assert merged.psnr_db > least
        assert merged.psnr_db > dropped.psnr_db + 0.5


def test_a_level_by_quality(model: GaussianModel) -> None:
    cameras = front(model)
    level = level_of_quality(model, 30.0, cameras=cameras)
    assert 10 < len(level.model) < 0.9 * len(model)
    assert level.psnr_db >= 30.0
    truth = [render(model, camera) for camera in cameras]
    worst = min(psnr(a, render(level.model, c)) for a, c in zip(truth, cameras, strict=True))
    assert worst == pytest.approx(level.psnr_db)
    assert len(level_of_quality(model, 38.0, cameras=cameras).model) > len(level.model)
    assert level_of_quality(model, 500.0, cameras=cameras).model is model


@pytest.mark.parametrize(("share", "merge"), [(0.5, True), (0.1, True), (0.1, False)])
def test_the_mark_survives_levels_of_detail(share: float, merge: bool) -> None:
    claim = verify_model(levels(merge)[share].model, plant().opened).claim
    assert claim.verdict is Verdict.MARKED
    assert claim.bit_accuracy == 1.0


def test_half_precision_rounds_and_the_mark_survives() -> None:
    marked = plant().marked
    half = half_precision(marked)
    assert not np.array_equal(half.means, marked.means)
    for name in ("means", "log_scales", "opacity_logits", "sh"):
        array = getattr(half, name)
        np.testing.assert_array_equal(array, array.astype(np.float16).astype(np.float32))
        np.testing.assert_allclose(array, getattr(marked, name), rtol=2.0**-11, atol=2.0**-24)
    np.testing.assert_allclose(np.linalg.norm(half.quats, axis=1), 1.0, atol=1e-6)
    claim = verify_model(half, plant().opened).claim
    assert claim.verdict is Verdict.MARKED
    assert claim.bit_accuracy == 1.0


def test_refused(model: GaussianModel) -> None:
    with pytest.raises(InputError, match=r"means: row 0 is too large for float16"):
        half_precision(model.with_(means=model.means * 1e5))
    with pytest.raises(InputError, match=r"a level of 0\.0 of"):
        levels_of_detail(model, [0.0])
    with pytest.raises(InputError, match="no levels"):
        levels_of_detail(model.take(np.arange(0)))
    with pytest.raises(InputError, match="a level of 501 Gaussians of 500"):
        reduce_to(model, np.ones(500), 501)
    with pytest.raises(InputError, match=r"ranking has shape \(3,\)"):
        reduce_to(model, np.ones(3), 2)
    with pytest.raises(InputError, match="psnr_db is nan"):
        level_of_quality(model, float("nan"))
