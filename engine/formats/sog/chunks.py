"""A streamed SOG scene, written: a tree over space, a chunk for every leaf and level, and the index of all."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from engine.errors import InputError
from engine.formats.file_writing import write_whole
from engine.formats.sog.archive import META
from engine.formats.sog.encoding import encode_scene
from engine.formats.sog.levels import LOD_META
from engine.model import Float64, GaussianModel, Int64
from engine.numerics.plain import Json
from engine.numerics.similarity import quaternion_to_rotation

LEAF = 1 << 19
"""Gaussians of a leaf, all levels together, at most: as splat-transform's default."""


def write_streamed(levels: Sequence[GaussianModel], folder: Path, *, leaf: int = LEAF) -> int:
    """Write a scene at one or several levels of detail, the finest first; returns the bytes of all files.

    The folder must be there; files in it are replaced one by one, the index last. The same bytes for the same input.
    InputError if a level is empty, or not all are drawn in the same way.
    """
    if not levels or not all(len(level) for level in levels):
        raise InputError("a streamed scene needs Gaussians in every level")
    if len({level.antialiased for level in levels}) > 1:
        raise InputError("levels are all antialiased, or none is")
    points = np.concatenate([level.means for level in levels]).astype(np.float64)
    of_level = np.repeat(np.arange(len(levels)), [len(level) for level in levels])
    bases = np.cumsum([0, *(len(level) for level in levels)])
    bounds = [_extents(level) for level in levels]
    filenames: list[str] = []
    chunks, written = [0] * len(levels), 0

    def build(rows: Int64) -> Json:
        nonlocal written
        halves = _split(points[rows], leaf)
        if halves is not None:
            children = [build(rows[half]) for half in halves]
            lows, highs = ([child["bound"][end] for child in children] for end in ("min", "max"))
            return {"bound": {"min": np.min(lows, 0).tolist(), "max": np.max(highs, 0).tolist()}, "children": children}
        lods, low, high = {}, np.full(3, np.inf), np.full(3, -np.inf)
        for number, level in enumerate(levels):
            mine = rows[of_level[rows] == number] - bases[number]
            if not len(mine):
                continue
            low = np.minimum(low, bounds[number][0][mine].min(axis=0))
            high = np.maximum(high, bounds[number][1][mine].max(axis=0))
            parts = encode_scene(level.take(np.sort(mine)))
            name = f"{number}_{chunks[number]}"
            chunks[number] += 1
            (folder / name).mkdir(exist_ok=True)
            written += sum(write_whole(folder / name / part, [data]) for part, data in parts.items())
            lods[str(number)] = {"file": len(filenames), "offset": 0, "count": len(mine)}
            filenames.append(f"{name}/{META}")
        return {"bound": {"min": low.tolist(), "max": high.tolist()}, "lods": lods}

    tree = build(np.arange(len(points)))
    counts = [len(level) for level in levels]
    index = {
        "version": 1,
        "asset": {"generator": "Mark3DGS"},
        "count": sum(counts),
        "counts": counts,
        "lodLevels": len(levels),
        "lodErrors": False,
        "filenames": filenames,
        "tree": tree,
    }
    text = json.dumps(index, separators=(",", ":"), allow_nan=False).encode()
    return written + write_whole(folder / LOD_META, [text])


def _split(points: Float64, leaf: int) -> tuple[Int64, Int64] | None:
    """Two halves along the longest side, at the median; None where they are few enough, or all lie in one place."""
    extent = np.ptp(points, axis=0)
    if len(points) <= leaf or not extent.max() > 0:
        return None
    order = np.argsort(points[:, int(extent.argmax())], kind="stable")
    return order[: len(order) // 2], order[len(order) // 2 :]


def _extents(model: GaussianModel) -> tuple[Float64, Float64]:
    """Corners (N, 3) of the boxes about one standard deviation, as splat-transform bounds its leaves."""
    reach = np.abs(quaternion_to_rotation(model.quats)) @ np.exp(model.log_scales.astype(np.float64))[:, :, None]
    return model.means - reach[:, :, 0], model.means + reach[:, :, 0]
