"""Pictures for people: a preview of a marked model; a suspect, its asset, and where on the asset the mark was found."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from engine.model import Bool, Camera, Float32, Float64, GaussianModel
from engine.numerics.resampling import smooth
from engine.numerics.similarity import mirror_model
from engine.pictures.alignment import Alignment, align_image
from engine.pictures.background import find_background
from engine.pictures.features import LUMA
from engine.pipeline.drawable import is_drawable
from engine.pipeline.marking import mark_again
from engine.pipeline.rigs import make_rig
from engine.pipeline.sealing import OpenedRecord
from engine.pipeline.searching import Suspect
from engine.pipeline.verification import Verification
from engine.raster import View, prepare_view, render, sh_colors
from engine.watermark.statistics import weighted_evidence

PREVIEW_SIZE = (396, 330)
PREVIEW_GAP = 6
"""Three pictures and two gaps are 1200 pixels wide."""
DIFFERENCE_GAIN = 20
CAPTION_HEIGHT = 24

_TRIAL_VIEWS = 6
_TRIAL_SIZE = 72
_TRIAL_GAUSSIANS = 40_000
_INK, _PAPER = (27, 31, 36), (255, 255, 255)

EVIDENCE_SIZE = (640, 480)
LARGEST_SUSPECT = 800
SUSPECT_GAIN = 5
"""A suspect's difference is drawn so many times as large."""
SAME_SHAPE = 0.02
"""Ratios of sides that differ by less are of one picture, made smaller."""
SURE_CORRELATION = 0.95
"""Above it, a picture lies the right way round."""

CELL_CODES = 32
"""Code vectors of the spatial stage in one cell of the map. A cell shows one sum over these and its share of all
other stages, so not one secret sign can be read off the map."""
FULL_COLOR = 6.0
"""Standard deviations at which a cell has its full colour, at least: pure chance stays pale."""

_FOR = np.array([0.85, 0.37, 0.01], dtype=np.float32)
_AGAINST = np.array([0.13, 0.40, 0.67], dtype=np.float32)
"""Orange and blue: told apart with any colour vision."""
_NEUTRAL = np.array([0.90, 0.90, 0.90], dtype=np.float32)
_BLUR = 5.0
_LEGEND = 40


