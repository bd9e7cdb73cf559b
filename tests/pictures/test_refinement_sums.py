"""What the refinement of a camera adds up over pixels."""

from __future__ import annotations

import numpy as np

from engine.pictures.camera.camera_motion import point_columns
from engine.pictures.camera.pose_refinement import _BLOCK, _SUMS, _UNKNOWNS, _normal_equations, _triangles
from engine.raster.lane_ir import LANES


def test_sums_are_those_of_single_pixels() -> None:
    """Also where a row's pixels that count fill no whole vectors."""
    rng = np.random.default_rng(0)
    height, width = 7, 41
    base, cover, gx, gy, residual = (rng.normal(size=(height, width)).astype(np.float32) for _ in range(5))
    depth = rng.uniform(0.5, 2.0, (height, width)).astype(np.float32)
    weight = (rng.random((height, width)) * (rng.random((height, width)) < 0.6)).astype(np.float32)
    weight[3] = 0.0
    K = np.array([[50.0, 1.0, 20.0], [0.0, 55.0, 3.0], [0.0, 0.0, 1.0]])
    rows, room = np.empty((height, _SUMS)), np.full((8, _BLOCK + _SUMS * LANES), np.nan, np.float32)
    _normal_equations(base, cover, residual, gx, gy, depth, weight, K, 0.5, room, rows)
    at = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1).reshape(-1, 2)
    rays = np.linalg.solve(K, np.column_stack([at, np.ones(len(at))]).T).T[:, :2]
    flow = point_columns(rays, depth.ravel().astype(np.float64), K)  # (P, 2, 11)
    slope = np.stack([gx, gy], axis=-1).reshape(-1, 2)
    columns = np.column_stack([-np.einsum("pa,pak->pk", slope, flow), base.ravel(), cover.ravel(), residual.ravel()])
    robust = (weight / (1.0 + (residual / 0.5) ** 2)).ravel()
    system = np.einsum("p,pk,pl->kl", robust, columns[:, :_UNKNOWNS], columns)
    moved = np.einsum("p,pak,pal->kl", weight.ravel(), flow, flow)
    for told, right in zip(_triangles(rows.sum(axis=0)), (system, moved), strict=True):
        np.testing.assert_allclose(told, np.triu(right), rtol=1e-4, atol=1e-5 * np.abs(right).max())
