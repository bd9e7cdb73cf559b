"""Where a suspect model is, found by looking at it: for models that share no Gaussian with the reference.

A model trained anew from renders of a stolen one shows the same scene with other Gaussians, and its thief may have
turned and scaled it besides.

1. Render the suspect from views of its own, until some are recognised against the record's landmarks.
2. Each recognised view gives a whole similarity: the rotation of its camera, the ratio of the depths in the picture.
   What most of them agree on is the start.
3. The similarity between the cameras' centres and directions, of those that agree.

Nothing here knows the secret of the mark: only the unmarked reference, its landmarks and the suspect enter. So the
place is one hypothesis of the claim, however many views were rendered.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy

from engine.flows.verify.config import CONFIG
from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.similarity import mirror_model, transform_model
from engine.numerics.time_budget import UNLIMITED, TimeBudget
from engine.numerics.umeyama import Similarity, robust_umeyama
from engine.pictures.camera.camera_search import CameraConfig, find_camera
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import render_depth

_CONFIG = CONFIG.appearance
RECOGNITION = CameraConfig(other_focals=(), framed=False, uneven=False)
"""The focal length of a render is known, so no other is tried, and nothing is around it."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """A view of the suspect that was recognised."""

    picture: Float32  # (H, W, 3) render of the suspect or of its mirror image, 0..1
    own: Camera  # where it was rendered from, in that one's frame
    found: Camera  # the same camera in the reference's frame
    # Median depth of what both models show in this view, each in its own scene units
    own_depth: float
    found_depth: float
    mirrored: bool = False  # it is the mirror image, `mirror_model` of the suspect, that is seen

    @property
    def similarity(self) -> Similarity:
        """What takes the suspect to the reference, from this view alone."""
        R = self.found.viewmat[:3, :3].T @ self.own.viewmat[:3, :3]
        scale = self.found_depth / self.own_depth
        return Similarity(scale, R, self.found.position - scale * R @ self.own.position)


@dataclass(frozen=True, eq=False)
class Place:
    """Where the suspect is."""

    similarity: Similarity  # x_reference = scale * R @ x_suspect + t, of the suspect or its mirror image
    sightings: tuple[Sighting, ...]  # those that agree with it
    views: int  # views rendered

    @property
    def mirrored(self) -> bool:
        """Whether it is the suspect's mirror image that lies there."""
        return self.sightings[0].mirrored

    def place(self, suspect: GaussianModel) -> GaussianModel:
        """The suspect where the reference lies, mirrored first if it is a mirror image."""
        seen = mirror_model(suspect) if self.mirrored else suspect
        return transform_model(seen, self.similarity.scale, self.similarity.R, self.similarity.t)


def place_by_looking(
    suspect: GaussianModel,
    reference: GaussianModel,
    landmarks: Landmarks,
    advance: Callable[[float], None] | None = None,
    budget: TimeBudget = UNLIMITED,
) -> Place | None:
    """Find the similarity between two models from what they look like.

    None when fewer than two views were recognised that agree: the suspect shows something else.

    Parameters
    ----------
    reference : GaussianModel
        The unmarked reference.
    landmarks : Landmarks
        Of the reference, from its record.
    advance : callable, optional
        Called with the fraction done, 0 to 1, after every view.
    budget : TimeBudget, optional
        Ends the search between two views.
    """
    seen: list[Sighting] = []
    agreeing: list[Sighting] = []
    turns = _turns()
    total, count = _CONFIG.views * len(turns), 0
    for camera in _views(suspect, turns):
        if not budget.allows("further views to place the model by"):
            break
        count += 1
        sighting = _look(suspect, camera, reference, landmarks)
        if advance is not None:
            advance(count / total)
        if sighting is not None:
            seen.append(sighting)
            agreeing = _most_agreeing(seen)
        if len(agreeing) >= (_CONFIG.fair if count % _CONFIG.views == 0 else _CONFIG.enough):
            break
        # A scene that shows nothing familiar with its own side up or down is another scene.
        if count == 3 * _CONFIG.views and not seen:
            break
    if len(agreeing) < _CONFIG.least:
        return None
    return Place(_solve(agreeing), tuple(agreeing), count)


