from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.flows.embed import landmark_bank
from engine.flows.embed.config import CONFIG
from engine.flows.embed.landmark_bank import bank_views, make_bank
from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.flows.views.config import CONFIG as VIEWS
from engine.model import GaussianModel
from engine.pictures.landmarks.config import CONFIG as LANDMARKS
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.pictures.landmarks.rendered_landmarks import make_landmarks


def same(one: Landmarks, other: Landmarks) -> bool:
    return all(
        getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in ("points", "descriptors", "views")
    )


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(landmark_bank, "_CONFIG", replace(CONFIG.bank, least=6))
    monkeypatch.setattr(landmark_bank, "VIEWS", replace(VIEWS, rig=replace(VIEWS.rig, landmark_size=(320, 240))))


def test_what_is_poor_in_landmarks_gets_every_view(small_plant: GaussianModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """None is drawn twice, and those looked at first show no more than the others."""
    drawn: list[int] = []

    def counted(model: GaussianModel, cameras: list, *rest: object, **more: int) -> Landmarks:  # type: ignore[type-arg]
        drawn.append(len(cameras))
        return make_landmarks(model, cameras, *rest, **({"most": 40} | more))  # type: ignore[arg-type]

    monkeypatch.setattr(landmark_bank, "LANDMARKS", replace(LANDMARKS, per_view=40))
    monkeypatch.setattr(landmark_bank, "make_landmarks", counted)
    extent = measure_extent(small_plant)
    bank, rig = make_bank(small_plant, extent, 6)
    assert drawn == [3, 3]
    assert len(rig) == 6
    assert same(bank, make_landmarks(small_plant, make_rig(small_plant, 6, 320, 240, extent=extent), most=40))
    assert np.bincount(bank.views).max() == 40


def test_what_is_rich_on_every_side_gets_a_third(small_plant: GaussianModel, monkeypatch: pytest.MonkeyPatch) -> None:
    extent = measure_extent(small_plant)
    views = [make_rig(small_plant, 6, 320, 240, extent=extent)[k] for k in (0, 2, 4)]
    least, *_, most = sorted(np.bincount(make_landmarks(small_plant, views).views))
    assert 0 < least < most
    monkeypatch.setattr(landmark_bank, "_CONFIG", replace(CONFIG.bank, least=6, rich=least + 1))
    assert len(make_bank(small_plant, extent, 6)[1]) == 6, "one side is poor"
    monkeypatch.setattr(landmark_bank, "_CONFIG", replace(CONFIG.bank, least=6, rich=least))
    told: list[float] = []
    bank, rig = make_bank(small_plant, extent, 6, told.append)
    assert same(bank, make_landmarks(small_plant, make_rig(small_plant, 2, 320, 240, extent=extent)))
    assert told == [0.5, 1.0]
    again = bank_views(bank, small_plant)
    assert [camera.viewmat.tobytes() for camera in again] == [camera.viewmat.tobytes() for camera in rig]
    monkeypatch.setattr(landmark_bank, "_CONFIG", replace(CONFIG.bank, least=7, rich=least))
    assert len(make_bank(small_plant, extent, 6)[1]) == 6, "few were wanted"
