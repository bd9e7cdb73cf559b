"""A picture held against renders: what is small is drawn of few Gaussians."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from engine.model import GaussianModel
from engine.pictures import camera_trial
from engine.pictures.camera_trial import THUMBNAIL, Picture
from engine.pictures.view_search import MOST_SEEN
from engine.pipeline.rigs import make_rig
from engine.raster import render


def counted(kept: Callable[..., Any], drawn: list[int]) -> Callable[..., Any]:
    def asked(model: GaussianModel, *how: Any, **more: Any) -> Any:
        drawn.append(len(model))
        return kept(model, *how, **more)

    return asked


def test_a_thumbnail_is_held_against_few_gaussians(plant: GaussianModel, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = make_rig(plant, 1, 512, 384)[0]
    picture = Picture(plant, render(plant, camera))
    drawn: list[int] = []
    for name in ("render_depth", "refine_level"):
        kept = getattr(camera_trial, name)
        monkeypatch.setattr(camera_trial, name, counted(kept, drawn))
    worth = []
    for size, most in ((THUMBNAIL, MOST_SEEN), (256, len(plant))):
        drawn.clear()
        refined = picture.refined(camera, False, size, 4, 0.05)
        assert refined is not None
        worth.append(picture.worth(refined, False) / (size * size))
        assert drawn == [most, most]
        assert refined.correlation > 0.9
    blind = picture.worth(replace(refined, correlation=0.0), False)
    assert blind < 0.01 < min(worth)