def _turns() -> list[Float64]:
    """Sides of a model that may be up: as it is, upside down, then the four others."""
    axes = [(0.0, 0, 0), (180, 0, 0), (90, 0, 0), (-90, 0, 0), (0, 0, 90), (0, 0, -90)]
    return [scipy.spatial.transform.Rotation.from_euler("xyz", angles, degrees=True).as_matrix() for angles in axes]


def _views(suspect: GaussianModel, turns: list[Float64]) -> Iterator[Camera]:
    """Views all around, one turn of the model after the other, in the suspect's own frame."""
    for R in turns:
        turned = transform_model(suspect.with_(sh=suspect.sh[:, :1]), 1.0, R, np.zeros(3))
        for camera in make_rig(turned, _CONFIG.views, *_CONFIG.view_size, extent=measure_extent(turned)):
            viewmat = camera.viewmat.copy()
            viewmat[:3, :3] = viewmat[:3, :3] @ R
            yield Camera(viewmat, camera.K, camera.width, camera.height)


def _look(suspect: GaussianModel, camera: Camera, reference: GaussianModel, landmarks: Landmarks) -> Sighting | None:
    image, alpha, depth = render_depth(suspect, camera)
    picture = np.clip(image, 0.0, 1.0)
    recognition = replace(RECOGNITION, focals=(camera.K[0, 0] / camera.width,))
    found = find_camera(landmarks, reference, picture, recognition)
    if found is None or abs(np.log(found.camera.K[0, 0] / camera.K[0, 0])) > _CONFIG.most_zoomed:
        return None
    if found.mirrored:
        camera, picture = mirrored_camera(camera), found.face(picture)
        alpha, depth = alpha[:, ::-1], depth[:, ::-1]
    _, known_alpha, known_depth = render_depth(reference, found.camera)
    both = (alpha > 0.7) & (known_alpha > 0.7) & (depth > 0) & (known_depth > 0)
    if both.sum() < 100:
        return None
    depths = float(np.median(depth[both])), float(np.median(known_depth[both]))
    return Sighting(picture, camera, found.camera, *depths, found.mirrored)


def mirrored_camera(camera: Camera) -> Camera:
    """The camera that sees of `mirror_model(model)` what this one sees of the model, turned over left to right."""
    viewmat, K = camera.viewmat.copy(), camera.K.copy()
    viewmat[0, 1:] *= -1  # x of the scene and x of the camera change their signs; the corner has both
    viewmat[1:3, 0] *= -1
    K[0, 2] = camera.width - K[0, 2]
    return Camera(viewmat, K, camera.width, camera.height)


def _most_agreeing(seen: list[Sighting]) -> list[Sighting]:
    """The largest set of sightings that one of them explains."""
    best: list[Sighting] = []
    for first in seen:
        fit = first.similarity
        group = [s for s in seen if s.mirrored == first.mirrored and _agrees(fit, s)]
        if len(group) > len(best):
            best = group
    return best


def _agrees(fit: Similarity, sighting: Sighting) -> bool:
    turn = scipy.spatial.transform.Rotation.from_matrix(sighting.similarity.R @ fit.R.T).as_rotvec()
    gap = np.linalg.norm(fit.apply(sighting.own.position) - sighting.found.position)
    return bool(np.linalg.norm(turn) < _CONFIG.same_turn and gap < _CONFIG.same_place * sighting.found_depth)


def _solve(sightings: list[Sighting]) -> Similarity:
    """The similarity of all sightings: each camera's centre, and a point as far along its axes as the scene is."""
    own = [_markers(s.own, s.own_depth) for s in sightings]
    found = [_markers(s.found, s.found_depth) for s in sightings]
    start = sightings[0].similarity
    return robust_umeyama(np.concatenate(own), np.concatenate(found), start) or start


def _markers(camera: Camera, depth: float) -> Float64:
    """(4, 3) a camera as points."""
    return np.concatenate([camera.position[None], camera.position + depth * camera.viewmat[:3, :3]])
