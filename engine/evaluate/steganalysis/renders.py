"""Cells that look at pictures: the same views unmarked and marked; with replaced bits to check the detectors."""

from pathlib import Path

import numpy as np

from engine.evaluate.marked_scene import mark_scene
from engine.evaluate.steganalysis.lsb import Picture, fuse, replace_lsb
from engine.evaluate.study import Row
from engine.model import Float32
from engine.pipeline.profiles import profile
from engine.pipeline.rigs import make_rig
from engine.raster import render

__all__ = ["look_at_renders"]

CHECKED_RATES = (0.05, 0.1, 0.25, 0.5, 1.0)
"""Embedding rates at which the detectors are checked."""


def look_at_renders(path: str, profile_name: str, views: int, checked_views: int, size: int, seed: int) -> list[Row]:
    """Every detector on 8-bit renders of one scene.

    Parameters
    ----------
    path : str
        Of a model.
    checked_views : int
        Of these, how many unmarked ones also get replaced bits.
    size : int
        Pixels a side.
    seed : int
        Of key, views and bits.

    Returns
    -------
    list of dict
        One row a picture: ``kind`` "unmarked", "marked" or "lsb", its ``rate``, and each detector's estimate.
    """
    scene = mark_scene(path, profile(profile_name, landmark_views=0), seed=seed)
    rng = np.random.default_rng((seed, 9))
    cameras = make_rig(scene.original, views, size, size, jitter=rng.random((views, 4)))
    rows: list[Row] = []
    for number, camera in enumerate(cameras):
        about = {"scene": Path(path).name, "seed": seed, "view": number}
        plain = _stored(render(scene.original, camera))
        rows.append({**about, "kind": "unmarked", "rate": 0.0, **fuse(plain)})
        rows.append({**about, "kind": "marked", "rate": 0.0, **fuse(_stored(render(scene.marked, camera)))})
        for rate in CHECKED_RATES if number < checked_views else ():
            rows.append({**about, "kind": "lsb", "rate": rate, **fuse(replace_lsb(plain, rate, rng))})
    return rows


def _stored(image: Float32) -> Picture:
    return np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)
