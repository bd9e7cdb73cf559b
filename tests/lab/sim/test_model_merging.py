"""Merging attacks: how many Gaussians are left, that the model's moments are kept, and that it looks the same."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from engine.compress.levels_of_detail import disjoint_pairs, merging_costs
from engine.formats import read_model, write_model
from engine.lab.sim.attacks import model_attack
from engine.model import Camera, GaussianModel, look_at
from engine.numerics.gaussians import covariances, flatten, merge_groups, surface_mass, volume_mass
from engine.numerics.image_metrics import psnr
from engine.raster import render
from tests.reference import merging as twin

SCENE = Path(__file__).parents[2] / "data" / "plant.splat"
READINGS = [("merge", "literal"), ("merge", "as_code"), ("lod", "literal")]


@pytest.fixture(scope="module")
def patch() -> GaussianModel:
    """A connected piece of the plant, dense as captured models are."""
    return model_attack("crop").apply(read_model(SCENE).model, 4_000 / 113_648, rng=0)


def camera_of(model: GaussianModel) -> Camera:
    middle = np.median(model.means, axis=0)
    radius = float(np.quantile(np.linalg.norm(model.means - middle, axis=1), 0.9))
    return look_at(middle + np.array([0.0, 0.0, 2.5 * radius]), middle, [0.0, 1.0, 0.0], 170.0, 160, 160)


def total_moments(model: GaussianModel) -> tuple[np.ndarray, np.ndarray]:
    mass = surface_mass(model)
    share = mass / mass.sum()
    center = share @ model.means
    gap = model.means - center
    return center, np.einsum("n,nij->ij", share, covariances(model)) + (gap * share[:, None]).T @ gap


@pytest.mark.parametrize(("name", "reading"), READINGS)
@pytest.mark.parametrize("share", [0.5, 0.1, 0.02])
def test_share_is_what_is_left(patch: GaussianModel, name: str, reading: str, share: float) -> None:
    left = len(model_attack(name).apply(patch, share, reading=reading)) / len(patch)
    assert share - 0.01 < left <= share + 1e-9


@pytest.mark.parametrize(("name", "reading"), READINGS)
def test_all_of_the_model_is_no_change(patch: GaussianModel, name: str, reading: str) -> None:
    same = model_attack(name).apply(patch, 1.0, reading=reading)
    np.testing.assert_array_equal(same.means, patch.means)
    np.testing.assert_array_equal(same.sh, patch.sh)


def test_moments_of_the_whole_are_kept(patch: GaussianModel) -> None:
    """What registration of a merged and moved model rests on."""
    center, spread = total_moments(patch)
    for share in (0.5, 0.1):
        thin_centre, thin_spread = total_moments(model_attack("merge").apply(patch, share, reading="as_code"))
        size = np.sqrt(np.trace(spread))
        assert np.abs(thin_centre - center).max() < 0.06 * size  # opacities end at 1, and mass is lost there
        np.testing.assert_allclose(thin_spread, spread, atol=0.06 * size**2)


def test_it_looks_like_what_it_replaces(patch: GaussianModel) -> None:
    """Publishing tools at one half: above 30 dB here, where dropping half is below 25."""
    camera = camera_of(patch)
    whole = render(patch, camera)
    merged = psnr(render(model_attack("merge").apply(patch, 0.5, reading="as_code"), camera), whole)
    dropped = psnr(render(model_attack("prune_random").apply(patch, 0.5), camera), whole)
    assert merged > 30.0
    assert merged > dropped + 5.0


def test_a_group_has_the_moments_of_its_members(model: GaussianModel) -> None:
    group = np.minimum(np.arange(len(model)) // 3, 100).astype(np.int64)
    merged = merge_groups(model, group, surface=True)
    mass = surface_mass(model)
    for number in (0, 57):
        rows = np.flatnonzero(group == number)
        mean, spread = twin.moments(mass[rows], model.means[rows], [twin.covariance(model, i) for i in rows])
        np.testing.assert_allclose(merged.means[number], mean, atol=1e-5)
        np.testing.assert_allclose(covariances(merged)[number], spread, atol=1e-6)
        np.testing.assert_allclose(merged.sh[number], np.average(model.sh[rows], axis=0, weights=mass[rows]), atol=1e-5)
        assert surface_mass(merged)[number] == pytest.approx(
            min(mass[rows].sum(), surface_mass(merged)[number]), rel=1e-4
        )


def test_light_adds_up_as_in_blending(model: GaussianModel) -> None:
    """NanoGS: what a pair lets through is the product of what each does."""
    group = np.arange(len(model)) // 2
    merged = merge_groups(model, group.astype(np.int64), surface=False)
    through = (1 - model.opacities[0::2]) * (1 - model.opacities[1::2])
    np.testing.assert_allclose(merged.opacities, 1 - through, atol=1e-4)


def test_a_gaussian_alone_keeps_its_bits(model: GaussianModel) -> None:
    group = np.maximum(np.arange(len(model)) - 1, 0).astype(np.int64)  # the first two are one
    merged = merge_groups(model, group, surface=True)
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(merged, name)[1:], getattr(model, name)[2:])


def test_discs_stay_discs(model: GaussianModel) -> None:
    assert model_attack("merge").apply(flatten(model), 0.3).is_flat


@pytest.mark.parametrize("compiled", [True, False])
def test_costs_are_the_twins(model: GaussianModel, compiled: bool) -> None:
    few = model.take(np.arange(30))
    near = np.stack([np.arange(30), (np.arange(30) + 1) % 30, (np.arange(30) + 7) % 30], axis=1)
    means, sigma = few.means.astype(float), covariances(few)
    mass, looks = volume_mass(few), few.sh.reshape(30, -1).astype(float)
    function = merging_costs if compiled else merging_costs.py_func
    cost = np.full(near.shape, np.inf)
    function(means, sigma, mass, looks, near, 0.2, cost)
    for i in range(30):
        for at, j in enumerate(near[i]):
            if j <= i:
                assert cost[i, at] == np.inf
                continue
            expected = twin.pair_cost(mass[[i, j]], means[[i, j]], sigma[[i, j]], looks[[i, j]], 0.2)
            assert cost[i, at] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("wanted", [3, 100])
def test_pairs_are_the_twins(compiled: bool, wanted: int) -> None:
    rng = np.random.default_rng(0)
    first = rng.integers(0, 39, 300)
    second = rng.integers(first + 1, 40)
    function = disjoint_pairs if compiled else disjoint_pairs.py_func
    pairs = function(first, second, 40, wanted)
    assert [tuple(p) for p in pairs] == twin.greedy_pairs(list(zip(first, second, strict=True)), wanted)


def test_cheap_pairs_go_first(model: GaussianModel) -> None:
    """Look-alikes in one place are merged before anything else is."""
    copies = model.take(np.concatenate([np.arange(len(model)), np.arange(50)]))
    merged = model_attack("merge").apply(copies, 500 / 550)
    assert len(merged) == 500
    np.testing.assert_allclose(np.sort(merged.means[:, 0]), np.sort(model.means[:, 0]), atol=1e-5)


def test_looks_like_the_publishing_tool(patch: GaussianModel, tmp_path: Path) -> None:
    """splat-transform's own --decimate, where it is installed: as many Gaussians, and views as near to the original."""
    tool = shutil.which("splat-transform")
    if tool is None:
        pytest.skip("splat-transform is not installed (npm install -g @playcanvas/splat-transform)")
    write_model(patch, tmp_path / "in.ply")
    subprocess.run([tool, "-q", "-g", "cpu", tmp_path / "in.ply", "-F", "25%", tmp_path / "out.ply"], check=True)
    theirs, ours = read_model(tmp_path / "out.ply").model, model_attack("merge").apply(patch, 0.25, reading="as_code")
    assert len(theirs) == pytest.approx(len(ours), abs=2)
    camera = camera_of(patch)
    whole = render(patch, camera)
    assert psnr(render(ours, camera), whole) == pytest.approx(psnr(render(theirs, camera), whole), abs=2.0)
