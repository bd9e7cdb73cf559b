"""A flat textured sheet, a marked real scene and a small marked object."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.formats import read_model
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key
from engine.model import Bool, Camera, Float32, GaussianModel
from engine.raster import prepare_view

DATA = Path(__file__).parents[3] / "data"
QUICK = EmbedConfig(views=3, view_size=200, landmark_views=0)


@pytest.fixture(scope="session")
def sheet() -> GaussianModel:
    """A sheet z = 0.1 x^2 over -1..1, 4,000 flat Gaussians, striped along x, SH degree 1."""
    rng = np.random.default_rng(3)
    n = 4000
    xy = rng.uniform(-1, 1, (n, 2))
    means = np.concatenate([xy, 0.1 * xy[:, :1] ** 2], axis=1)
    log_scales = np.log(np.tile([0.03, 0.03, 0.003], (n, 1)) * rng.uniform(0.8, 1.2, (n, 1)))
    sh = 0.02 * rng.standard_normal((n, 4, 3))
    sh[:, 0] += 0.5 * np.sin(12 * xy[:, :1]) + [0.4, 0.0, -0.4]
    quats = np.tile([1.0, 0, 0, 0], (n, 1))
    return GaussianModel(
        means.astype(np.float32),
        log_scales.astype(np.float32),
        quats.astype(np.float32),
        rng.uniform(1.0, 4.0, n).astype(np.float32),
        sh.astype(np.float32),
    )


@pytest.fixture(scope="session")
def scene() -> MarkedScene:
    """A quarter of the plant's Gaussians, a real scan."""
    original = read_model(DATA / "plant.splat").model
    original = original.take(np.arange(0, len(original), 4))
    made, opened = marked(original, 7)
    return MarkedScene("plant", original, made, opened, {})


def solid(seed: int, n: int = 3000) -> GaussianModel:
    """A knobbly ball of its own shape and colors, SH degree 1."""
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    radius = 1.0 + 0.25 * np.sin(normal @ rng.normal(0, 4, (3, 3))).sum(axis=1, keepdims=True)
    quats = rng.standard_normal((n, 4))
    sh = 0.1 * rng.standard_normal((n, 4, 3))
    sh[:, 0] = 0.7 * np.sin(normal @ rng.normal(0, 3, (3, 3))) + 0.2 * rng.standard_normal((n, 3))
    return GaussianModel(
        (normal * radius).astype(np.float32),
        np.log(rng.uniform(0.02, 0.09, (n, 3))).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.normal(1.0, 1.5, n).astype(np.float32),
        sh.astype(np.float32),
    )


def marked(model: GaussianModel, seed: int) -> tuple[GaussianModel, OpenedRecord]:
    """The model marked with the key of that number, and its opened record."""
    key = bench_key(seed)
    made = embed(model, key, original_sha256=f"{seed:064x}", bits=16, config=QUICK)
    return made.model, open_record(made.record.to_bytes(key), key)


@pytest.fixture(scope="session")
def objects() -> dict[str, tuple[GaussianModel, OpenedRecord]]:
    """Three marked objects, each under a key of its own."""
    return {name: marked(solid(seed), seed) for seed, name in enumerate(("ball", "bell", "bowl"), start=11)}


@pytest.fixture(autouse=True)
def _small(small_renders: None) -> None:
    """How much renders say is the matter of tests/pipeline."""


def project_selection(model: GaussianModel, selection: Bool, camera: Camera) -> Float32:
    """(H, W) from 0 to 1: the part of each pixel's color that comes from the selected Gaussians."""
    image, _ = prepare_view(model, camera).render(selection.astype(np.float32)[:, None])
    return np.clip(image[..., 0], 0.0, 1.0)
