"""Compile, or load from numba's disk cache, the kernels a job will need: on a scene too small to take time."""

from collections.abc import Callable
from functools import partial
from typing import Literal

import numpy as np

from engine import raster
from engine.compress.cells import split_cells
from engine.model import GaussianModel, look_at
from engine.numerics.image_metrics import ssim
from engine.numerics.similarity import transform_model
from engine.pictures.alignment import align_image
from engine.pictures.camera_finding import find_camera
from engine.pictures.features import luma
from engine.pictures.landmarks import make_landmarks
from engine.pictures.pose_refinement import refine_level
from engine.pictures.view_agreement import agreement_of_views
from engine.pictures.view_search import describe_views, search_views
from engine.registration.mixtures import Parts, Wholes
from engine.registration.registering import register
from engine.registration.sketch import SuspectIndex, make_sketch
from engine.watermark.grain import Grain
from engine.watermark.grain_evidence import gather_grain_evidence

__all__ = ["Work", "warm_up"]

Work = Literal["embed", "model", "pictures", "everything"]
"""Embedding; verifying a model; verifying pictures; all of it."""

_Advance = Callable[[float], None]


def warm_up(work: Work, progress: _Advance | None = None) -> None:
    """Make the kernels of some work ready; `progress` is told the fraction done, 0 to 1."""
    needs: dict[Callable[[_Advance], None], tuple[Work, ...]] = {
        raster.warm_up: ("embed", "pictures"),
        _embedding: ("embed",),
        _registration: ("model",),
        _alignment: ("pictures",),
    }
    steps = [step for step, works in needs.items() if work in (*works, "everything")]

    def advance(done: int, fraction: float) -> None:
        if progress is not None:
            progress((done + fraction) / len(steps))

    for number, step in enumerate(steps):
        step(partial(advance, number))
    advance(len(steps), 0.0)


def _embedding(advance: _Advance) -> None:
    split_cells(np.eye(8, 6, dtype=np.float32), np.ones(8), 4)
    advance(0.8)
    picture = np.eye(16, dtype=np.float32)
    ssim(picture, picture)
    advance(1.0)


def _registration(advance: _Advance) -> None:
    rng = np.random.default_rng(0)
    n = 600
    quats = rng.standard_normal((n, 4))
    model = GaussianModel(
        rng.standard_normal((n, 3), np.float32),
        rng.uniform(-5, -3, (n, 3)).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.standard_normal(n, np.float32),
        rng.standard_normal((n, 1, 3), np.float32),
    )
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    moved = transform_model(model, 1.5, turn, np.ones(3)).take(rng.permutation(n))
    for share, suspect in ((0.3, model.take(rng.permutation(n))), (0.6, moved), (0.8, moved.take(np.arange(n // 2)))):
        found = register(model, suspect)
        gather_grain_evidence(Grain(0.1, 0.1), model, suspect, found.similarity, found.matches, found.match_quality)
        advance(share)
    Wholes(moved).find(Parts.of(model), found.similarity)
    SuspectIndex(moved).resemblance(make_sketch(model))
    advance(1.0)


def _alignment(advance: _Advance) -> None:
    rng = np.random.default_rng(0)
    picture = np.kron(rng.random((12, 12, 3)), np.ones((8, 8, 1))).astype(np.float32)
    align_image(picture, picture[3:, 5:])
    advance(0.3)
    n = 300
    centers, levels = (rng.uniform(-1.0, 1.0, shape).astype(np.float32) for shape in ((n, 3), (n, 1, 3)))
    quats = np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32), (n, 1))
    model = GaussianModel(centers, np.full((n, 3), -2.0, np.float32), quats, np.full(n, 3.0, np.float32), levels)
    camera = look_at((0.0, 0.0, -4.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), 100.0, 96, 96)
    seen = np.clip(raster.render(model, camera), 0.0, 1.0)
    find_camera(make_landmarks(model, [camera]), model, seen, edges=lambda: describe_views(model, [camera]))
    search_views(describe_views(model, [camera]), seen, 1)
    agreement_of_views(np.zeros(2, np.int64), 9.0 * np.eye(2), 9.0 * np.eye(2), np.ones(2))
    refine_level(model, luma(seen), camera, 1, 1.0)
    advance(1.0)
