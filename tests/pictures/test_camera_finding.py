from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from engine.errors import InputError
from engine.kernels.thread_crew import use_threads
from engine.model import Camera, GaussianModel, look_at
from engine.numerics.similarity import mirror_model
from engine.pictures.camera import camera_proposals, keypoint_cameras
from engine.pictures.camera.camera_motion import normalized, project
from engine.pictures.camera.camera_search import find_camera
from engine.pictures.camera.camera_trial import Picture
from engine.pictures.camera.config import CONFIG, Level
from engine.pictures.camera.far_views import FarViews
from engine.pictures.camera.pose_refinement import Refined, refine_level
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.pictures.landmarks.rendered_landmarks import make_landmarks
from engine.raster import RasterSettings, render, render_depth
from tests.parameters import few
from tests.pictures.plant_views import UP, around, jpeg, reprojection
from tests.pictures.rolling import rolled
from tests.threads import with_one_and_two_threads

pytestmark = pytest.mark.slow


@pytest.fixture
def one_thread() -> Iterator[None]:
    with use_threads(1):
        yield


def test_landmarks_lie_on_the_surface(plant: GaussianModel, bank: Landmarks) -> None:
    camera = around(plant, 0.0, 20.0, 1.3, 1.1)
    mine = bank.points[bank.views == 0].astype(np.float64)
    assert len(mine) > 100
    _, depths = normalized(mine, camera)
    column, row = np.floor(project(mine, camera)).astype(int).T
    _, alpha, depth = render_depth(plant, camera)
    assert (alpha[row, column] > 0.7).all()
    np.testing.assert_allclose(depths, depth[row, column], rtol=2e-3)


def test_landmarks_are_few_bytes_and_the_same_on_any_number_of_threads(
    plant: GaussianModel, bank: Landmarks, one_thread: None
) -> None:
    again = make_landmarks(plant, [around(plant, 30.0 * k, 20.0 + 20.0 * (k % 2), 1.3, 1.1) for k in range(3)])
    for name in ("points", "descriptors", "views"):
        first = getattr(bank, name)[: len(again)]
        assert first.tobytes() == getattr(again, name).tobytes()
    assert 144 * len(bank) < 12 * 450 * 144 + 1


def test_progress_ends_at_one_and_nothing_seen_is_no_landmark(plant: GaussianModel) -> None:
    told: list[float] = []
    away = look_at((0.0, 0.0, -100.0), (0.0, 0.0, -200.0), UP, 300.0, 64, 48)
    empty = make_landmarks(plant, [away, away], told.append)
    assert len(empty) == 0
    assert told == [0.5, 1.0]
    assert find_camera(empty, plant, np.zeros((48, 64, 3), dtype=np.float32)) is None


@pytest.mark.parametrize(
    ("azimuth", "elevation", "distance", "focal", "quality"),
    [
        (17.0, 30.0, 1.2, 0.75, 80),
        (100.0, 25.0, 1.5, 1.4, 80),
        (222.0, 45.0, 1.1, 1.0, 40),
        (311.0, 35.0, 2.0, 1.2, 80),
    ],
)
def test_camera_of_a_jpeg_is_found_to_hundredths_of_a_pixel(
    plant: GaussianModel, bank: Landmarks, azimuth: float, elevation: float, distance: float, focal: float, quality: int
) -> None:
    true = around(plant, azimuth, elevation, distance, focal)
    found = find_camera(bank, plant, jpeg(render(plant, true), quality))
    assert found is not None
    assert reprojection(plant, true, found.camera) < 0.02
    assert (found.camera.width, found.camera.height) == (480, 360)
    assert found.camera.K[0, 0] == found.camera.K[1, 1]
    assert found.correlation > 0.99


@pytest.mark.parametrize(("axis", "quality"), few([(0, 20), (1, 80)], product([0, 1], [80, 20])))
def test_a_picture_turned_over_is_found_by_its_mirror_image(
    plant: GaussianModel, bank: Landmarks, axis: int, quality: int
) -> None:
    true = around(plant, 100.0, 25.0, 1.5, 1.4)
    picture = np.ascontiguousarray(np.flip(jpeg(render(plant, true), quality), axis))
    found = find_camera(bank, plant, picture)
    assert found is not None
    assert found.mirrored
    seen = found.face(picture)
    assert np.abs(render(plant, found.camera) - seen).mean() < 0.02
    plain = find_camera(bank, plant, seen)
    assert plain is not None
    assert not plain.mirrored
    assert plain.face(seen) is seen
    np.testing.assert_allclose(plain.camera.viewmat, found.camera.viewmat, atol=1e-4)


