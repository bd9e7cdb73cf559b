"""Which of two cameras the search believes, where both explain the picture: refinements here have set gains."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from engine.model import Camera, look_at
from engine.pictures.camera import camera_search
from engine.pictures.camera.camera_proposals import Candidate, Candidates
from engine.pictures.camera.camera_search import _FirstLook
from engine.pictures.camera.camera_trial import Picture
from engine.pictures.camera.pose_refinement import Refined
from engine.raster import RasterSettings

CAMERA = look_at((0, 0, -4), (0, 0, 0), (0, 1, 0), 40.0, 40, 30)


@dataclass
class FakePicture:
    """Refines any camera at once, to a gain that follows from how."""

    other_settings: float = 1.0
    free_center: float = 1.0
    shift: float = 0.0
    size: tuple[int, int] = (40, 30)

    @property
    def model(self) -> SimpleNamespace:
        return SimpleNamespace(antialiased=False)

    def full(self, camera: Camera) -> Camera:
        return camera

    def refined_through_blur(self, camera: Camera, *rest: Any, **how: Any) -> tuple[Refined, None]:
        return self.refined(camera, *rest, **how), None

    def refined(self, camera: Camera, *rest: Any, **how: Any) -> Refined:
        factor = self.other_settings if how["settings"].antialiased else 1.0
        factor *= self.free_center if "free" in how else 1.0
        pixels = round(100_000 * factor)  # the gain is proportional to them
        return Refined(camera, 0.01, 0.9, 0.9, 0.9, 90.0, step=0.1, shift=self.shift, pixels=pixels)


def found(**gains: float) -> camera_search.FoundCamera:
    picture = cast(Picture, FakePicture(**gains))
    settings = RasterSettings(antialiased=False)
    camera = camera_search._refine_to_full_size(picture, Candidate(CAMERA, False, 0, settings=settings))
    assert camera is not None
    return camera


@pytest.mark.parametrize(("gain", "believed"), [(1.01, False), (1.025, False), (1.05, True)])
def test_another_way_of_drawing_must_explain_the_picture_clearly_better(gain: float, believed: bool) -> None:
    assert found(other_settings=gain).settings.antialiased is believed


@pytest.mark.parametrize(("gain", "believed"), [(1.02, False), (1.05, True)])
def test_a_moved_principal_point_must_too(gain: float, believed: bool) -> None:
    fixed = found().gain
    assert found(free_center=gain, shift=9.0).gain == pytest.approx(fixed * (gain if believed else 1.0))
    assert found(free_center=gain, shift=0.0).gain == pytest.approx(fixed), "it is not asked for where nothing moves"


@pytest.mark.parametrize(("rows", "searched"), [(6, False), (20, True)])
def test_a_frame_of_a_few_pixels_is_not_searched(rows: int, searched: bool) -> None:
    class Framed:
        def frame(self, candidate: Candidate) -> tuple[slice, slice]:
            return slice(0, rows), slice(0, 30)

    asked = list[tuple[int, ...]]()

    def search(inner: np.ndarray) -> None:
        asked.append(inner.shape)

    whole = found()
    strongest = Candidate(CAMERA, False, 1000)
    look = _FirstLook(strongest, strongest, whole)
    image = np.zeros((30, 40, 3), dtype=np.float32)
    got = camera_search._within_frame(look, cast(Picture, FakePicture()), cast(Candidates, Framed()), image, search)
    assert got is whole
    assert bool(asked) is searched


def settling(support: int, correlation: float, uncovered: float, mirrored: bool = False) -> Candidate:
    return Candidate(CAMERA, mirrored, support, correlation=correlation, uncovered_correlation=uncovered)


def test_the_first_look_follows_a_camera_that_is_nearly_right(monkeypatch: pytest.MonkeyPatch) -> None:
    """To what the picture and a render from there agree on, before the mirror image is searched."""
    rough, near = settling(47, 0.85, 0.94), settling(300, 0.98, 0.98)
    other = settling(34, 0.3, 0.3, mirrored=True)
    drawn: list[Candidate] = []

    def candidates(*them: Candidate) -> Iterator[Candidate]:
        for each in them:
            drawn.append(each)
            yield each

    refined = SimpleNamespace(gain=1.0)
    monkeypatch.setattr(camera_search, "_refine_small", lambda _, proposed: (proposed, refined))
    picture = cast(Picture, SimpleNamespace(score=lambda *_: float(len(drawn))))
    sides = {"side": 256}
    for closer, tried in ((near, [rough, near]), (rough, [rough, rough, other])):
        drawn.clear()
        hands = {
            False: candidates(*(replace(each, **sides) for each in (rough, closer, rough))),
            True: candidates(replace(other, **sides)),
        }
        look = camera_search._first_look(picture, hands)
        assert [(each.support, each.mirrored) for each in drawn] == [(each.support, each.mirrored) for each in tried]
        assert look.strongest is not None
        assert look.strongest.support == rough.support
