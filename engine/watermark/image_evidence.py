"""From one suspect picture, already aligned to a render of the reference, to evidence for every chip (DESIGN 4.8).

The residual is weighted (its subbands by how reliable they look, or by the exact score of the JPEG quantiser it
went through), pulled back by the rasterizer's VJP, and summed over the members of each code vector. Inputs are the
suspect and the unmarked reference alone, never a chip. The grain's chips are read from this residual
(`grain_pictures`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import TypeVar

import numpy as np

from engine.kernels.jit import parallel_kernel, share_of
from engine.kernels.thread_crew import run_turns, thread_count
from engine.model import SH_C0, Bool, Float32, Float64
from engine.numerics.tables import first_at_least
from engine.pictures.alignment.blur import Blur
from engine.pictures.alignment.color_change import ColorChange
from engine.pictures.alignment.residual import image_cotangent
from engine.pictures.alignment.tone_and_light import Toned, fit_colors
from engine.pictures.jpeg.coded_blocks import agreement, block_spread, find_grid, jpeg_cotangent, match_exposure
from engine.pictures.jpeg.coded_chroma import CodedChroma
from engine.pictures.jpeg.config import CONFIG as JPEG
from engine.raster import View
from engine.watermark.config import CONFIG
from engine.watermark.grain import ATTRIBUTES
from engine.watermark.grain_pictures import GrainView
from engine.watermark.layout import Layout
from engine.watermark.model_evidence import Evidence
from engine.watermark.spreading import public_signs

_CONFIG = CONFIG.evidence


Floats = TypeVar("Floats", Float32, Float64)


@dataclass(frozen=True, eq=False)
class PictureEvidence:
    """What pictures say of every chip, (C,) each, in units of precision times displacement: of several it is the sum.

    Each is there as it came and saturated (`held_...`), so that no chip speaks for a thousand. The responses are what y
    loses where the reference carries a mark of public signs: how loudly each chip would speak, whatever its secret is.
    """

    parts: tuple[tuple[int, int], ...]  # of each layer, how many chips it has, of how many kinds that take turns
    weights: Float32  # amplitudes: the matched filter's
    y: Float32
    response: Float32
    held_y: Float32
    held_response: Float32
    pulled: tuple[Float32, ...]  # (N, 3) of each picture: see `Evidence`

    @property
    def nbytes(self) -> int:
        """Bytes that it takes, without what it is pulled by."""
        return sum(each.nbytes for each in (self.weights, self.y, self.response, self.held_y, self.held_response))

    @property
    def promise(self) -> float:
        """Z that a mark would come to by its responses: of the pictures and the reference alone, blind to signs."""
        return _promise(self.evidence())[0]

    def plus(self, other: "PictureEvidence") -> "PictureEvidence":
        """Those of two sets of pictures of one asset, together.

        Both have the same weights (the plan's), so the sum of w y per chip is a fixed function of the suspect pictures
        and each secret sign still enters once: the theorem of 4.9 stands.
        """
        return PictureEvidence(
            self.parts,
            self.weights,
            self.y + other.y,
            self.response + other.response,
            self.held_y + other.held_y,
            self.held_response + other.held_response,
            self.pulled + other.pulled,
        )

    def evidence(self, strength: float = 1.0) -> Evidence:
        """Every chip saturated; `strength` times the amplitudes is what is expected."""
        said, layers = self._exact(self.held_y, self.held_response)
        return self._together(said, layers, strength)

    def by_scatter(self, strength: float = 1.0) -> Evidence:
        """These pictures, read otherwise: chips of like response count for what their own scatter leaves of it.

        What an attacker's washing left is loud in a few chips and noise in the rest; of untouched pictures this reads
        less. Both readings are tried, and counted.
        """
        said, layers = self._exact(self.y, self.response)
        for layer, (_, kinds) in zip(layers, self.parts, strict=True):
            _scale_by_scatter(layer, kinds)
        return self._together(said, layers, strength)

    def _exact(self, y: Float32, response: Float32) -> tuple[Evidence, list[Evidence]]:
        """Evidence in double precision, for sums over millions of chips; and its layers, which are views of it."""
        exact = y.astype(np.float64), self.weights.astype(np.float64), response.astype(np.float64)
        said = Evidence(*exact, pulled=self.pulled)
        ends = np.cumsum([0, *(chips for chips, _ in self.parts)])
        each = [slice(a, b) for a, b in pairwise(ends)]
        return said, [Evidence(said.y[part], said.weights[part], said.signal[part]) for part in each]

    def _together(self, said: Evidence, layers: Sequence[Evidence], strength: float) -> Evidence:
        for other in layers[1:]:
            _balance(other, layers[0])
        np.multiply(said.signal, strength, out=said.signal)
        return said


# In place from here on: of ten million Gaussians an array of chips takes half a gigabyte.


def _balance(grain: Evidence, tint: Evidence) -> None:
    """Scale the grain's evidence so that each layer counts for what it should show: z over the norm of each."""
    times = _times(grain, tint)
    if times == 0.0:
        grain.weights[:] = 0.0
        return
    np.multiply(grain.y, times, out=grain.y)
    np.multiply(grain.signal, times, out=grain.signal)


def _times(one: Evidence, other: Evidence) -> float:
    """By which the one's evidence is scaled for each to count for what it should show; 0 where that is nothing."""
    (z_other, norm_other), (z, norm) = _promise(other), _promise(one)
    if not z > 0:
        return 0.0
    return z / z_other * norm_other / norm if z_other > 0 else 1.0


def _promise(layer: Evidence) -> tuple[float, float]:
    """z that a layer would show by its response, and the norm that it would be divided by."""
    squared = 0.0
    for start in range(0, len(layer.y), _CONFIG.rows):
        shown = layer.weights[start : start + _CONFIG.rows] * layer.y[start : start + _CONFIG.rows]
        squared += float(shown @ shown)
    norm = math.sqrt(squared)
    return (float(layer.weights @ layer.signal) / norm if norm > 0 else 0.0), norm


def _scale_by_scatter(layer: Evidence, kinds: int) -> None:
    """Scale chips of like response by response over scatter: the matched filter, as measured."""
    for kind in range(kinds):
        y, weights, signal = layer.y[kind::kinds], layer.weights[kind::kinds], layer.signal[kind::kinds]
        step = max(1, len(y) // _CONFIG.sample)
        loud = np.abs(weights[::step] * signal[::step])
        loud = loud[loud > 0]
        classes = np.arange(1, _CONFIG.alike)
        edges = np.quantile(loud, classes / _CONFIG.alike) if len(loud) else np.zeros(len(classes))
        sums = np.zeros((-(-len(y) // _CONFIG.rows), 2, _CONFIG.alike))
        sum_alike(y, weights, signal, edges, sums, _CONFIG.rows)
        expected, scatter = sums.sum(axis=0)
        scale_alike(y, weights, signal, edges, np.maximum(expected, 0.0) / np.maximum(scatter, 1e-300))


@parallel_kernel
def sum_alike(y, weights, signal, edges, sums, rows, call):  # type: ignore[no-untyped-def]
    """Of each block of so many `rows` of chips, to `sums` (B, 2, A): by classes of |w s| between `edges` (A - 1,), the
    sums of w s and of (w y)^2, of chips whose w s is not 0."""
    for block in share_of(len(sums), call):
        for i in range(block * rows, min((block + 1) * rows, len(y))):
            answer = weights[i] * signal[i]
            if answer != 0.0:
                alike = first_at_least(edges, abs(answer))
                sums[block, 0, alike] += answer
                sums[block, 1, alike] += (weights[i] * y[i]) ** 2


@parallel_kernel
def scale_alike(y, weights, signal, edges, scales, call):  # type: ignore[no-untyped-def]
    """Multiply y and s of each chip by what its class is scaled by; those whose w s is 0 become 0."""
    for i in share_of(len(y), call):
        answer = weights[i] * signal[i]
        scale = scales[first_at_least(edges, abs(answer))] if answer != 0.0 else 0.0
        y[i] *= scale
        signal[i] *= scale


@dataclass(frozen=True, eq=False)
class PublicMark:
    """What a mark of the layout's amplitudes and *public* signs would add to the reference: no secret enters here."""

    image: Float32  # (H, W, 3)
    signs: Float64  # (C,) sign of each chip's displacement in it
    blur: Blur | None = None  # of the picture; `image` has it
    steep: Float32 | None = None  # (N, 3) share of a change of each Gaussian's colors that the viewer shows
    change: ColorChange | None = None  # of the colors of the model that it shows; `image` has it


def gather_image_evidence(
    layout: Layout,
    view: View,
    reference: Float32,
    warped: Float32,
    mask: Bool,
    mark: PublicMark,
    through: Float32 | None = None,
    geometry: GrainView | None = None,
) -> PictureEvidence:
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
    mark : PublicMark
        How the picture would show a mark. Where it has a blur, `reference` has it, too, and the weighted residual goes
        through the blur's adjoint before it is pulled back, for the Gaussians are those of the sharp render. Where it
        has a change of colors, what these are pulled by goes through its adjoint, too.
    through : (H, W, 3) float32, optional
        What of the picture is not the model's but shines through it (`pictures.background`).
    geometry : GrainView, optional
        The reference at the same camera where the mark has a grain, whose chips then follow the tint's.
    """
    blur = mark.blur
    readers = _readers(layout, view, reference, warped, mask, through, blur)
    cotangents = [reference] * (2 * len(readers))

    def weigh_one(turn: int) -> None:
        cotangent = readers[turn // 2](reference if turn % 2 == 0 else reference + mark.image)
        cotangents[turn] = np.ascontiguousarray(cotangent if blur is None else blur.adjoint(cotangent))

    run_turns(weigh_one, len(cotangents), thread_count())  # most of it is one thread's, and lets go of Python's lock

    def read(cotangent: Float32) -> tuple[Float32, Float32]:
        if geometry is None:
            pulled, moved = view.backward_colors(cotangent), np.empty(0, dtype=np.float32)
        else:
            pulled, moved = geometry.pull(view, cotangent)
        if mark.steep is not None:  # the viewer's curve comes after what was done to the model
            pulled = pulled * mark.steep
        if mark.change is not None:
            pulled = mark.change.adjoint(pulled)
        return pulled, np.concatenate([_gathered(layout, pulled).astype(np.float32), moved])

    pulled, y = read(cotangents[0])
    # How y answers to a mark, through the weights this very picture got; signed, so that what neighbouring code
    # vectors talk into each other cancels in the matched sum as it does in the claim.
    _, less = read(cotangents[1])
    signs = mark.signs.astype(np.float32)
    parts, weights = [(layout.chips, len(layout.directions[0]))], layout.amplitudes.astype(np.float32)
    if geometry is not None:
        weights = np.concatenate([weights, geometry.weights()])
        parts.append((len(weights) - layout.chips, ATTRIBUTES))
    layers = [slice(end - chips, end) for end, (chips, _) in zip(np.cumsum([n for n, _ in parts]), parts, strict=True)]
    for first in range(2, len(cotangents), 2):
        also, more = read(cotangents[first])
        _, fewer = read(cotangents[first + 1])
        for part in layers:
            shown = _shown(more, fewer, weights, signs, part), _shown(y, less, weights, signs, part)
            times = np.float32(_times(*shown))
            y[part] += times * more[part]
            less[part] += times * fewer[part]
            if part.start == 0:
                pulled = pulled + times * also
    limits = np.concatenate(
        [_limits(weights[part] * y[part], kinds) for part, (_, kinds) in zip(layers, parts, strict=True)]
    )
    held, held_less = _saturate(y, weights, limits), _saturate(less, weights, limits)
    answers = signs * (y - less), held, signs * (held - held_less)
    return PictureEvidence(tuple(parts), weights, y, *answers, (pulled,))


def _shown(y: Float32, less: Float32, weights: Float32, signs: Float32, layer: slice) -> Evidence:
    """A layer of what was read, in double precision; `less` is what is left of y over a mark of these signs."""
    exact = y[layer].astype(np.float64)
    return Evidence(exact, weights[layer].astype(np.float64), signs[layer] * (exact - less[layer]))


def gather_again(layout: Layout, pulled: Sequence[Float32]) -> Evidence:
    """The same pictures read for the cells of another copy of the asset, without what to expect."""
    weights, carriers = layout.amplitudes, len(layout.directions[0])
    y = np.zeros(layout.chips)
    for one in pulled:
        part = _gathered(layout, one)
        y += _saturate(part, weights, _limits(weights * part, carriers))
    return Evidence(y, weights if pulled else np.zeros(layout.chips), np.zeros(layout.chips))


def layer_evidence(
    layout: Layout, view: View, reference: Float32, picture: Float32, geometry: GrainView | None = None
) -> list[Float64]:
    """`PictureEvidence.evidence` of each layer, tint and grain (C,), without what to expect, in half of the time.

    The picture (H, W, 3) lies in the reference's pixels, all of which carry evidence.
    """
    everywhere = np.ones(picture.shape[:2], dtype=bool)
    readers = _readers(layout, view, reference, picture, everywhere, None, None)
    cotangent = np.ascontiguousarray(sum(read(reference) for read in readers), dtype=np.float32)

    def saturated(y: Float64, weights: Float64, kinds: int) -> Float64:
        return np.asarray(weights * _saturate(y, weights, _limits(weights * y, kinds)))

    if geometry is None:
        pulled, grain = view.backward_colors(cotangent), []
    else:
        pulled, moved = geometry.pull(view, cotangent)
        grain = [saturated(moved.astype(np.float64), geometry.weights().astype(np.float64), ATTRIBUTES)]
    return [saturated(_gathered(layout, pulled), layout.amplitudes, len(layout.directions[0])), *grain]


def _gathered(layout: Layout, pulled: Float32) -> Float64:
    """(C,) what each Gaussian's colour is pulled by (N, 3), summed over each chip, in SH units."""
    return np.asarray(SH_C0 * layout.gather(pulled))


def _readers(
    layout: Layout,
    view: View,
    reference: Float32,
    warped: Float32,
    mask: Bool,
    through: Float32 | None,
    blur: Blur | None,
) -> list[Callable[[Float32], Float32]]:
    """Functions from a render (H, W, 3) that the picture is held against, the reference or nearly, to the weighted
    residual (H, W, 3) that is to be pulled back: one, or one of brightness and one of chroma, which a coder treats
    otherwise."""
    own = warped if through is None else warped - through

    def as_coded(known: Float32) -> Float32:
        return known if through is None else np.clip(known + through, 0.0, 1.0)  # the coder saw both

    grid, chroma = find_grid(warped), None
    if grid is not None:
        pattern = _public_pattern(layout, view)
        pattern = grid.part(pattern if blur is None else blur.apply(pattern))
        chroma = CodedChroma.of(grid.part(warped), grid.part(mask), pattern, grid.quality)

        def exposed_as_coded(known: Float32) -> Float32:
            return as_coded(match_exposure(known, own, mask, grid.quality))

        coded = exposed_as_coded(reference)
        agreed = agreement(grid.part(coded), grid.part(warped), grid.part(mask), grid.quality)
        if agreed >= JPEG.own_agreement:
            spread = block_spread(pattern)

            def score(known: Float32) -> Float32:
                exposed = coded if known is reference else exposed_as_coded(known)
                blocks = grid.part(exposed), grid.part(warped), grid.part(mask)
                said = jpeg_cotangent(*blocks, spread, grid.quality)
                if chroma is not None:
                    return grid.whole(said + chroma.cotangent(blocks[0]), exposed.shape)
                plain = Toned(exposed, np.ones_like(exposed))
                of_pixels = image_cotangent(exposed, warped, mask, plain, planes=slice(1, 3))
                return grid.whole(said, exposed.shape) + of_pixels

            return [score]
    toned = fit_colors(reference, own, mask) if mask.any() else None

    def near(known: Float32) -> Toned | None:
        # The colours of a render that differs by a mark are the reference's: fitting them again takes half of the time.
        return toned and Toned(toned.predicted + toned.slope * (known - reference), toned.slope)

    def weigh(known: Float32, planes: slice = slice(3)) -> Float32:
        return image_cotangent(known, own, mask, near(known), planes=planes)

    if grid is None or chroma is None:
        return [weigh]

    def weigh_chroma(known: Float32) -> Float32:
        shown = near(known)
        exposed = known if shown is None else np.clip(shown.predicted, 0.0, 1.0)
        said = grid.whole(chroma.cotangent(grid.part(as_coded(exposed))), known.shape)
        return said if shown is None else said * shown.slope

    return [partial(weigh, planes=slice(1)), weigh_chroma]


def _public_pattern(layout: Layout, view: View) -> Float32:
    """(H, W, 3) what a mark of these amplitudes and public signs adds to a picture: the spectrum to expect."""
    signs = public_signs(layout.chips)
    shown = layout.displace(layout.amplitudes * signs)[:, :3]  # seen from anywhere: DC
    return view.render(np.ascontiguousarray(SH_C0 * shown))[0]


def _limits(evidence: Floats, carriers: int) -> Floats:
    """(C,) where evidence saturates: `clip` medians of what the picture shows, for each carrier."""
    limits = np.empty_like(evidence)
    for r in range(carriers):
        shown = np.abs(evidence[r::carriers])
        shown = shown[shown > 0]
        limits[r::carriers] = _CONFIG.clip * float(np.median(shown)) if len(shown) else 1.0
    return limits


def _saturate(y: Floats, weights: Floats, limits: Floats) -> Floats:
    """y such that w y = limit tanh(w y / limit): an odd function of the suspect's evidence, blind to chips."""
    held = np.tanh(weights * y / limits)
    held *= limits
    return np.asarray(np.divide(held, weights, out=np.zeros_like(held), where=weights > 0))
