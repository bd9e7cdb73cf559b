"""Colours of a view's points, and the way from about the right view to the right one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.flows.views.camera_rig import make_rig
from engine.model import Camera, Float32, GaussianModel, look_at
from engine.pictures.camera import camera_proposals
from engine.pictures.camera.camera_proposals import Candidates
from engine.pictures.camera.camera_trial import Picture
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.far_views import FarViews
from engine.pictures.camera.picture_edges import PictureEdges
from engine.pictures.camera.view_points import ViewPoints, describe_view
from engine.pictures.camera.view_scores import SIDE
from engine.pictures.camera.view_search import Climbed, _best_apart, climb
from engine.pictures.camera.voted_views import VotedView
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import render_depth
from tests.pictures.rolling import rolled

UP = (0.0, -1.0, 0.0)


def around(model: GaussianModel, azimuth: float, elevation: float, away: float, lens: float = 1.0) -> Camera:
    a, e = np.radians([azimuth, elevation])
    center = np.median(model.means, axis=0)
    radius = float(np.median(np.linalg.norm(model.means - center, axis=1)))
    toward = np.array([np.cos(e) * np.sin(a), -np.sin(e), np.cos(e) * np.cos(a)])
    return look_at(center + away * radius * toward, center, UP, lens * 200.0, 320, 240)


def photographed(model: GaussianModel, camera: Camera, tone: float = 1.0) -> Float32:
    """Over a pattern of many edges, in other tones."""
    image, alpha, _ = render_depth(model, camera)
    tiles = np.random.default_rng(0).uniform(0.3, 0.6, (12, 16, 1)).astype(np.float32)
    behind = np.kron(tiles, np.ones((20, 20, 3), np.float32))
    return np.clip(image, 0.0, 1.0) ** np.float32(tone) + (1.0 - alpha[..., None]) * behind


def off(a: Camera, b: Camera) -> float:
    """Degrees between two cameras."""
    return float(np.degrees(Rotation.from_matrix(a.viewmat[:3, :3] @ b.viewmat[:3, :3].T).magnitude()))


def standing(view: ViewPoints) -> np.ndarray:
    return np.array([[0.0, view.spread, *(view.middle - 0.5)]])


def test_the_right_camera_is_climbed_to(plant: GaussianModel) -> None:
    """Fifteen degrees off, too near, and among others that are wrong; and the mirror image is the mirror image's."""
    true = around(plant, 40.0, 25.0, 6.0)
    picture = photographed(plant, true, 0.7)
    pictures = [PictureEdges.of(picture), PictureEdges.of(np.ascontiguousarray(picture[:, ::-1]))]
    away = [around(plant, azimuth, elevation, 5.0, 5.0 / 6.0) for azimuth, elevation in ((56.0, 15.0), (160.0, 20.0))]
    starts = [Climbed(0.0, camera.with_side(SIDE), hand) for camera in away for hand in (0, 1)]
    found = climb(FarViews(plant, []).model, pictures, starts)
    assert found[0].picture == 0
    assert off(found[0].camera, true) < 5.0 < 15.0 < off(away[0], true)
    assert [each.score for each in found] == sorted((each.score for each in found), reverse=True)
    assert (found[0].camera.width, found[0].camera.height) == (96, 72)


def test_who_sees_nothing_is_given_up(plant: GaussianModel) -> None:
    true = around(plant, 40.0, 25.0, 6.0)
    picture = PictureEdges.of(photographed(plant, true))
    turned = Camera(np.diag([-1.0, 1.0, -1.0, 1.0]) @ true.viewmat, true.K, true.width, true.height).with_side(SIDE)
    assert climb(plant, [picture], [Climbed(9.0, turned, 0)]) == []
    assert len(climb(plant, [picture], [Climbed(9.0, turned, 0), Climbed(0.0, true.with_side(SIDE), 0)])) == 1


def test_cameras_that_are_nearly_one_are_one(plant: GaussianModel) -> None:
    camera = around(plant, 40.0, 25.0, 6.0)
    near, far = rolled(camera, np.radians(3.0)), rolled(camera, np.radians(8.0))
    each = [Climbed(float(k), one, 0) for k, one in enumerate((far, near, camera))]
    assert [found.score for found in _best_apart(each, 3)] == [2.0, 0.0]
    assert [found.score for found in _best_apart([*each, Climbed(1.5, near, 1)], 2)] == [2.0, 1.5], "another picture's"
    kept = [each.kept for each in CONFIG.edges.rounds]
    assert kept == sorted(kept)[::-1], "never more than before"


@pytest.mark.parametrize(("excess", "climbed"), [(0.1, True), (-0.1, False)])
def test_what_is_voted_for_loudly_climbs(
    plant: GaussianModel, monkeypatch: pytest.MonkeyPatch, excess: float, climbed: bool
) -> None:
    """Without a single view that outlines and edges are sought in."""
    true = around(plant, 40.0, 25.0, 6.0)
    none = Landmarks(np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8), np.zeros(0, np.int32))
    pairs = np.zeros(0, np.int64), np.zeros(0, np.int64)
    voted = VotedView(CONFIG.votes.least_loudness + excess, around(plant, 56.0, 15.0, 5.0, 5.0 / 6.0), *pairs)
    monkeypatch.setattr(camera_proposals, "vote_for_views", lambda *asked: [voted])
    monkeypatch.setattr(Candidates, "_closer", lambda *asked: None)  # keypoints alone do not find home
    candidates = Candidates(Picture(plant, photographed(plant, true, 0.7)), none, (), ())
    assert list(candidates.by_votes([])) == []
    found = list(candidates.by_edges(FarViews(plant, [])))
    assert bool(found) is climbed
    if climbed:
        assert min(off(each.camera, true) for each in found if not each.mirrored) < 5.0


