"""Pictures for people: a preview of a marked model; a suspect, its asset, and where on the asset the mark was found."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from engine.flows.embed.copy_mark import mark_again
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.regions.region_search import RegionReport
from engine.flows.verify.search import Suspect, Verification
from engine.flows.views.display_view import choose_view, lay_over, to_picture
from engine.flows.views.render_cost import is_drawable
from engine.model import Bool, Camera, Float32, GaussianModel
from engine.numerics.similarity import mirror_model
from engine.present.region_maps import add_legend, draw_states
from engine.raster import prepare_view, render, sh_colors

PREVIEW_SIZE = (396, 330)
PREVIEW_GAP = 6
"""Three pictures and two gaps are 1200 pixels wide."""
DIFFERENCE_GAIN = 20
CAPTION_HEIGHT = 24

_INK, _PAPER = (27, 31, 36), (255, 255, 255)

EVIDENCE_SIZE = (640, 480)
LARGEST_SUSPECT = 800
SUSPECT_GAIN = 5
"""A suspect's difference is drawn so many times as large."""


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


def draw_evidence(
    folder: Path, opened: OpenedRecord, found: Verification, suspect: Suspect, regions: RegionReport
) -> dict[str, str]:
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
    pictures = {
        "asset": to_picture(image),
        "heatmap": add_legend(draw_states(view, regions.states, image, alpha), regions),
    }
    laid: tuple[Float32, Bool] | None = None
    if suspect.model is not None and is_drawable(suspect.model):
        seen = np.clip(_suspect_view(suspect.model, found, camera), 0.0, 1.0)
        pictures["suspect"] = to_picture(seen)
        laid = (seen, np.ones(seen.shape[:2], dtype=bool)) if found.claim.transform is not None else None
    elif suspect.pictures:
        picture = suspect.pictures[shown or 0]
        pictures["suspect"] = to_picture(picture, LARGEST_SUSPECT)
        laid = lay_over(picture, image, alpha) if known is not None else None
    if laid is not None:
        change = np.clip(0.5 + SUSPECT_GAIN * (laid[0] - image), 0.0, 1.0)
        pictures["difference"] = to_picture(np.where(laid[1][..., None], change, np.float32(1.0)))
    for name, drawn in pictures.items():
        save_png(drawn, folder / f"{name}.png")
    return {name: f"{name}.png" for name in pictures}


def _suspect_view(model: GaussianModel, found: Verification, camera: Camera) -> Float32:
    """From the reference's camera where the suspect was registered to it, else from one of its own.

    The camera moves, not the model: x_reference = s R x + t is seen by V as x is by the camera below, all lengths
    divided by s. A mirror image is mirrored back first.
    """
    transform = found.claim.transform
    if transform is None:
        return render(model, choose_view(model, *EVIDENCE_SIZE))
    if transform.mirrored:
        model = mirror_model(model)
    viewmat = camera.viewmat.copy()
    turn = viewmat[:3, :3]
    viewmat[:3, 3] = (turn @ transform.translation + viewmat[:3, 3]) / transform.scale
    viewmat[:3, :3] = turn @ transform.rotation
    return render(model, Camera(viewmat, camera.K, camera.width, camera.height))


def save_png(picture: Image.Image, path: Path) -> None:
    """Store a picture, quickly rather than as small as can be."""
    picture.save(path, format="PNG", compress_level=3)
