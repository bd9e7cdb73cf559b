"""The map of a mark: which parts of an asset, of a suspect or of a picture carry it, with a legend that says how sure.

States are drawn, not z: nothing that is shown reveals a secret sign, or where one region ends and the next begins.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from engine.flows.embed.copy_mark import mark_again
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.regions.region_search import RegionReport
from engine.flows.verify.search import Suspect, Verification
from engine.flows.views.display_view import choose_view, lay_over, to_picture, widened
from engine.flows.views.render_cost import is_drawable
from engine.model import Camera, Float32, GaussianModel, Int32
from engine.numerics.resampling import smooth
from engine.pictures.landmarks.keypoints import LUMA
from engine.raster import View, prepare_view, sh_colors
from engine.watermark.regions import State

COLORS = {
    State.MARKED: (0.92, 0.42, 0.04),
    State.ALTERED: (0.13, 0.40, 0.72),
    State.UNCLEAR: (0.66, 0.66, 0.66),
    State.UNSEEN: (0.93, 0.93, 0.93),
}
"""Orange and blue: distinct with any color vision, and in black and white by how dark they are."""
SAYS = {
    State.MARKED: "the mark is here",
    State.ALTERED: "this part is there, its mark is not: altered, or taken from the original",
    State.UNCLEAR: "seen, but too little to say anything",
    State.UNSEEN: "not seen in the suspect, or too faintly",
}
PANEL = (480, 400)
"""Each picture of a sheet, pixels; a picture of the suspect keeps its shape within the larger side."""
AROUND, ALL = 0.6, 0.95
"""Focal length, in that of a view of a piece alone, at which it is seen in the scene that it lies in; and the share of
a suspect from which on that scene is the piece."""
MOST_SHOWN = 2
"""Pieces of a suspect that a sheet shows; regions.json has all."""
_BLUR = 1.5
"""Pixels: single Gaussians do not speckle the map."""
_HATCH = 9
"""Pixels between the lines over what is not seen."""
LEGEND = 360
"""Least width of a sheet, pixels: below it the legend would stand higher than the map."""
_INK, _PAPER, _MUTE = (27, 31, 36), (255, 255, 255), (86, 98, 114)
_LINE, _CAPTION, _GAP, _MARGIN, _KEY = 19, 24, 8, 8, 32


def draw_states(view: View, states: Int32, image: Float32, alpha: Float32, *, hatched: bool = True) -> Image.Image:
    """`State` of each Gaussian (N,) in colour over a grey picture of them, `image` (H, W, 3) with its `alpha` (H, W).

    `hatched`: lines over what is not seen, which of a suspect is what the asset has no part in.
    """
    shares = view.render((states[:, None] == np.arange(len(State))).astype(np.float32))[0]  # (H, W, 4)
    shares = np.stack([smooth(np.ascontiguousarray(shares[..., k]), _BLUR) for k in range(len(State))], axis=2)
    state = shares.argmax(axis=2)  # (H, W)
    paint = np.array([COLORS[each] for each in State], dtype=np.float32)[state]
    rows, columns = np.indices(state.shape)
    paint[(state == State.UNSEEN) & ((rows + columns) % _HATCH == 0) & hatched] -= 0.25
    shaded = paint * (0.35 + 0.65 * np.clip(image, 0.0, 1.0) @ LUMA)[..., None]
    marked = state == State.MARKED
    edge = np.zeros(state.shape, dtype=bool)
    edge[:, 1:] |= marked[:, 1:] != marked[:, :-1]
    edge[1:] |= marked[1:] != marked[:-1]
    shaded[edge & (alpha > 0.5)] = 0.0
    return to_picture((alpha[..., None] * shaded + (1.0 - alpha[..., None])).astype(np.float32))


def add_legend(picture: Image.Image, report: RegionReport) -> Image.Image:
    """The picture above what its colours mean, how much of the asset has each, and how sure that is."""
    summary = report.summary()
    font, small = ImageFont.load_default(size=14), ImageFont.load_default(size=12)
    about = [
        f"Of the orange regions, at most {report.false_discoveries:.0%} are expected to be without the mark (false"
        " discovery rate, Benjamini-Hochberg, proven for any suspect)."
    ]
    if summary["marked"]:
        about += ["A region of which a part carries the mark is orange, too."]
    if len(report.pieces) > 1:
        about += [f"Counted over {len(report.pieces)} pieces; the asset is drawn by what tells most of them."]
    if not report.suspect_rows and summary["marked"]:
        about += ["Regions reach behind what a picture shows: of a picture they say where, not how much, is marked."]
    if summary["altered"]:
        about += ["Blue is measured, not proven: a mark of half its strength would have shown there."]
    if not report.claimed:
        about += ["THE CLAIM ITSELF IS NOT MADE: this map proves nothing by itself."]
    counts = {state: f"{summary['share'][state.name.lower()]:.0%}" for state in State}
    says = [
        (state, f"{SAYS[state]}: {counts[state]} of the asset's Gaussians, regions: {summary[state.name.lower()]:,}")
        for state in reversed(State)
    ]
    width = max(picture.width, LEGEND)
    lines = [
        *((state, line) for state, text in says for line in _wrapped(text, font, width - 2 * _MARGIN - _KEY)),
        *((None, line) for text in about for line in _wrapped(text, small, width - 2 * _MARGIN)),
    ]
    sheet = Image.new("RGB", (width, picture.height + _LINE * len(lines) + 2 * _MARGIN), _PAPER)
    sheet.paste(picture, ((width - picture.width) // 2, 0))
    pen, top, before = ImageDraw.Draw(sheet), picture.height + _MARGIN, None
    for state, line in lines:
        if state is None:
            pen.text((_MARGIN, top + 2), line, fill=_MUTE, font=small)
        else:
            pen.text((_MARGIN + _KEY, top), line, fill=_INK, font=font)
            if state is not before:
                _draw_key(pen, state, top)
        top, before = top + _LINE, state
    return sheet


def _draw_key(pen: ImageDraw.ImageDraw, state: State, top: int) -> None:
    fill = tuple(round(255 * part) for part in COLORS[state])
    pen.rectangle((_MARGIN, top + 2, _MARGIN + 22, top + 14), fill=fill, outline=_INK)
    if state is State.UNSEEN:
        for left in range(_MARGIN + 4, _MARGIN + 22, 6):
            pen.line((left, top + 13, left + 5, top + 3), fill=_MUTE)


def _wrapped(text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, width: int) -> list[str]:
    """Lines of at most so many pixels, as far as words allow."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and font.getlength(longer) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def draw_report(report: RegionReport, suspect: Suspect, opened: OpenedRecord, found: Verification) -> Image.Image:
    """A sheet: the suspect, and the asset from two sides or from where a picture shows it, each with the map."""
    asset, states = mark_again(opened), report.states
    camera = next((each for each in found.cameras if each is not None), None)
    panels: list[tuple[str, Image.Image]] = []
    if camera is None:
        front = choose_view(asset, *PANEL)
        cameras = [("The asset, registered", front), ("The asset, from behind", _behind(front, asset))]
    else:
        cameras = [("The asset, from there", camera.with_side(min(PANEL[0], max(camera.width, camera.height))))]
    if suspect.model is not None and is_drawable(suspect.model):
        panels += _of_suspect(suspect.model, report)
    for number, (picture, seen) in enumerate(zip(suspect.pictures, found.cameras, strict=False)):
        if seen is not None:
            small = seen.with_side(min(PANEL[0], max(seen.width, seen.height)))
            if (laid := _over(picture, asset, states, small)) is not None:
                panels.append((f"Picture {number + 1}, as it lies on the asset", laid))
    panels += [(name, _panel(asset, states, each)) for name, each in cameras]
    return add_legend(_side_by_side(panels), report)


