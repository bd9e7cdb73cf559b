"""The passes that do not depend on colours, in order: project, sort, count, fill."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.errors import InputError
from engine.kernels.thread_crew import thread_count
from engine.model import Camera, Float32, GaussianModel, Int32, Int64
from engine.raster.binning import BUCKETS, list_pairs, list_starts, place_pairs, sort_by_depth, workers_for
from engine.raster.disc_projection import project_discs
from engine.raster.lane_memory import aligned
from engine.raster.projection import LANE_SCRATCH, RECORD, pack_lens, project
from engine.raster.settings import TILE, RasterSettings
from engine.raster.workspace import Workspace, borrow_workspace

_CHUNKS = 32
_LANES = 16
_MOST_PAIRS = 2**31 - 1
_PAIRS_PER_GAUSSIAN = 3  # real scenes at a megapixel have about 2; more make room and walk again
_NO_DISCS = np.zeros(0, dtype=np.float32)
_EMPTY = np.zeros(0, dtype=np.int32)


@dataclass(frozen=True, eq=False)
class Geometry:
    """A model of `count` Gaussians N seen by a camera: everything blending needs except colours."""

    camera: Camera
    settings: RasterSettings
    count: int
    records: Float32  # flat (at least N * RECORD,), see `engine.raster.projection`; only visible rows are written
    discs: Float32  # the same of `engine.raster.disc_projection`; empty where Gaussians are drawn
    visible: Int32  # (V,) indices of the visible Gaussians, nearest first
    ids: Int32  # (P,) the tiles' lists, one after the other
    starts: Int64  # (tiles + 1,) where each begins
    firsts: Int32  # (max(N, 16) + 1,) empty, as `slots`, if they were not requested
    slots: Int32  # (P,) places of Gaussian i in `ids`: ``slots[firsts[i]:firsts[i + 1]]``

    @property
    def tiles_x(self) -> int:
        """Tiles per row."""
        return -(-self.camera.width // TILE)

    @property
    def limits(self) -> Float32:
        """What is blended: log2 of the smallest alpha, the largest, and the transmittance at which a pixel ends."""
        s = self.settings
        return np.array([s.log2_alpha_skip, s.alpha_clamp, s.transmittance_stop], dtype=np.float32)

    @property
    def lists(self) -> tuple[Any, ...]:
        """What every pass over the tiles reads, in this order, as one argument of its kernel."""
        width, height = self.camera.width, self.camera.height
        return self.records, self.discs, self.ids, self.starts, width, height, self.tiles_x, self.limits


def padded(model: GaussianModel) -> GaussianModel:
    """The model with at least 16 Gaussians; those added are far too faint to be seen."""
    missing = _LANES - len(model)
    if missing <= 0:
        return model

    def grown(array: Float32, fill: float) -> Float32:
        return np.concatenate([array, np.full((missing, *array.shape[1:]), fill, dtype=np.float32)])

    means, log_scales, sh = (grown(array, 0.0) for array in (model.means, model.log_scales, model.sh))
    quats, logits = grown(model.quats, 0.5), grown(model.opacity_logits, -100.0)
    return model.with_(means=means, log_scales=log_scales, quats=quats, opacity_logits=logits, sh=sh)


@dataclass(frozen=True, eq=False)
class _Projected:
    """What pass 1 writes, for at least 16 Gaussians; see `engine.raster.projection.project`."""

    rows: int
    records: Float32
    discs: Float32
    bounds: tuple[Any, ...]  # extents (float32), rects (int16) and covers (uint16)
    depths: Float32
    index: Int32
    chunk: int
    counts: Int64

    @property
    def seen(self) -> Int64:
        """Indices of the visible Gaussians."""
        stretches = (self.index[k * self.chunk :][:count] for k, count in enumerate(self.counts))
        return np.concatenate(list(stretches)).astype(np.int64)


def _project(
    model: GaussianModel,
    camera: Camera,
    settings: RasterSettings,
    work: Workspace,
    lasting: Callable[[str, int, type[np.generic]], np.ndarray[Any, Any]],
) -> tuple[RasterSettings, _Projected]:
    """Pass 1; and the settings with what was left to the model."""
    if settings.antialiased is None:
        settings = replace(settings, antialiased=model.antialiased)
    flat = settings.kernel == "disc" or (settings.kernel == "auto" and model.is_flat)
    model = padded(model)
    rows = len(model)
    records = lasting("records", (rows + 2) * RECORD, np.float32)
    bounds = (
        work.array("extents", (2 * rows,)),
        work.array("rects", (4 * rows,), np.int16),
        work.array("covers", (rows,), np.uint16),
    )
    depths, index = work.array("depths", (rows,)), work.array("index", (rows,), np.int32)
    chunk = -(-rows // (_CHUNKS * _LANES)) * _LANES
    counts = np.zeros(-(-rows // chunk), dtype=np.int64)
    raw = (model.means.ravel(), model.quats.ravel(), model.log_scales.ravel(), model.opacity_logits)
    lens, found = pack_lens(camera, settings), (bounds, depths, index, counts)
    discs = lasting("discs", (rows + 2) * RECORD, np.float32) if flat else _NO_DISCS
    if not flat:
        project(*raw, lens, chunk, work.array("lane scratch", (len(counts), LANE_SCRATCH)), records, *found)
    else:
        project_discs(*raw, lens.astype(np.float64), chunk, records, discs, *found)
    return settings, _Projected(rows, records, discs, bounds, depths, index, chunk, counts)


def count_overlaps(model: GaussianModel, camera: Camera) -> Int64:
    """(N,) tiles of an image that each Gaussian may touch, those of the rectangle around it; 0 where it is not seen.

    Costs one pass over the Gaussians, whatever they cover: what drawing them would cost is known before it is paid.
    """
    found_in = np.zeros(len(model), dtype=np.int64)
    with borrow_workspace() as work:
        _, found = _project(
            model, camera, RasterSettings(), work, lambda name, size, dtype: work.array(name, (size,), dtype)
        )
        seen = found.seen
        left, right, top, bottom = found.bounds[1].reshape(-1, 4)[seen].astype(np.int64).T
    found_in[seen] = (right - left + 1) * (bottom - top + 1)
    return found_in


def build_geometry(
    model: GaussianModel, camera: Camera, settings: RasterSettings, work: Workspace, *, keep: bool
) -> tuple[Geometry, Int32]:
    """Project, sort and bin; returns the geometry, and (N,) how many tiles each Gaussian touches, in the workspace.

    `keep`: the result owns its arrays and has `slots`, so that gradients can follow; else its arrays live in the
    workspace and `slots` is empty.
    """
    n = len(model)
    tiles_x, tiles_y = -(-camera.width // TILE), -(-camera.height // TILE)
    if max(tiles_x, tiles_y) > np.iinfo(np.int16).max:
        raise InputError(f"an image of {camera.width}x{camera.height} is too large to draw")

    def lasting(name: str, size: int, dtype: type[np.generic]) -> np.ndarray[Any, Any]:
        return aligned((size,), dtype) if keep else work.array(name, (size,), dtype)

    settings, found = _project(model, camera, settings, work, lasting)
    rows, records, discs = found.rows, found.records, found.discs

    workers = thread_count()
    keys = [work.array(f"keys {half}", (rows,), np.uint64) for half in "ab"]
    radix = [work.array(f"radix {half}", (workers_for(rows), BUCKETS), np.int64) for half in "ab"]
    order = work.array("order", (rows,), np.int32)
    seen = sort_by_depth(found.depths.view(np.uint32), found.index, found.counts, found.chunk, keys, order, radix)

    tiles = tiles_x * tiles_y
    sizes = work.array("sizes", (rows,), np.int32)
    sizes.fill(0)
    histograms = work.array("tile histograms", (workers, tiles), np.int64)
    skip = np.float32(settings.log2_alpha_skip)
    capacity = _PAIRS_PER_GAUSSIAN * -(-seen // workers)
    while True:
        noted = work.array("pair tiles", (workers, capacity), np.int32)
        owners = work.array("pair owners", (workers, capacity), np.int32)
        counts = np.zeros(workers, dtype=np.int64)
        list_pairs(order, seen, records, found.bounds, tiles_x, skip, histograms, sizes, noted, owners, counts)
        if counts.sum() > _MOST_PAIRS:
            raise InputError(
                f"{counts.sum()} pairs of tile and Gaussian are too many to draw at once, at most "
                f"{_MOST_PAIRS} are possible; draw a smaller image"
            )
        if counts.max() <= capacity:
            break
        capacity = int(counts.max())
    starts = np.empty(tiles + 1, dtype=np.int64)
    pairs = list_starts(histograms, starts)
    ids = lasting("ids", pairs, np.int32)
    firsts, slots = _EMPTY, _EMPTY
    if keep:
        firsts, slots = aligned((rows + 1,), np.int32), aligned((pairs,), np.int32)
        firsts[0] = 0
        np.cumsum(sizes, out=firsts[1:])
    place_pairs(noted, owners, counts, histograms, ids, firsts, slots)
    visible = order[:seen].copy() if keep else order[:seen]
    return Geometry(camera, settings, n, records, discs, visible, ids, starts, firsts, slots), sizes[:n]
