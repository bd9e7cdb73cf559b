"""A picture compared with renders of a model: how well a camera explains it, and refinement of the camera."""

from functools import partial

import numpy as np

from engine.model import Camera, Float32, GaussianModel
from engine.numerics.resampling import resized, smooth
from engine.pictures.alignment.background import fill_background
from engine.pictures.alignment.blur import Blur, find_blur
from engine.pictures.camera.camera_motion import CENTERED
from engine.pictures.camera.config import CONFIG, Level
from engine.pictures.camera.keypoint_cameras import match_closer
from engine.pictures.camera.pose_ransac import Hypothesis
from engine.pictures.camera.pose_refinement import DEFAULT_SETTINGS, Drawing, Refined, refine_level
from engine.pictures.landmarks.keypoints import luma
from engine.raster import RasterSettings, render_depth


class Picture:
    """A picture (h, w, 3), 0..1, of which a model may be seen; `mirrored` means turned over left to right."""

    def __init__(self, model: GaussianModel, image: Float32) -> None:
        self.model, self.image = model, image
        gray = luma(image)
        self.grays = (gray, np.ascontiguousarray(gray[:, ::-1]))  # as it is, and turned over
        self.size = gray.shape[1], gray.shape[0]

    def turned(self, mirrored: bool) -> Float32:
        """The picture (h, w, 3), turned over if it is mirrored."""
        return np.ascontiguousarray(self.image[:, ::-1]) if mirrored else self.image

    def closer(self, camera: Camera, mirrored: bool) -> Hypothesis | None:
        """What the picture and a render from this camera agree on."""
        return match_closer(self.model, self.grays[mirrored], camera)

    def refined(
        self,
        camera: Camera,
        level: Level,
        *,
        mirrored: bool,
        settings: RasterSettings = DEFAULT_SETTINGS,
        free: int = CENTERED,
        max_error: float = np.inf,
        blur: Blur | None = None,
    ) -> Refined | None:
        """The camera refined on the picture reduced to a level; see `refine_level`. `max_error` is in longer sides of
        the picture, `blur` in the level's pixels."""
        small, picture = self._reduced(camera, level, mirrored)
        max_pixels = max_error * max(small.width, small.height)
        return refine_level(
            self.model,
            picture,
            small,
            level.iterations,
            level.tolerance,
            Drawing(settings, blur),
            free=free,
            max_error=max_pixels,
        )

    def blur(self, camera: Camera, level: Level, mirrored: bool, settings: RasterSettings) -> Blur | None:
        """How the picture reduced to a level is blurred, as the render from a camera near the right one tells."""
        small, picture = self._reduced(camera, level, mirrored)
        image, alpha, _ = render_depth(self.model, small, settings=settings)
        return find_blur(luma(image), alpha, picture)

    def refined_through_blur(
        self, camera: Camera, level: Level, *, mirrored: bool, settings: RasterSettings, max_error: float
    ) -> tuple[Refined | None, Blur | None]:
        """As `refined`, on renders blurred as the picture is: sharp ones lead its camera astray by pixels, and that the
        blur. And the blur, None where there is none."""
        refine = partial(self.refined, level=level, mirrored=mirrored, settings=settings)
        refined = refine(camera, max_error=max_error)
        blur = None if refined is None else self.blur(refined.camera, level, mirrored, settings)
        if refined is None or blur is None:
            return refined, None
        return refine(self.full(refined.camera), max_error=1.0 / level.side, blur=blur), blur

    def _reduced(self, camera: Camera, level: Level, mirrored: bool) -> tuple[Camera, Float32]:
        """A camera and the brightness of the picture (H, W) at a level."""
        gray = self.grays[mirrored]
        small = camera.with_side(min(level.side, max(gray.shape)))
        return small, resized(gray, small.width, small.height)

    def full(self, camera: Camera) -> Camera:
        """The camera at the picture's size."""
        return camera.resized(*self.size)

    def score(self, refined: Refined, mirrored: bool, settings: RasterSettings = DEFAULT_SETTINGS) -> float:
        """How much likelier the render makes the picture, times how well its edges are the picture's."""
        camera = refined.camera
        picture = resized(self.grays[mirrored], camera.width, camera.height)
        image, alpha, _ = render_depth(self.model, camera, settings=settings)
        behind = fill_background(picture, alpha)
        composed = luma(image) + (0.0 if behind is None else (1.0 - alpha) * behind)
        shown, seen = (_edges(smooth(np.asarray(each, dtype=np.float32), 1.0)) for each in (composed, picture))
        both = float(np.sqrt(np.square(shown).sum() * np.square(seen).sum()))
        return refined.gain * max(float((shown * seen).sum()) / max(both, 1e-9), 0.0)


def _edges(gray: Float32) -> Float32:
    """(2, H, W) gradient of brightness, strong ones counted alike."""
    gy, gx = np.gradient(gray)
    gradient = np.stack([np.asarray(gy), np.asarray(gx)])
    return np.asarray(gradient / np.sqrt(np.square(gradient).sum(axis=0) + CONFIG.full_edge**2), dtype=np.float32)
