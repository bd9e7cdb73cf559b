"""The package's surface: what it exports, warm-up, scratch memory, the benchmark."""

from __future__ import annotations

import json

import numpy as np
import pytest

import engine.raster
from engine.lab.evaluate.bench.raster import bench_camera, bench_raster, naive_forward
from engine.raster import prepare_view, release_memory, sh_colors, workspace
from engine.raster.workspace import borrow_workspace
from tests.raster.scenes import TOLERANCE, random_model


def test_exports() -> None:
    names = engine.raster.__all__
    assert names == sorted(names, key=lambda name: (not name.isupper(), name))
    assert all(callable(getattr(engine.raster, name)) for name in names if not name.isupper())


def test_workspaces_are_not_shared() -> None:
    release_memory()
    with borrow_workspace() as one, borrow_workspace() as other:
        assert one is not other
        a, b = one.array("x", (100,)), one.array("x", (50,))
        assert np.shares_memory(a, b)
        assert not np.shares_memory(a, other.array("x", (100,)))
        assert one.array("x", (100,), np.int32).dtype == np.int32
    with borrow_workspace() as again:
        assert again is other or again is one


def test_plain_loop_draws_the_same_image() -> None:
    model = random_model(2000, 90, 4)
    view_from = bench_camera(model, 160, 100)
    view = prepare_view(model, view_from)
    colors = sh_colors(model.sh, model.means, view_from.position)
    difference = np.abs(naive_forward(view, colors) - view.render(colors)[0])
    assert difference.max() <= TOLERANCE["pixel"]
    assert np.quantile(difference, 0.999) <= 10 * TOLERANCE["most pixels"]


def test_benchmark() -> None:
    result = bench_raster(random_model(500, 91, 4), 64, 48, 1)
    wanted = {
        "forward_ms",
        "backward_color_ms",
        "backward_ms",
        "cached_iteration_ms",
        "naive_forward_ms",
        "speedup_over_naive",
        "gaussians",
        "width",
        "height",
        "fragments_per_second",
        "peak_memory_mb",
        "machine",
        "versions",
    }
    assert wanted <= set(result)
    assert all(result[name] > 0 for name in wanted if name.endswith("_ms"))
    json.dumps(result)


def test_large_workspaces_are_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    release_memory()
    with borrow_workspace() as small:
        small.array("a", (100,))
    with borrow_workspace() as again:
        assert again is small
        monkeypatch.setattr(workspace, "_MOST", again.bytes - 1)
    with borrow_workspace() as other:
        assert other is not small
