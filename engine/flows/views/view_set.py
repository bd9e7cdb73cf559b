"""A model seen from a set of cameras: geometry prepared once, colours rendered as often as needed.

And the paper's early stop (Eq 8) for a model as it comes: W^freq as its own views show it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from engine.compress.impact import frequency_impact, measure_impact, ranks
from engine.flows.embed.variant import AtView
from engine.flows.views.camera_rig import make_rig
from engine.flows.views.config import CONFIG
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import EarlyStop, View, prepare_view, render, sh_colors


@dataclass(frozen=True, eq=False)
class ViewSet:
    """Prepared views of one geometry."""

    model: GaussianModel
    cameras: Sequence[Camera]
    views: Sequence[View]
    frames: Sequence[GaussianModel]  # the model as each view sees it: itself, unless it moves
    images: Sequence[Float32]  # (H, W, 3) each: renders of the model itself

    def render(self, index: int, sh: Float32) -> Float32:
        """(H, W, 3) one view with other colours, sh (N, K, 3)."""
        colors = sh_colors(sh, self.frames[index].means, self.cameras[index].position.astype(np.float32))
        return self.views[index].render(colors)[0]

    def worst(self, sh: Float32, metric: Callable[[Float32, Float32], float] = psnr) -> float:
        """Worst view's metric of other colours against the model's own."""
        return min(metric(image, self.render(k, sh)) for k, image in enumerate(self.images))


def look(
    model: GaussianModel, cameras: Sequence[Camera], advance: Callable[[float], None], at_view: AtView | None = None
) -> ViewSet:
    """Prepare and render all views, of a moving model each at its moment."""
    views, frames, images = [], [], []
    for k, camera in enumerate(cameras):
        frame = model if at_view is None else at_view(model, k)
        view = prepare_view(frame, camera)
        colors = sh_colors(frame.sh, frame.means, camera.position.astype(np.float32))
        views.append(view)
        frames.append(frame)
        images.append(view.render(colors)[0])
        advance((k + 1) / len(cameras))
    return ViewSet(model, cameras, views, frames, images)


@dataclass(frozen=True, eq=False)
class SeenView:
    """One camera, and what it sees of the original."""

    camera: Camera
    image: Float32  # (H, W, 3)

    def psnr_of(self, model: GaussianModel) -> float:
        """dB of what it sees of another model."""
        return psnr(self.image, render(model, self.camera))


def worst_psnr_against(images: Sequence[Float32], cameras: Sequence[Camera]) -> Callable[[GaussianModel], float]:
    """Function from a candidate model to its worst view's PSNR against given renders."""
    return lambda candidate: min(psnr_by_view(images, cameras, candidate))


def psnr_by_view(
    images: Sequence[Float32], cameras: Sequence[Camera], model: GaussianModel, at_view: AtView | None = None
) -> list[float]:
    """dB of a model against given renders, of each."""
    frames = (model if at_view is None else at_view(model, k) for k in range(len(cameras)))
    return [psnr(image, render(frame, camera)) for image, frame, camera in zip(images, frames, cameras, strict=True)]


def early_stop(model: GaussianModel, tau: float) -> EarlyStop:
    """The stop at this tau. W is a rank in (0, 1], as in Eq 5: the paper gives its sum no unit."""
    size = CONFIG.frequency_size
    seen = look(model, make_rig(model, CONFIG.frequency_views, size, size), lambda _: None)
    impact = measure_impact(model, seen.views, seen.images)
    return EarlyStop(ranks(frequency_impact(model, impact)).astype("float32"), tau)


def render_early(model: GaussianModel, camera: Camera, early: EarlyStop, background: float = 0.0) -> Float32:
    """(H, W, 3) as `render`, but pixels end by impact, too."""
    colors = sh_colors(model.sh, model.means, camera.position.astype("float32"))
    return prepare_view(model, camera).render(colors, background, early)[0]
