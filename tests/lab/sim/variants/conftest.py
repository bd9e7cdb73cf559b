"""A real plant, thinned out, and what is made of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.flows.embed.embedding import Embedding
from engine.flows.embed.profiles import EmbedConfig, profile
from engine.flows.embed.terms import MarkTerms
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.formats import read_model
from engine.lab.evaluate.marked_scene import bench_key
from engine.lab.sim.variants.synthetic import SwayingScene, fit_spacetime, set_in_motion
from engine.model import GaussianModel
from engine.scenes.clip_marking import embed_moving
from engine.scenes.spacetime import SpacetimeModel
from engine.watermark.keys import OwnerKey

SCENE = Path(__file__).parents[3] / "data" / "plant.splat"


@pytest.fixture(scope="session")
def key() -> OwnerKey:
    return bench_key(4)


@pytest.fixture(scope="session")
def config() -> EmbedConfig:
    return profile("fast", views=4, view_size=256, landmark_views=0)


@pytest.fixture(scope="session")
def plant() -> GaussianModel:
    """Every twelfth Gaussian, wider, so that it still covers the plant."""
    model = read_model(SCENE).model
    thin = model.take(np.arange(0, len(model), 12))
    return thin.with_(log_scales=thin.log_scales + np.float32(0.6))


@pytest.fixture(scope="session")
def swaying(plant: GaussianModel) -> SwayingScene:
    return set_in_motion(plant, swing=0.08, transient=0.3, seed=1)


@pytest.fixture(scope="session")
def clip(swaying: SwayingScene) -> SpacetimeModel:
    return fit_spacetime(swaying)


@pytest.fixture(scope="session")
def marked_clip(
    clip: SpacetimeModel, key: OwnerKey, config: EmbedConfig
) -> tuple[SpacetimeModel, Embedding, OpenedRecord]:
    marked, result = embed_moving(clip, key, MarkTerms(config=config))
    return marked, result, open_record(result.record.to_bytes(key), key)


@pytest.fixture(autouse=True)
def _small(small_renders: None) -> None:
    """How much renders say is the matter of tests/pipeline."""