def _of_suspect(model: GaussianModel, report: RegionReport) -> list[tuple[str, Image.Image]]:
    """The suspect, seen so that each of its pieces of the asset fills a good part of a picture."""
    piece, _, state = report.of_suspect
    shown = min(MOST_SHOWN, len(report.pieces))
    if not (piece >= 0).any() or (shown == 1 and (piece == 0).mean() > ALL):
        camera = choose_view(model, *PANEL)
        return [("The suspect", _panel(model, state, camera, hatched=False))]
    panels = []
    for number in range(shown):
        camera = widened(choose_view(model.take(np.flatnonzero(piece == number)), *PANEL), AROUND)
        name = (
            "In the suspect"
            if len(report.pieces) == 1
            else f"Piece {number + 1} of {len(report.pieces)} in the suspect"
        )
        placed = report.pieces[number].registration
        name += ", mirrored" if placed is not None and placed.mirrored else ""
        panels.append((f"{name} (pale: not of the asset)", _panel(model, state, camera, hatched=False)))
    return panels


def _panel(model: GaussianModel, states: Int32, camera: Camera, *, hatched: bool = True) -> Image.Image:
    view = prepare_view(model, camera)
    image, alpha = view.render(sh_colors(model.sh, model.means, camera.position.astype(np.float32)))
    return draw_states(view, states, image, alpha, hatched=hatched)


def _over(picture: Float32, asset: GaussianModel, states: Int32, camera: Camera) -> Image.Image | None:
    """The map over a picture, laid on the asset's own view; None where it cannot be laid over it."""
    view = prepare_view(asset, camera)
    image, alpha = view.render(sh_colors(asset.sh, asset.means, camera.position.astype(np.float32)))
    laid = lay_over(picture, np.clip(image, 0.0, 1.0), alpha)
    if laid is None:
        return None
    warped, mask = laid
    return draw_states(view, states, np.where(mask[..., None], warped, 1.0).astype(np.float32), alpha * mask)


def _behind(camera: Camera, model: GaussianModel) -> Camera:
    """The same camera, walked round the middle of the model to its other side, upright as before."""
    middle = np.median(model.means.astype(np.float64), axis=0)
    turn = camera.viewmat[:3, :3]
    half = turn.T @ np.diag([-1.0, 1.0, -1.0]) @ turn  # half a turn about the camera's own upright
    viewmat = np.eye(4)
    viewmat[:3, :3] = turn @ half
    viewmat[:3, 3] = turn @ (middle - half @ middle) + camera.viewmat[:3, 3]
    return Camera(viewmat, camera.K, camera.width, camera.height)


def _side_by_side(panels: Sequence[tuple[str, Image.Image]]) -> Image.Image:
    font = ImageFont.load_default(size=14)
    width = sum(panel.width for _, panel in panels) + _GAP * (len(panels) - 1)
    sheet = Image.new("RGB", (width, _CAPTION + max(panel.height for _, panel in panels)), _PAPER)
    pen, left = ImageDraw.Draw(sheet), 0
    for name, panel in panels:
        pen.text((left + 2, 4), name, fill=_INK, font=font)
        sheet.paste(panel, (left, _CAPTION))
        left += panel.width + _GAP
    return sheet