def choose_view(model: GaussianModel, width: int, height: int) -> Camera:
    """The view that shows most of a model, of a few regular ones; it follows from the model alone, never a key.

    Tried on a thinned-out model in tiny pictures: what counts is how much of the picture is filled, and how much
    there is to see in it.
    """
    thin = model.take(np.arange(0, len(model), max(1, len(model) // _TRIAL_GAUSSIANS)))
    # The gaps that thinning leaves are filled.
    wider = 0.5 * np.log(len(model) / len(thin))
    thin = thin.with_(log_scales=thin.log_scales + np.float32(wider))
    short = min(width, height)  # a rig fits the model to the width of its pictures
    rig = [_widened(camera, width, height) for camera in make_rig(thin, _TRIAL_VIEWS, short, short)]
    shrink = _TRIAL_SIZE / max(width, height)
    scores = []
    for camera in rig:
        small = camera.resized(max(1, round(width * shrink)), max(1, round(height * shrink)))
        image = np.clip(render(thin, small, 0.5), 0.0, 1.0)
        filled = (np.abs(image - 0.5).max(axis=2) > 0.02).mean()
        scores.append(float(filled) + float(image.std()))
    return rig[int(np.argmax(scores))]


def _widened(camera: Camera, width: int, height: int) -> Camera:
    K = camera.K.copy()
    K[0, 2], K[1, 2] = width / 2, height / 2
    return Camera(camera.viewmat, K, width, height)


def draw_preview(path: Path, original: GaussianModel, marked: GaussianModel) -> None:
    """Original, marked, and twenty times what was changed, side by side."""
    camera = choose_view(original, *PREVIEW_SIZE)
    view = prepare_view(original, camera)
    position = camera.position.astype(np.float32)
    before = np.clip(view.render(sh_colors(original.sh, original.means, position))[0], 0.0, 1.0)
    if marked.means is original.means and marked.log_scales is original.log_scales:
        after = np.clip(view.render(sh_colors(marked.sh, marked.means, position))[0], 0.0, 1.0)
    else:  # pruned: a geometry of its own
        after = np.clip(render(marked, camera), 0.0, 1.0)
    change = np.clip(0.5 + DIFFERENCE_GAIN * (after - before), 0.0, 1.0)
    width, height = PREVIEW_SIZE
    sheet = Image.new("RGB", (3 * width + 2 * PREVIEW_GAP, height + CAPTION_HEIGHT), _PAPER)
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=14)
    captions = ("Original", "Marked", f"Difference x{DIFFERENCE_GAIN} (grey: no change)")
    for column, (caption, image) in enumerate(zip(captions, (before, after, change), strict=True)):
        left = column * (width + PREVIEW_GAP)
        pen.text((left + 2, 3), caption, fill=_INK, font=font)
        sheet.paste(to_picture(image), (left, CAPTION_HEIGHT))
    save_png(sheet, path)


def draw_evidence(folder: Path, opened: OpenedRecord, found: Verification, suspect: Suspect) -> dict[str, str]:
    """Draw `suspect`, `asset`, `heatmap` and, where both are seen from one camera, `difference`; names of their files.
    A suspect that its Gaussians gave away, and that would take hours to draw, is not shown.

    The asset is drawn with its mark, as it was delivered: claims are handed out, and two pictures from one camera, with
    the mark and without, would tell its signs.
    """
    marked = mark_again(opened)
    shown = next((number for number, camera in enumerate(found.cameras) if camera is not None), None)
    known = found.cameras[shown] if shown is not None else None
    if known is not None:
        camera = known.with_side(min(EVIDENCE_SIZE[0], max(known.width, known.height)))
    else:
        camera = choose_view(marked, *EVIDENCE_SIZE)
    view = prepare_view(marked, camera)
    image, alpha = view.render(sh_colors(marked.sh, marked.means, camera.position.astype(np.float32)))
    image = np.clip(image, 0.0, 1.0)
    pictures = {"asset": to_picture(image), "heatmap": _heatmap(opened, found, view, image, alpha)}
    laid: tuple[Float32, Bool] | None = None
    if suspect.model is not None and is_drawable(suspect.model):
        seen = np.clip(_suspect_view(suspect.model, found, camera), 0.0, 1.0)
        pictures["suspect"] = to_picture(seen)
        laid = (seen, np.ones(seen.shape[:2], dtype=bool)) if found.claim.transform is not None else None
    elif suspect.pictures:
        picture = suspect.pictures[shown or 0]
        pictures["suspect"] = to_picture(picture, LARGEST_SUSPECT)
        laid = _laid_over(picture, image, alpha) if known is not None else None
    if laid is not None:
        change = np.clip(0.5 + SUSPECT_GAIN * (laid[0] - image), 0.0, 1.0)
        pictures["difference"] = to_picture(np.where(laid[1][..., None], change, np.float32(1.0)))
    for name, drawn in pictures.items():
        save_png(drawn, folder / f"{name}.png")
    return {name: f"{name}.png" for name in pictures}


def _laid_over(picture: Float32, image: Float32, alpha: Float32) -> tuple[Float32, Bool] | None:
    """A suspect picture in the pixels of the asset's render, less what shines through from behind, and where it can be
    compared; None where it cannot be laid over it."""
    height, width = alpha.shape
    small = to_picture(picture)
    if abs(width / height - small.width / small.height) < SAME_SHAPE:
        small = small.resize((width, height), reducing_gap=2.0)
    best: Alignment | None = None
    for hand in (1, -1):  # as it is, and turned over left to right
        faced = np.asarray(small, dtype=np.float32)[:, ::hand] / np.float32(255.0)
        behind = find_background(faced, alpha) if faced.shape == image.shape else None
        fit = align_image(image, faced if behind is None else faced - behind.through)
        if fit is not None and (best is None or fit.correlation > best.correlation):
            best = fit
        if best is not None and best.correlation > SURE_CORRELATION:
            break
    return None if best is None else (best.warped, best.mask)


def _suspect_view(model: GaussianModel, found: Verification, camera: Camera) -> Float32:
    """From the reference's camera where the suspect was registered to it, else from one of its own.

    The camera moves, not the model: x_reference = s R x + t is seen by V as x is by the camera below, all lengths
    divided by s. A mirror image is mirrored back first.
    """
    transform = found.claim.transform
    if transform is None:
        return render(model, choose_view(model, *EVIDENCE_SIZE))
    if transform.get("mirrored"):
        model = mirror_model(model)
    viewmat = camera.viewmat.copy()
    turn = viewmat[:3, :3]
    viewmat[:3, 3] = (turn @ transform["translation"] + viewmat[:3, 3]) / transform["scale"]
    viewmat[:3, :3] = turn @ transform["rotation"]
    return render(model, Camera(viewmat, camera.K, camera.width, camera.height))


def cell_scores(opened: OpenedRecord, found: Verification) -> tuple[Float64, Bool]:
    """How much each cell of the asset speaks for the mark: for each of N Gaussians, by its cell, `(z, seen)`.

    `z`, (N,) float64, is the cell's share of the claim's statistic in standard deviations, around 0 +- 1 where there is
    no mark; `seen`, (N,) bool, whether the suspect says anything about it (never where a Gaussian is unmarked).
    """
    layout, evidence = opened.layout, found.evidence
    tint = slice(layout.chips)  # the grain has no cells
    terms = weighted_evidence(evidence.y[tint], evidence.weights[tint]) * opened.spreading.signs(opened.message)
    # Neighbouring numbers of stage 0 are neighbours in the scene. Only codes that carry something count: a cell of few
    # would show their secret signs.
    carries = (layout.split(layout.amplitudes)[0] > 0).any(axis=1)
    carries &= np.bincount(layout.labels[0], minlength=layout.codes[0]) > 0
    cells = max(1, int(carries.sum()) // CELL_CODES)
    group = np.clip((np.cumsum(carries) - 1) // CELL_CODES, 0, cells - 1)
    cell = group[layout.labels[0]]
    total, variance = np.zeros(cells), np.zeros(cells)
    for term, label, codes in zip(layout.split(terms), layout.labels, layout.codes, strict=True):
        members = np.bincount(cell * codes + label, minlength=cells * codes).reshape(cells, codes)
        share = members / np.maximum(members.sum(axis=0), 1)
        total += share @ term.sum(axis=1)
        variance += share**2 @ (term**2).sum(axis=1)
    z = np.divide(total, np.sqrt(variance), out=np.zeros(cells), where=variance > 0)
    return z[cell], (variance > 0)[cell] & carries[layout.labels[0]]


def _heatmap(opened: OpenedRecord, found: Verification, view: View, image: Float32, alpha: Float32) -> Image.Image:
    """The cells' scores over a grey picture of the asset, with a scale."""
    z, seen = cell_scores(opened, found)
    blended = view.render(np.stack([np.where(seen, z, 0.0), seen], axis=1).astype(np.float32))[0]
    weight = smooth(blended[..., 1], _BLUR)
    score = smooth(blended[..., 0], _BLUR) / np.maximum(weight, 1e-3)
    limit = max(FULL_COLOR, float(np.quantile(np.abs(z[seen]), 0.9)) if seen.any() else 0.0)
    tint = _diverging(np.asarray(score / limit, dtype=np.float32))
    tint += (1.0 - np.clip(weight, 0.0, 1.0))[..., None] * (_NEUTRAL - tint)
    grey = np.clip(image, 0.0, 1.0) @ LUMA
    shaded = tint * (0.3 + 0.7 * grey)[..., None]
    canvas = alpha[..., None] * shaded + (1.0 - alpha[..., None])
    return _with_legend(to_picture(canvas.astype(np.float32)), limit)


def _diverging(value: Float32) -> Float32:
    """(..., 3) colour of a value in -1..1."""
    strength = np.clip(np.abs(value), 0.0, 1.0)[..., None]
    end = np.where(value[..., None] >= 0, _FOR, _AGAINST)
    return np.asarray(_NEUTRAL + strength * (end - _NEUTRAL), dtype=np.float32)


def _with_legend(picture: Image.Image, limit: float) -> Image.Image:
    width, height = picture.size
    sheet = Image.new("RGB", (width, height + _LEGEND), _PAPER)
    sheet.paste(picture, (0, 0))
    bar = _diverging(np.broadcast_to(np.linspace(-1, 1, width // 3, dtype=np.float32), (12, width // 3)))
    left = width // 3
    sheet.paste(to_picture(bar), (left, height + 4))
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=13)
    pen.text((left, height + 18), f"-{limit:.0f}", fill=_INK, font=font)
    pen.text((width / 2, height + 18), "0 standard deviations", fill=_INK, font=font, anchor="ma")
    pen.text((left + width // 3, height + 18), f"+{limit:.0f}", fill=_INK, font=font, anchor="ra")
    pen.text((left - 8, height + 2), "against the mark", fill=_INK, font=font, anchor="ra")
    pen.text((left + width // 3 + 8, height + 2), "for the mark", fill=_INK, font=font)
    return sheet


def to_picture(image: Float32, longest: int | None = None) -> Image.Image:
    """A picture of (H, W, 3) floats in 0..1, no side longer than `longest` pixels."""
    picture = Image.fromarray(np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8))
    if longest is not None:
        picture.thumbnail((longest, longest), reducing_gap=2.0)
    return picture


def save_png(picture: Image.Image, path: Path) -> None:
    """Store a picture, quickly rather than as small as can be."""
    picture.save(path, format="PNG", compress_level=3)