def test_what_is_nearly_symmetric_is_found_in_the_right_hand(plant: GaussianModel) -> None:
    """From the front, keypoints of half of its mirror image agree on a camera, too: a robot was read nothing from."""
    left = plant.with_(means=plant.means - np.median(plant.means, axis=0))
    left = left.take(np.flatnonzero(left.means[:, 0] < 0))
    right = mirror_model(left)
    right = right.take(np.flatnonzero(right.means[:, 1] < np.quantile(right.means[:, 1], 0.7)))
    model = right.with_(
        **{
            name: np.concatenate([getattr(left, name), getattr(right, name)])
            for name in ("means", "quats", "log_scales", "sh", "opacity_logits")
        }
    )
    bank = make_landmarks(model, [around(model, 30.0 * k, 20.0 + 20.0 * (k % 2), 1.3, 1.1) for k in range(12)])
    true = around(model, 90.0, 25.0, 1.2, 1.1)
    picture = jpeg(render(model, true), 80)
    for mirrored in (False, True):
        shown = np.ascontiguousarray(picture[:, ::-1]) if mirrored else picture
        found = find_camera(bank, model, shown)
        assert found is not None
        assert found.mirrored is mirrored
        assert found.correlation > 0.99
        assert reprojection(model, true, found.camera) < 0.05


def test_a_picture_that_is_recognised_is_not_turned_over(
    plant: GaussianModel, bank: Landmarks, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: list[int] = []
    match = keypoint_cameras.match_landmarks
    monkeypatch.setattr(keypoint_cameras, "match_landmarks", lambda *a: looks.append(1) or match(*a))
    picture = jpeg(render(plant, around(plant, 17.0, 30.0, 1.2, 0.75)), 80)
    assert find_camera(bank, plant, picture) is not None
    assert len(looks) == 1


def test_exposure_and_another_background_do_not_mislead(plant: GaussianModel, bank: Landmarks) -> None:
    true = around(plant, 60.0, 30.0, 1.3, 1.0)
    picture = jpeg(0.7 * render(plant, true, background=1.0) + 0.1, 80)
    found = find_camera(bank, plant, picture)
    assert found is not None
    assert reprojection(plant, true, found.camera) < 0.1


def test_large_picture_is_found_too(plant: GaussianModel, bank: Landmarks) -> None:
    true = around(plant, 75.0, 30.0, 1.3, 1.0).resized(1440, 1080)
    found = find_camera(bank, plant, jpeg(render(plant, true), 80))
    assert found is not None
    assert reprojection(plant, true, found.camera) < 0.03


def test_same_camera_on_any_number_of_threads(plant: GaussianModel, bank: Landmarks) -> None:
    picture = jpeg(render(plant, around(plant, 17.0, 30.0, 1.2, 0.75)), 80)
    one, two = with_one_and_two_threads(lambda: find_camera(bank, plant, picture))
    assert one is not None
    assert two is not None
    assert one.camera.viewmat.tobytes() == two.camera.viewmat.tobytes()
    assert one.camera.K.tobytes() == two.camera.K.tobytes()


def test_a_picture_of_one_color_is_not_searched(
    plant: GaussianModel, bank: Landmarks, monkeypatch: pytest.MonkeyPatch
) -> None:
    blank = np.full((240, 320, 3), np.float32([0.3, 0.5, 0.2]))
    blank[::2] += np.float32(1 / 255)
    monkeypatch.setattr("engine.pictures.camera.camera_search.Picture", lambda *_: pytest.fail("it searches"))
    assert find_camera(bank, plant, blank) is None


def test_other_pictures_are_not_recognised(plant: GaussianModel, bank: Landmarks) -> None:
    rng = np.random.default_rng(0)
    blocks = np.kron(rng.random((30, 40, 3)), np.ones((12, 12, 1))).astype(np.float32)
    turned = plant.with_(means=plant.means[:, ::-1].copy() * np.float32([1, -1, 1]))  # leaves in other places
    other = render(turned, around(turned, 40.0, 30.0, 1.3, 1.0))
    for picture in (np.zeros((360, 480, 3), np.float32), rng.random((360, 480, 3), dtype=np.float32), blocks, other):
        assert find_camera(bank, plant, picture) is None


@pytest.mark.parametrize("shape", [(360, 480), (360, 480, 4), (8, 480, 3)])
def test_unusable_pictures_are_refused(plant: GaussianModel, bank: Landmarks, shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="three colors are needed"):
        find_camera(bank, plant, np.zeros(shape, dtype=np.float32))


def test_pictures_that_are_not_finite_are_refused(plant: GaussianModel, bank: Landmarks) -> None:
    picture = np.zeros((48, 64, 3), dtype=np.float32)
    picture[3, 4, 1] = np.nan
    with pytest.raises(InputError, match="not finite"):
        find_camera(bank, plant, picture)


def test_landmarks_that_do_not_fit_together_are_refused() -> None:
    points, words, views = np.zeros((3, 3), np.float32), np.zeros((3, 128), np.uint8), np.zeros(3, np.int32)
    Landmarks(points, words, views)
    for wrong in (
        (points[:2], words, views),
        (points, words[:, :64], views),
        (points, words, views[:1]),
        (points, words.astype(np.float32), views),
        (np.full_like(points, np.nan), words, views),
    ):
        with pytest.raises(InputError):
            Landmarks(*wrong)


def test_refinement_gives_up_where_nothing_is_seen(plant: GaussianModel) -> None:
    away = look_at((0.0, 0.0, -100.0), (0.0, 0.0, -200.0), UP, 300.0, 64, 48)
    assert refine_level(plant, np.zeros((48, 64), np.float32), away, 3, 0.01) is None


def test_knobs_are_within_reason() -> None:
    assert CONFIG.keypoints.least_start <= CONFIG.keypoints.least_inliers < CONFIG.supported
    assert CONFIG.refinement.least_correlation < CONFIG.settled_correlation < 1.0


@pytest.mark.parametrize("roll", [0.0, 90.0, 180.0])
@pytest.mark.parametrize("background", ["white", "gradient"])
def test_neither_background_nor_roll_matters(
    plant: GaussianModel, bank: Landmarks, roll: float, background: str
) -> None:
    """Over black the refinement would not even keep the true camera here."""
    true = rolled(around(plant, 100.0, 25.0, 1.2, 1.1), np.radians(roll))
    image, alpha, _ = render_depth(plant, true)
    down = np.linspace(0.9, 0.2, 360, dtype=np.float32)[:, None, None]
    behind = np.ones(3) if background == "white" else down * np.float32([1.0, 0.8, 0.5])
    found = find_camera(bank, plant, jpeg(image + (1.0 - alpha[..., None]) * behind, 80))
    assert found is not None
    assert reprojection(plant, true, found.camera) < 0.05


def test_how_the_viewer_draws_is_told_from_the_picture(plant: GaussianModel, bank: Landmarks) -> None:
    true = around(plant, 100.0, 25.0, 1.5, 1.4)
    for settings in (RasterSettings(), RasterSettings(antialiased=True)):
        found = find_camera(bank, plant, jpeg(render(plant, true, settings=settings), 80))
        assert found is not None
        assert found.settings == settings
    plain, tagged = RasterSettings(antialiased=False), replace(plant, antialiased=True)
    found = find_camera(bank, tagged, jpeg(render(plant, true, settings=plain), 80))
    assert found is not None
    assert found.settings == plain


def test_a_picture_without_keypoints_is_found_by_its_edges(plant: GaussianModel) -> None:
    none = Landmarks(np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8), np.zeros(0, np.int32))
    true = rolled(around(plant, 47.0, 33.0, 1.2, 1.1), np.radians(-100.0))
    image, alpha, _ = render_depth(plant, true)
    picture = jpeg(image + 0.6 * (1.0 - alpha[..., None]), 80)
    assert find_camera(none, plant, picture) is None
    views = [around(plant, 24.0 * k, 20.0 + 20.0 * (k % 2), 1.3, 1.1) for k in range(15)]
    far = FarViews(plant, views)
    for mirrored in (False, True):
        shown = np.ascontiguousarray(picture[:, ::-1]) if mirrored else picture
        found = find_camera(none, plant, shown, far=lambda: far)
        assert found is not None
        assert found.mirrored is mirrored
        assert reprojection(plant, true, found.camera) < 0.05


