"""2DGS made from 3DGS.

No trained 2DGS file is at hand, so discs are **made, not trained**: a Gaussian model loses its smallest axis, its
discs are widened by what a 3DGS rasterizer adds to every splat, and their colours are fitted to renders of the
original. What a trained 2DGS has beside (surfaces that agree with each other, normals) this has not; what matters
to a mark is alike: two scales, the ray-splat intersection, colours that a 2DGS viewer shows.
"""

from collections.abc import Callable, Sequence

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig
from engine.lab.sim.fine_tuning import fine_tune
from engine.model import Camera, GaussianModel
from engine.numerics.flattening import flatten
from engine.raster import RasterSettings, render

__all__ = ["fit_colors", "make_discs", "widen"]

FIT_VIEWS, FIT_SIZE, FIT_EPOCHS = 12, 512, 2
"""Views of the regular rig, pixels a side, and passes over them, in which colours are fitted."""


def make_discs(
    model: GaussianModel, epochs: int = FIT_EPOCHS, advance: Callable[[float], None] | None = None
) -> GaussianModel:
    """A 3DGS model as discs that look like it, in its order: flattened, widened, colours fitted (see `fit_colors`)."""
    cameras = make_rig(model, FIT_VIEWS, FIT_SIZE, FIT_SIZE)
    return fit_colors(widen(flatten(model), cameras), model, cameras, epochs, advance)


def widen(discs: GaussianModel, cameras: Sequence[Camera]) -> GaussianModel:
    """Discs with the dilation that 3DGS adds on the screen folded into their scales.

    EWA splatting adds `eps2d` square pixels to both variances of every splat, 2DGS nothing. Here that amount goes
    to the two scales, at the mean magnification (pixels a scene unit) of the cameras that see the disc's centre in
    front of them, which have the size in pixels at which the discs are to look right. Measured on real scenes: 4 to
    5 dB.
    """
    if not cameras:
        raise InputError("discs are widened for cameras, none was given")
    settings = RasterSettings()
    magnification, seen = np.zeros(len(discs)), np.zeros(len(discs))
    for camera in cameras:
        z = discs.means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
        ahead = z > settings.near
        magnification[ahead] += np.sqrt(camera.K[0, 0] * camera.K[1, 1]) / z[ahead]
        seen += ahead
    pixels = magnification / np.maximum(seen, 1.0)  # of one scene unit; 0 where no camera looks
    added = settings.eps2d / np.maximum(pixels, 1e-30) ** 2 * (seen > 0)
    log_scales = discs.log_scales.copy()
    variances = np.exp(2.0 * log_scales[:, :2].astype(np.float64)) + added[:, None]
    log_scales[:, :2] = 0.5 * np.log(variances)
    return flatten(discs.with_(log_scales=log_scales))


def fit_colors(
    discs: GaussianModel,
    original: GaussianModel,
    cameras: Sequence[Camera],
    epochs: int,
    advance: Callable[[float], None] | None = None,
) -> GaussianModel:
    """The discs with SH fitted to renders of the original 3DGS model; geometry and opacity are held.

    So many passes of Adam over the views (see `fine_tune`); 0 gives the discs back. `advance` is told the part done.
    """
    if epochs == 0:
        return discs
    truth = [np.clip(render(original, camera), 0.0, 1.0) for camera in cameras]
    return discs.with_(sh=fine_tune(discs, cameras, truth, epochs, trained="colors", advance=advance).sh)
