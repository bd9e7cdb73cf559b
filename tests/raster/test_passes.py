"""Sorting and binning against NumPy and against brute force."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from engine.kernels.thread_crew import use_threads
from engine.raster import RasterSettings, binning, prepare_view
from engine.raster.binning import list_starts
from engine.raster.projection import RECORD
from engine.raster.settings import TILE
from tests.raster.scenes import TOLERANCE, camera, random_model
from tests.reference import raster as twin


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("workers", [1, 3])
def test_sort_is_stable_and_leaves_gaps_out(monkeypatch: pytest.MonkeyPatch, compiled: bool, workers: int) -> None:
    if not compiled:
        for name in ("pack_keys", "count_digits", "move_keys"):
            monkeypatch.setattr(binning, name, uncompiled(getattr(binning, name)))
    rng = np.random.default_rng(0)
    chunk, counts = 64, np.array([64, 0, 17, 40])
    depths = rng.choice(rng.lognormal(0.0, 3.0, 40), 256).astype(np.float32)  # many ties
    index = np.arange(256, dtype=np.int32)
    keys, order = np.zeros((2, 256), np.uint64), np.zeros(256, np.int32)
    histograms = np.zeros((2, workers, binning.BUCKETS), np.int64)
    n = binning.sort_by_depth(depths.view(np.uint32), index, counts, chunk, keys, order, histograms)
    present = np.concatenate([index[c * chunk : c * chunk + k] for c, k in enumerate(counts)])
    assert n == counts.sum()
    np.testing.assert_array_equal(order[:n], present[np.argsort(depths[present], kind="stable")])


def uncompiled(kernel: Any) -> Any:
    return lambda *arguments, turns=1: kernel.py_func(*arguments)


def test_few_gaussians_are_sorted_by_one_thread() -> None:
    with use_threads(4):
        assert [binning.workers_for(n) for n in (16, 50_000, 100_000, 10_000_000)] == [1, 1, 3, 4]


@pytest.mark.parametrize("run", [list_starts, list_starts.py_func], ids=["compiled", "python"])
def test_list_starts(run) -> None:
    counts = np.array([[2, 0, 1], [1, 4, 0]], np.int64)
    starts = np.zeros(4, np.int64)
    assert run(counts, starts) == 8
    np.testing.assert_array_equal(starts, [0, 3, 7, 8])
    np.testing.assert_array_equal(counts, [[0, 3, 7], [2, 3, 8]])


@pytest.mark.parametrize(("seed", "grow"), [(0, 0.0), (1, 0.0), (0, 0.5), (1, -0.7)])
def test_lists_hold_every_gaussian_that_shows_and_few_more(seed: int, grow: float) -> None:
    model, view_from = random_model(300, seed, 1), camera(83, 61)
    model = model.with_(log_scales=model.log_scales + np.float32(grow))
    geometry = prepare_view(model, view_from).geometry
    p = twin.parameters(model, view_from)
    centers, covariances, depths, drawn = twin.project(p, 83, 61, RasterSettings())
    conics = torch.linalg.inv(covariances)
    rows, columns = np.mgrid[:61, :83] + 0.5
    opacities = torch.sigmoid(p["opacity_logits"])
    needed = set()
    for i in range(300):
        if not drawn[i]:
            continue
        c, q = centers[i].detach().numpy(), conics[i].detach().numpy()
        dx, dy = columns - c[0], rows - c[1]
        power = q[0, 0] * dx * dx + 2 * q[0, 1] * dx * dy + q[1, 1] * dy * dy
        shown = float(opacities[i].detach()) * np.exp(-0.5 * power) >= 1.0001 / 255
        needed |= {(int(y) // TILE * geometry.tiles_x + int(x) // TILE, i) for y, x in np.argwhere(shown)}
    listed = set()
    z = depths.detach().numpy()
    for tile in range(len(geometry.starts) - 1):
        ids = geometry.ids[geometry.starts[tile] : geometry.starts[tile + 1]]
        listed |= {(tile, int(i)) for i in ids}
        assert (np.diff(z[ids]) >= -1e-6).all(), "a list is front to back"
    assert needed <= listed
    assert len(listed) <= 1.2 * len(needed) + 10
    for i in range(300):  # the other way round
        places = geometry.slots[geometry.firsts[i] : geometry.firsts[i + 1]]
        assert (geometry.ids[places] == i).all()
    assert len(geometry.slots) == len(geometry.ids) == geometry.firsts[-1]


def test_records() -> None:
    model, view_from = random_model(300, 3, 1), camera()
    view = prepare_view(model, view_from)
    centers, covariances, depths, drawn = twin.project(
        twin.parameters(model, view_from), view_from.width, view_from.height, RasterSettings()
    )
    seen = view.visible
    assert len(seen) > 100
    assert drawn.numpy()[seen].all()
    records = view.geometry.records[: 300 * RECORD].reshape(300, RECORD)[seen]
    conics = torch.linalg.inv(covariances).detach().numpy()[seen] * (-0.5 / np.log(2.0))
    expected = np.stack([conics[:, 0, 0], 2 * conics[:, 0, 1], conics[:, 1, 1]], 1)
    error = np.abs(records[:, 2:5] - expected).max(1) / np.abs(expected).max(1)
    assert error.max() < 1e-4
    size = np.abs(centers.detach().numpy()[seen]).max(1) + 1.0
    assert (np.abs(records[:, :2] - centers.detach().numpy()[seen]).max(1) / size).max() < 1e-5
    log2_opacity = np.log2(model.opacities[seen].astype(np.float64))
    assert np.abs(records[:, 5] - log2_opacity).max() < 2 * TOLERANCE["log2"]
    assert (np.diff(depths.detach().numpy()[seen]) >= -1e-6).all()
