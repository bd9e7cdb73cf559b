"""From one suspect picture, already aligned to a render of the reference, to evidence for every chip (DESIGN 4.8).

The residual is weighted (its subbands by how reliable they look, or by the exact score of the JPEG quantiser it
went through), pulled back by the rasterizer's VJP, and summed over the members of each code vector. Inputs are the
suspect and the unmarked reference alone, never a chip.
"""

from collections.abc import Callable, Sequence

import numpy as np

from engine.model import SH_C0, Bool, Float32, Float64
from engine.pictures.jpeg_score import block_spread, find_quality, jpeg_cotangent, match_exposure
from engine.pictures.light import fit_colors
from engine.pictures.residual import image_cotangent
from engine.pictures.tone_curve import Toned
from engine.raster import View
from engine.watermark.layout import Layout
from engine.watermark.model_evidence import Evidence
from engine.watermark.spreading import public_signs

CLIP = 8.0
"""Evidence of one chip saturates at this many medians of its carrier's: a few code vectors that fill the picture
(fog, a wall) would otherwise outweigh thousands."""


def gather_image_evidence(
    layout: Layout,
    view: View,
    reference: Float32,
    warped: Float32,
    mask: Bool,
    mark_image: Float32,
    mark_signs: Float64,
    through: Float32 | None = None,
) -> Evidence:
    """Evidence of one picture.

    y is in units of precision times displacement, so evidence of several pictures is summed (`add_evidence`).

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
        evidence this picture could have held (the power of a "not marked" answer): no part of y and weights.
    mark_signs : (C,) float64
        Sign of each chip's displacement in that mark.
    through : (H, W, 3) float32, optional
        What of the picture is not the model's but shines through it (`pictures.background`).
    """
    weights = layout.amplitudes
    pull = _reader(layout, view, reference, warped, mask, through)
    pulled = pull(reference)
    y = _gathered(layout, pulled)
    limits = _limits(weights * y, len(layout.directions[0]))
    y = _saturate(y, weights, limits)
    # How y answers to the mark, through the weights this very picture got; signed, so that what neighbouring code
    # vectors talk into each other cancels in the matched sum as it does in the claim. It is what y loses when the
    # reference carries the mark: right for a marked suspect and for an unmarked one.
    response = y - _saturate(_gathered(layout, pull(reference + mark_image)), weights, limits)
    return Evidence(y, weights, mark_signs * response, (pulled,))


def gather_again(layout: Layout, pulled: Sequence[Float32]) -> Evidence:
    """The same pictures read for the cells of another copy of the asset, without what to expect."""
    weights, carriers = layout.amplitudes, len(layout.directions[0])
    y = np.zeros(layout.chips)
    for one in pulled:
        part = _gathered(layout, one)
        y += _saturate(part, weights, _limits(weights * part, carriers))
    return Evidence(y, weights if pulled else np.zeros(layout.chips), np.zeros(layout.chips))


def gather_displacements(layout: Layout, view: View, reference: Float32, picture: Float32, quality: int) -> Float64:
    """(C,) `Evidence.y` alone, in a third of its time, of a picture of which all but the mark is known.

    The picture (H, W, 3) lies in the reference's pixels and colours and went through JPEG of that `quality`.
    """
    everywhere = np.ones(picture.shape[:2], dtype=bool)
    spread = block_spread(_public_pattern(layout, view))
    y = _gathered(layout, _pulled(view, jpeg_cotangent(reference, picture, everywhere, spread, quality)))
    return _saturate(y, layout.amplitudes, _limits(layout.amplitudes * y, len(layout.directions[0])))


def _pulled(view: View, cotangent: Float32) -> Float32:
    """(N, 3) a cotangent image (H, W, 3) pulled back to the Gaussians' colours."""
    return view.backward_colors(np.ascontiguousarray(cotangent))


def _gathered(layout: Layout, pulled: Float32) -> Float64:
    """(C,) the same summed over each chip, in SH units."""
    return np.asarray(SH_C0 * layout.gather(pulled))


def _reader(
    layout: Layout, view: View, reference: Float32, warped: Float32, mask: Bool, through: Float32 | None
) -> Callable[[Float32], Float32]:
    """Function from a render (H, W, 3) that the picture is held against to what it says of each Gaussian (N, 3): the
    reference, or nearly."""
    quality = find_quality(warped)
    spread = block_spread(_public_pattern(layout, view)) if quality else None

    own = warped if through is None else warped - through
    toned = fit_colors(reference, own, mask) if quality is None and mask.any() else None

    def pull(known: Float32) -> Float32:
        if quality is not None and spread is not None:
            exposed = match_exposure(known, own, mask)
            if through is not None:  # the coder saw both
                exposed = np.clip(exposed + through, 0.0, 1.0)
            return _pulled(view, jpeg_cotangent(exposed, warped, mask, spread, quality))
        # The colours of a render that differs by a mark are the reference's: fitting them again takes half of the time.
        near = toned and Toned(toned.predicted + toned.slope * (known - reference), toned.slope)
        return _pulled(view, image_cotangent(known, own, mask, near))

    return pull


def _public_pattern(layout: Layout, view: View) -> Float32:
    """(H, W, 3) what a mark of these amplitudes and public signs adds to a picture: the spectrum to expect."""
    signs = public_signs(layout.chips)
    shown = layout.displace(layout.amplitudes * signs)[:, :3]  # seen from anywhere: DC
    return view.render(np.ascontiguousarray(SH_C0 * shown))[0]


def _limits(evidence: Float64, carriers: int) -> Float64:
    """(C,) where evidence saturates: CLIP medians of what the picture shows, for each carrier."""
    limits = np.empty_like(evidence)
    for r in range(carriers):
        shown = np.abs(evidence[r::carriers])
        shown = shown[shown > 0]
        limits[r::carriers] = CLIP * float(np.median(shown)) if len(shown) else 1.0
    return limits


def _saturate(y: Float64, weights: Float64, limits: Float64) -> Float64:
    """y such that w y = limit tanh(w y / limit): an odd function of the suspect's evidence, blind to chips."""
    return np.where(weights > 0, limits * np.tanh(weights * y / limits) / np.maximum(weights, 1e-300), 0.0)


def add_evidence(parts: Sequence[Evidence]) -> Evidence:
    """Sum the evidence of several pictures of one asset.

    Every part has the same weights (the plan's), so the sum of w y per chip is a fixed function of the suspect
    pictures and each secret sign still enters once: the theorem of 4.9 stands.
    """
    y = np.sum([part.y for part in parts], axis=0)
    pulled = tuple(one for part in parts for one in part.pulled)
    return Evidence(y, parts[0].weights, np.sum([part.signal for part in parts], axis=0), pulled)