def test_edges_of_something_else_are_no_picture_of_it(plant: GaussianModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some view always fits best; what it shows decides, and soon: what has no hope costs nothing at full size."""
    kept, sizes = Picture.refined, []

    def counted(picture: Picture, camera: Camera, level: Level, **rest: Any) -> Refined | None:
        sizes.append(level.side)
        return kept(picture, camera, level, **rest)

    monkeypatch.setattr(Picture, "refined", counted)
    none = Landmarks(np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8), np.zeros(0, np.int32))
    tiles = np.random.default_rng(0).random((9, 12, 3)).astype(np.float32)
    far = FarViews(plant, [around(plant, 90.0 * k, 30.0, 1.3, 1.1) for k in range(4)])
    picture = np.kron(tiles, np.ones((40, 40, 1), np.float32))
    assert find_camera(none, plant, picture, far=lambda: far) is None
    assert not sizes, "nothing fits"
    edges = replace(CONFIG.edges, least_score=0.0)
    monkeypatch.setattr(camera_proposals, "CONFIG", replace(CONFIG, edges=edges))
    assert find_camera(none, plant, picture, far=lambda: far) is None
    assert set(sizes) == {256, 640}
    assert sizes.count(640) < sizes.count(256)


def test_the_shape_of_a_view_in_one_colour_is_no_picture_of_it(plant: GaussianModel) -> None:
    """Soft edges correlate with those of any render; what lies within them does not."""
    none = Landmarks(np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8), np.zeros(0, np.int32))
    views = [around(plant, 90.0 * k, 30.0, 1.3, 1.1) for k in range(4)]
    _, alpha, _ = render_depth(plant, views[1])
    far = FarViews(plant, views)
    flat = np.repeat(0.6 * alpha[..., None], 3, axis=2).astype(np.float32)
    assert find_camera(none, plant, flat, far=lambda: far) is None
    found = find_camera(none, plant, render(plant, views[1]), far=lambda: far)
    assert found is not None, "the view itself is"
