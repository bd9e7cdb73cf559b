"""Views of a model that a picture's keypoints vote for, where too few stand out to make a camera (DESIGN 4.8).

Each keypoint votes for the landmarks most like it, with a weight: how much nearer their descriptors are than the
next nearest. Votes for a view count if one similarity maps their keypoints to where the view saw the landmarks. A dozen
right ones among a thousand are enough.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.model import Camera, Float64, Int64
from engine.pictures.camera.camera_motion import project, swung
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.view_agreement import agreement_of_views
from engine.pictures.landmarks.keypoints import Keypoints
from engine.pictures.landmarks.landmark_set import Landmarks

_CONFIG = CONFIG.votes


@dataclass(frozen=True, eq=False)
class VotedView:
    """A view that may show what a picture shows."""

    loudness: float  # of the votes that agree
    camera: Camera  # of the picture, standing where the view's stood
    keypoints: Int64  # (M,) of these votes
    landmarks: Int64  # (M,)


def vote_for_views(
    keypoints: Keypoints, landmarks: Landmarks, cameras: Sequence[Camera], size: tuple[int, int]
) -> list[VotedView]:
    """The views that a picture of this size (width, height) is voted to show, the loudest first. `cameras` are those
    that the landmarks were seen from.
    """
    if len(landmarks) <= _CONFIG.nearest or not len(keypoints):
        return []
    nearest, gain = _neighbors(keypoints.descriptors, landmarks.descriptors)
    spots = np.repeat(keypoints.points, _CONFIG.nearest, axis=0)
    views = landmarks.views[nearest].astype(np.int64)
    places = np.empty((len(nearest), 2))
    for view, camera in enumerate(cameras):
        mine = views == view
        places[mine] = project(landmarks.points[nearest[mine]].astype(np.float64), camera)
    names, loudness, maps = agreement_of_views(views, spots, places, gain)
    found = []
    for n in np.argsort(-loudness, kind="stable")[: int((loudness > 0).sum())]:
        a, b, c, d = maps[n]
        off = (spots @ (1, 1j)) * complex(a, b) + complex(c, d) - places @ (1, 1j)
        reach = _CONFIG.reach * _CONFIG.tolerance * min(1.0, np.hypot(a, b)) ** 0.5
        agreeing = np.flatnonzero((views == names[n]) & (np.abs(off) < reach))
        camera = _camera(cameras[names[n]], maps[n], size)
        found.append(VotedView(float(loudness[n]), camera, agreeing // _CONFIG.nearest, nearest[agreeing]))
    return found


def _neighbors(queries: npt.NDArray[np.uint8], targets: npt.NDArray[np.uint8]) -> tuple[Int64, Float64]:
    """The nearest targets of each query, in one row, and how much nearer each is than the next one, 0 to 1."""
    import cv2

    # Squares of whole numbers: exact, whatever the machine.
    distance, near = cv2.batchDistance(queries, targets, cv2.CV_32S, normType=cv2.NORM_L2SQR, K=_CONFIG.nearest + 1)
    away = np.sqrt(distance, dtype=np.float64)
    gains = 1.0 - away[:, : _CONFIG.nearest] / np.maximum(away[:, _CONFIG.nearest :], 1e-12)
    return near[:, : _CONFIG.nearest].reshape(-1).astype(np.int64), gains.reshape(-1)


def _camera(view: Camera, carried: Float64, size: tuple[int, int]) -> Camera:
    """The camera of a picture of which the view shows what the map `carried` (4,) takes there."""
    turn, shift = complex(carried[0], carried[1]), complex(carried[2], carried[3])
    middle = view.K[:2, 2]
    place = (complex(*middle) - shift) / turn
    scale = 1.0 / abs(turn)
    return swung(view, middle, np.array([place.real, place.imag]), -float(np.angle(turn)), scale, size[::-1])
