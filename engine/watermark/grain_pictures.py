"""What a picture says about every chip of the grain: how its residual answers to a move of each centre and each size.

The gradient is that of the reference's picture, where the reference lies; neither chip nor strength of a mark enters.
"""

from dataclasses import dataclass

import numpy as np

from engine.model import Float32, GaussianModel
from engine.raster import Rendering, View, backward
from engine.watermark.config import CONFIG
from engine.watermark.grain import ATTRIBUTES, Grain, pull_along, thin


@dataclass(frozen=True, eq=False)
class GrainView:
    """The unmarked reference as one camera sees it, without antialiasing, and the grain that is looked for in it."""

    rendering: Rendering
    grain: Grain

    def weights(self) -> Float32:
        """(6 N,) the amplitudes: the matched filter's weights; 0 where no size is moved."""
        model = self.rendering.model
        weights = np.empty((len(model), ATTRIBUTES), dtype=np.float32)
        weights[:, :3] = self.grain.center
        weights[:, 3:] = np.where(thin(model.log_scales), 0.0, self.grain.scale)
        return weights.reshape(-1)

    def pull(self, view: View, cotangent: Float32) -> tuple[Float32, Float32]:
        """A cotangent image (H, W, 3) pulled back to colours (N, 3), as `view` draws them, and to centres, in `units`
        along the own axes, and log scales (6 N,)."""
        answer = backward(self.rendering, cotangent)
        colors = answer.colors if view is self.rendering.view else view.backward_colors(cotangent)
        return colors, _along_own_axes(self.rendering.model, answer.means, answer.log_scales)


def _along_own_axes(model: GaussianModel, means: Float32, log_scales: Float32) -> Float32:
    """(6 N,) gradients by the grain's own coordinates, from those by centres and log scales (N, 3)."""
    out = np.empty((len(model), ATTRIBUTES), dtype=np.float32)
    limits = np.array([CONFIG.grain.flat, CONFIG.grain.thinnest])
    pull_along(model.log_scales, model.quats, means, log_scales, limits, out)
    return out.reshape(-1)
