"""From one suspect picture, already aligned to a render of the reference, to evidence for every chip (DESIGN 4.8).

The residual is weighted (its subbands by how reliable they look), pulled back by the rasterizer's VJP, and summed
over the members of each code vector. Inputs are the suspect and the unmarked reference alone, never a chip.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from engine.model import SH_C0, Bool, Float32, Float64
from engine.raster import View
from engine.watermark.image_residual import image_cotangent
from engine.watermark.layout import Layout
from engine.watermark.model_evidence import Evidence


def gather_image_evidence(
    layout: Layout,
    view: View,
    reference: Float32,
    warped: Float32,
    mask: Bool,
    mark_image: Float32,
    mark_signs: Float64,
) -> Evidence:
    """Evidence of one picture.

    Parameters
    ----------
    layout : Layout
        With the planned (relative) amplitudes: the matched filter's weights.
    view : View
        The reference's geometry at the picture's camera.
    reference : (H, W, 3) float32
        Render of the unmarked reference.
    warped : (H, W, 3) float32
        The picture in the reference's pixels.
    mask : (H, W) bool
        Pixels that carry evidence.
    mark_image : (H, W, 3) float32
        What the mark under test would add to `reference`. With `mark_signs` it serves only to say how much
        evidence this picture could have held (the power of a "not marked" answer); y and weights do not depend
        on it.
    mark_signs : (C,) float64
        Sign of each chip's displacement in that mark.

    Returns
    -------
    Evidence
        y is in units of precision times displacement, so evidence of several pictures is summed (`add_evidence`).
    """
    pull = _puller(layout, view)
    cotangent = image_cotangent(reference, warped, mask)
    y = pull(cotangent)
    weights = layout.amplitudes
    # How y answers to the mark, through the weights this very picture got; signed, so that what neighbouring code
    # vectors talk into each other cancels in the matched sum as it does in the claim.
    response = pull(image_cotangent(reference, warped + mark_image, mask) - cotangent)
    return Evidence(y, weights, mark_signs * response)


def _puller(layout: Layout, view: View) -> Callable[[Float32], Float64]:
    return lambda cotangent: SH_C0 * layout.gather(view.backward_colors(np.ascontiguousarray(cotangent)))


def add_evidence(parts: Sequence[Evidence]) -> Evidence:
    """Sum the evidence of several pictures of one asset.

    Every part has the same weights (the plan's), so the sum of w y per chip is a fixed function of the suspect
    pictures and each secret sign still enters once: the theorem of 4.9 stands.
    """
    total = Evidence(parts[0].y.copy(), parts[0].weights, parts[0].signal.copy())
    for part in parts[1:]:
        total.y[:] += part.y
        total.signal[:] += part.signal
    return total
