"""Pictures of models for people: a view that shows something, and PNG files."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from engine.model import Camera, Float32, GaussianModel
from engine.pipeline.rigs import make_rig
from engine.raster import prepare_view, render, sh_colors

__all__ = ["all_png", "choose_view", "draw_preview", "to_picture"]

PREVIEW_SIZE = (396, 330)
PREVIEW_GAP = 6
"""Three pictures and two gaps are 1200 pixels wide."""
DIFFERENCE_GAIN = 20
CAPTION_HEIGHT = 24

_TRIAL_VIEWS = 6
_TRIAL_SIZE = 72
_TRIAL_GAUSSIANS = 40_000
_INK, _PAPER = (27, 31, 36), (255, 255, 255)


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


def to_picture(image: Float32, longest: int | None = None) -> Image.Image:
    """A picture of (H, W, 3) floats in 0..1, no side longer than `longest` pixels."""
    picture = Image.fromarray(np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8))
    if longest is not None:
        picture.thumbnail((longest, longest), reducing_gap=2.0)
    return picture


def save_png(picture: Image.Image, path: Path) -> None:
    """Store a picture, quickly rather than as small as can be."""
    picture.save(path, format="PNG", compress_level=3)


def all_png(pictures: dict[str, Image.Image], folder: Path) -> dict[str, str]:
    """Store pictures by name; names of their files."""
    for name, picture in pictures.items():
        save_png(picture, folder / f"{name}.png")
    return {name: f"{name}.png" for name in pictures}