def test_parts_are_looked_at_where_nothing_fits(plant: GaussianModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """A close-up of what is not the middle: from no view of the whole does anything climb there."""
    away = make_rig(plant, 12, 640, 480)
    far = FarViews(plant, away)
    true = far.parts[20].camera.with_side(320)
    image, alpha, _ = render_depth(plant, true)
    picture = np.clip(image, 0.0, 1.0) ** np.float32(0.7) + 0.3 * (1.0 - alpha[..., None])
    monkeypatch.setattr(Candidates, "_closer", lambda *asked: None)  # keypoints alone do not find home
    none = Landmarks(np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8), np.zeros(0, np.int32))
    candidates = Candidates(Picture(plant, picture), none, (), ())
    whole = FarViews(plant, away)
    whole.__dict__["parts"] = []
    assert all(each.mirrored or off(each.camera, true) > 10.0 for each in candidates.by_edges(whole))
    found = list(candidates.by_edges(far))
    assert len(found) == CONFIG.edges.rounds[-1].kept
    assert not found[0].mirrored
    assert off(found[0].camera, true) < 4.0
    fitting = FarViews(plant, away)
    fitting.__dict__["views"] = far.parts
    list(candidates.by_edges(fitting))
    assert "parts" not in vars(fitting), "what fits is enough"


def test_what_hardly_fits_is_not_looked_at(plant: GaussianModel, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = around(plant, 40.0, 25.0, 6.0)
    none = Landmarks(np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8), np.zeros(0, np.int32))
    scores = [CONFIG.edges.least_score + excess for excess in (5.0, 0.1, -0.1)]
    monkeypatch.setattr(camera_proposals, "climb", lambda *asked: [Climbed(score, camera, 0) for score in scores])
    looked: list[Camera] = []
    monkeypatch.setattr(Candidates, "_closer", lambda self, camera, mirrored: looked.append(camera))
    candidates = Candidates(Picture(plant, photographed(plant, camera)), none, (), ())
    assert len(list(candidates.by_edges(FarViews(plant, [])))) == len(looked) == 2


def test_colours_tell_what_edges_do_not(plant: GaussianModel) -> None:
    """The same edges in a picture whose colours are shuffled; a tone curve hardly matters."""
    camera = around(plant, 40.0, 25.0, 6.0).with_side(SIDE)
    view = describe_view(plant, camera)
    assert view is not None
    picture = photographed(plant, camera.with_side(320))
    shades = {"own": picture, "toned": np.clip(0.1 + 0.7 * picture**0.6, 0.0, 1.0), "inverted": 1.0 - picture}
    told = {
        name: PictureEdges.of(shade).scored([view], np.zeros(1, int), standing(view)) for name, shade in shades.items()
    }
    score = {name: float(scores[0]) for name, (scores, _) in told.items()}
    assert score["own"] - score["inverted"] > 2.0 * CONFIG.edges.colored
    assert score["own"] - score["toned"] < 0.5 * CONFIG.edges.colored


def test_colours_are_correlated_point_by_point(plant: GaussianModel) -> None:
    """As a plain loop says, also where the view reaches beyond the picture."""
    camera = around(plant, 40.0, 25.0, 6.0).with_side(SIDE)
    view = describe_view(plant, camera)
    assert view is not None
    picture = PictureEdges.of(photographed(plant, camera.with_side(320)))
    right = view.inner[:, 0].astype(np.float64) * view.spread
    few = SIDE - np.sort(right)[9] - 1.0  # ten points of the view are left in the picture
    whole = [0.0, view.spread, *(view.middle - 0.5)]
    poses = np.array([whole, [0.7, 1.2 * view.spread, 80.0, 60.0], [0.0, view.spread, few, view.middle[1] - 0.5]])
    said = picture._colored([view], np.zeros(3, int), poses)
    height, width = picture.small.shape[:2]
    counts = []
    for pose, answer in zip(poses, said, strict=True):
        seen, drawn = [], []
        for point, color in zip(view.inner.astype(np.float64), view.colors, strict=True):
            turn, size, x, y = pose
            column = int(np.floor(size * (np.cos(turn) * point[0] - np.sin(turn) * point[1]) + x + 0.5))
            row = int(np.floor(size * (np.sin(turn) * point[0] + np.cos(turn) * point[1]) + y + 0.5))
            if 0 <= column < width and 0 <= row < height:
                seen.append(picture._soft[row, column])
                drawn.append(color)
        counts.append(len(seen))
        if len(seen) < 20:
            assert answer == 0.0
            continue
        a, b = (np.array(each) - np.mean(each, axis=0) for each in (seen, drawn))
        alike = (a * b).sum() / np.sqrt((a**2).sum() * (b**2).sum())
        assert answer == pytest.approx(np.arctanh(min(alike, 0.99)), abs=1e-3)
    assert 0 < counts[2] < 20 < counts[1] < counts[0]
