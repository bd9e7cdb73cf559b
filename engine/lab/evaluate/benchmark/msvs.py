"""Pictures from all around, near and far: multi-shell viewpoint sampling (MSVS, ICASSP 2026).

Viewpoints lie on concentric spheres about a model, equally many on each, stratified over the whole sphere, from below,
too. The paper's code was not at hand. Our reading of its bounds: on the innermost shell the model's robust sphere
spans twice the picture's side, on the outermost one a quarter of it. A picture in which less than a thousandth of the
pixels shows the model is not read; it is counted.

100 pictures of 800 pixels a scene and method with their cameras, 25 of them without, too: about 4 minutes of processor
time. Quick: two shells of two views, with their cameras.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from engine.flows.views.camera_rig import GOLDEN_ANGLE, UP, direction, make_rig, measure_extent
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.benchmark.methods import BITS, OURS, mark_subject, scenes_and_methods
from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.study import Bar, Cell, Options, Report, Row, Section, Study
from engine.lab.evaluate.summary import grouped, listed
from engine.model import Camera, GaussianModel, look_at
from engine.raster import draw

__all__ = ["STUDY", "measure", "shell_views"]

SPANS = (2.0, 1.0, 0.5, 0.35, 0.25)
"""Of the model's robust sphere on the picture, in sides of it: each is a shell, the nearest first."""
VIEWS, SIDE = 20, 800
"""Viewpoints a shell, and pixels a side."""
SOUGHT = 4
"""Every so manyth picture is read a second time, without its camera: finding it takes most of the time."""
COVERED, LEAST_SHOWN = 0.5, 0.001
"""A pixel shows the model from this opacity on; a picture counts if this share of its pixels does."""
LEAST = 0.95
"""Of the pictures claim: our bar. 3D-GSW's bits fall from .951 on the ring it was trained on to .764 here."""


def shell_views(model: GaussianModel, span: float, count: int, seed: int, side: int = SIDE) -> list[Camera]:
    """So many views from the shell of this span (see `SPANS`): one in each of `count` belts of equal area.

    Within its belt a view lies at random; azimuths follow the golden angle from a random one. All look at the middle.
    """
    extent = measure_extent(model)
    focal = float(make_rig(model, 1, side, side, extent=extent)[0].K[0, 0])
    distance = extent.radius / np.sin(np.arctan(span * side / (2.0 * focal)))  # the sphere is seen under that angle
    rng = np.random.default_rng((seed, round(1000 * span)))
    heights = -1.0 + 2.0 * (np.arange(count) + rng.random(count)) / count
    azimuths = rng.uniform(0.0, 2.0 * np.pi) + GOLDEN_ANGLE * np.arange(count)
    towards = [direction(azimuth, float(np.arcsin(height))) for azimuth, height in zip(azimuths, heights, strict=True)]
    return [look_at(extent.center + distance * toward, extent.center, UP, focal, side, side) for toward in towards]


def measure(path: str, method: str, span: float, seed: int, quick: bool) -> list[Row]:
    """A row for each picture of a shell with its camera, and (not quick) for some without: "camera" of the row."""
    subject = mark_subject(method, path, seed)
    about = {"scene": Path(path).name, "method": subject.method.name, "informed": subject.method.informed}
    rows: list[Row] = []
    for view, camera in enumerate(shell_views(subject.original, span, 2 if quick else VIEWS, seed)):
        rendering = draw(subject.marked, camera)
        picture, shown = to_8_bit(rendering.image), float((rendering.alpha >= COVERED).mean())
        for known in (True,) if quick or view % SOUGHT else (True, False):
            row = {**about, "span": span, "view": view, "camera": "known" if known else "unknown", "shown": shown}
            if shown >= LEAST_SHOWN:
                found = subject.read_picture(picture, camera if known else None)
                row |= dict(zip(("right", "claimed", "z"), found or (None, None, None), strict=True))
            rows.append(row)
    return rows


def _cells(options: Options) -> list[Cell]:
    return [
        Cell.of(f"{name}-{span:g}", measure, **which, span=span, seed=options.seed, quick=options.quick)
        for name, which in scenes_and_methods(options)
        for span in (SPANS[1:3] if options.quick else SPANS)
    ]


def _report(rows: list[Row], options: Options) -> Report:
    bars, lines = [], []
    for (scene, method, camera), own in grouped(rows, "scene", "method", "camera").items():
        read = [row for row in own if row.get("right") is not None]
        lines += [_line(found) for found in (read, *grouped(read, "span").values()) if found]
        if method == OURS and read:
            claims = sum(row["claimed"] for row in read)
            low, high = share_interval(claims, len(read))
            empty = f"{sum('claimed' not in row for row in own)} more show next to nothing"
            measured = f"{claims} of {len(read)} (95 %: {100 * low:.0f} to {100 * high:.0f} %; {empty})"
            what = f"{scene}: pictures that claim, camera {camera}"
            bars.append(Bar(what, f">= {100 * LEAST:g} %", measured, claims >= LEAST * len(read)))
    text = (
        "3D-GSW, blind: .951 of its bits from its test views, .764 from all shells (Blender); .996 and .828 "
        "(Stanford-ORB). Our reading is informed."
    )
    return Report(bars, [Section("Bits and claims by shell", [text], [listed(lines)])])


def _line(rows: Sequence[Row]) -> Row:
    spans = {row["span"] for row in rows}
    z = [row["z"] for row in rows if row["z"] is not None]
    return {
        **{name: rows[0][name] for name in ("scene", "method", "camera")},
        "reading": "informed" if rows[0]["informed"] else "blind",
        "shell spans": "all" if len(spans) > 1 else f"{spans.pop():g} sides",
        "bits right": f"{np.mean([row['right'] for row in rows]) / BITS:.3f}",
        "claims": f"{sum(row['claimed'] for row in rows)} of {len(rows)}",
        "least z": f"{min(z):.1f}" if z else "",
    }


STUDY = Study(
    "msvs",
    "Multi-shell viewpoint sampling",
    "What do pictures from all around say, near and far?",
    _cells,
    _report,
    frozenset({"quick", "methods"}),
)
