"""Attacks that must not change the look do not; the others do. Rendered, in dB."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from engine.flows.views.camera_rig import measure_extent
from engine.lab.sim.attacks import MODEL_ATTACKS, model_attack
from engine.model import Camera, Float32, GaussianModel, look_at
from engine.numerics.image_metrics import psnr
from engine.raster import render
from tests.lab.sim.test_model_attacks import similarity_of


@pytest.fixture(scope="module")
def camera(model: GaussianModel) -> Camera:
    extent = measure_extent(model)
    eye = extent.center + extent.radius * np.array([1.5, -1.2, 2.5])
    return look_at(eye, extent.center, (0, -1, 0), 110.0, 112, 96)


@pytest.fixture(scope="module")
def before(model: GaussianModel, camera: Camera) -> Float32:
    picture = render(model, camera)
    assert picture.std() > 0.1
    return picture


def moved_camera(camera: Camera, model: GaussianModel, moved: GaussianModel) -> Camera:
    """The camera that sees the moved model as `camera` sees the model."""
    scale, R, shift = similarity_of(model, moved)
    middle = model.means.mean(axis=0, dtype=np.float64)
    viewmat = np.eye(4)
    viewmat[:3, :3] = camera.viewmat[:3, :3] @ R.T
    eye = scale * R @ (camera.position - middle) + middle + shift
    viewmat[:3, 3] = -viewmat[:3, :3] @ eye
    return Camera(viewmat, camera.K, camera.width, camera.height)


@pytest.mark.parametrize(
    ("name", "strength"), [("rotate", 30), ("rotate", 150), ("scale", 4), ("translate", 3), ("similarity", 3)]
)
def test_a_moved_model_looks_the_same_from_the_moved_camera(
    name: str, strength: float, model: GaussianModel, camera: Camera, before: Float32
) -> None:
    moved = model_attack(name).apply(model, strength, rng=4)
    followed = moved_camera(camera, model, moved)
    assert psnr(before, render(moved, followed)) > 60
    assert psnr(before, render(moved, camera)) < 30
    if name in ("rotate", "similarity"):  # the test would notice SH or quaternions left unturned
        assert psnr(before, render(moved.with_(sh=model.sh), followed)) < 45
        assert psnr(before, render(moved.with_(quats=model.quats), followed)) < 45


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_mirrored_model_looks_mirrored_from_the_other_side(
    axis: int, model: GaussianModel, camera: Camera, before: Float32
) -> None:
    center = measure_extent(model).center
    mirrored = model_attack("mirror").apply(model, "xyz"[axis])
    over = np.ones(3)
    over[axis] = -1
    np.testing.assert_allclose(mirrored.means - center, (model.means - center) * over, atol=2e-3)
    eye = center + over * (camera.position - center)
    other_side = look_at(eye, center, over * (0, -1, 0), 110.0, 112, 96)
    seen = np.flip(render(mirrored, other_side), 1)
    assert psnr(before, seen) > 60
    assert psnr(before, render(mirrored, camera)) < 30


def test_another_order_looks_the_same(model: GaussianModel, camera: Camera, before: Float32) -> None:
    assert psnr(before, render(model_attack("shuffle").apply(model), camera)) > 90


def test_clones_look_the_same_and_plain_duplicates_do_not(
    model: GaussianModel, camera: Camera, before: Float32
) -> None:
    pairs = psnr(before, render(model_attack("clone").apply(model, 0.5), camera))
    plain = psnr(before, render(model_attack("clone").apply(model, 0.5, reading="as_code"), camera))
    assert pairs > plain + 6
    assert pairs > 30


def test_low_impact_is_what_one_misses_least(model: GaussianModel, camera: Camera, before: Float32) -> None:
    looks = {
        name: psnr(before, render(model_attack(name).apply(model, 0.3), camera))
        for name in ("prune_low_impact", "prune_random")
    }
    assert looks["prune_low_impact"] > looks["prune_random"] + 3


@pytest.mark.parametrize(
    "name", ["prune_random", "prune_opacity", "noise_means", "noise_colors", "noise_all", "quantize", "drop_sh"]
)
def test_grids_run_from_harmless_to_ruinous(name: str, model: GaussianModel, camera: Camera, before: Float32) -> None:
    attack = MODEL_ATTACKS[name]
    grid = [s for s in attack.grid if name != "drop_sh" or s in (2, 1, 0)]
    looks = [psnr(before, render(attack.apply(model, s, rng=2), camera)) for s in grid]
    assert all(a >= b - 0.5 for a, b in pairwise(looks))
    assert looks[0] > 28
    assert looks[-1] < looks[0] - 8
    assert looks[-1] < 32


@pytest.mark.parametrize(
    ("name", "least"), [("ply", 100), ("spz", 35), ("compressed.ply", 35), ("sog", 32), ("splat", 25)]
)
def test_trade_formats_keep_the_look_as_far_as_they_can(
    name: str, least: float, model: GaussianModel, camera: Camera, before: Float32
) -> None:
    out = model_attack("convert").apply(model, name)
    assert len(out) == len(model)
    looks = psnr(before, render(out, camera))
    assert looks > least
    if name != "ply":  # something is lost, so this is not the model handed through
        assert looks < 90
    assert out.sh_degree == (0 if name == "splat" else model.sh_degree)
