"""Synthetic assets, for measuring an index: lumps wrapped in photographs that scikit-image ships.

Each lump also stands for relatives: what an index keeps of it with descriptors turned and mirrored in their grid, and
with looks and places recoloured.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from engine.catalogue.entry import Entry, SeenPoints, see_points
from engine.flows.embed.landmark_bank import make_bank
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.views.camera_rig import measure_extent
from engine.model import SH_C0, Float32, Float64, GaussianModel
from engine.registration.coarse import Coarse
from engine.registration.sketch import Sketch, make_sketch

__all__ = ["RELATIVES", "entry_of", "make_stranger", "stranger_entries"]

PHOTOS = (
    "astronaut",
    "brick",
    "camera",
    "cell",
    "chelsea",
    "coffee",
    "coins",
    "grass",
    "gravel",
    "moon",
    "page",
    "text",
)
GAUSSIANS = 20_000
VIEWS = EmbedConfig.landmark_views
RELATIVES = 16
"""Assets that one lump stands for, itself among them."""


def make_stranger(seed: int) -> GaussianModel:
    """A lump with up to two smaller ones next to it; the same seed gives the same model."""
    rng = np.random.default_rng((77, seed))
    parts = [_lump(rng, GAUSSIANS)]
    for _ in range(int(rng.integers(0, 3))):
        means, log_scales, quats, colors = _lump(rng, GAUSSIANS // 3)
        size = rng.uniform(0.3, 0.8)
        parts.append((means * size + 0.9 * rng.normal(size=3), log_scales + np.log(size), quats, colors))
    whole = [np.concatenate(part).astype(np.float32) for part in zip(*parts, strict=True)]
    logits = rng.uniform(1.0, 5.0, len(whole[0])).astype(np.float32)
    sh = ((whole[3] - 0.5) / SH_C0)[:, None].astype(np.float32)
    return GaussianModel(whole[0], whole[1], whole[2], logits, sh)


def entry_of(model: GaussianModel) -> Entry:
    """What the index keeps of a model, made from it alone."""
    return Entry(make_sketch(model), see_points(*make_bank(model, measure_extent(model), VIEWS)))


def stranger_entries(seed: int) -> Iterator[Entry]:
    """The entries of a lump and its relatives."""
    first = entry_of(make_stranger(seed))
    assert first.seen is not None
    for kin in range(RELATIVES):
        seen = SeenPoints(_turned(first.seen.descriptors, kin), first.seen.views, first.seen.places)
        yield Entry(_recolored(first.sketch, kin) if kin else first.sketch, seen)


def _lump(rng: np.random.Generator, count: int) -> tuple[Float64, Float64, Float64, Float64]:
    """Means, log scales, rotations and colours (0 to 1) of discs on a bumpy ellipsoid, each side its own photograph."""
    out = rng.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    radius = np.ones(count)
    for _ in range(6):
        radius += rng.uniform(0.03, 0.25) * np.sin(
            2.0 * out @ (rng.normal(size=3) * rng.uniform(1, 5)) + rng.uniform(0, 6)
        )
    axes = np.exp(rng.uniform(-0.7, 0.7, 3))
    means = out * radius[:, None] * axes
    normal = out / axes
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = np.argmax(np.abs(out), axis=1)
    side = 2 * along + (out[np.arange(count), along] > 0)
    colors = np.zeros((count, 3))
    for number in range(6):
        mine = side == number
        colors[mine] = _wrapped(rng, np.delete(means[mine], number // 2, axis=1))
    size = np.sqrt(4.0 * np.pi / count) * np.cbrt(axes.prod()) * rng.uniform(0.5, 1.1, (count, 1))
    long = size * np.exp(0.3 * rng.normal(size=(count, 1)))
    across = np.cross(normal, rng.normal(size=3))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    frames = np.stack([across, np.cross(normal, across), normal], axis=2)
    quats = Rotation.from_matrix(frames).as_quat()[:, [3, 0, 1, 2]]
    return means, np.log(np.concatenate([long, size, 0.1 * size], axis=1)), quats, colors


def _wrapped(rng: np.random.Generator, places: Float64) -> Float64:
    """(n, 3) colours at places (n, 2) of one photograph, turned, sized, recoloured."""
    photo = _photo(PHOTOS[int(rng.integers(len(PHOTOS)))])
    shape = np.array(photo.shape[:2])
    turn = Rotation.random(random_state=rng).as_matrix()[:2, :2] * np.exp(rng.uniform(-1.2, 0.3))
    where = places @ turn * shape.min() / 2 + rng.uniform(0, 1, 2) * shape
    row, column = (np.abs(where % (2 * shape) - shape).astype(np.int64).clip(0, shape - 1)).T
    color = photo[row, column][:, rng.permutation(3)].astype(np.float64)
    return np.asarray(np.where(rng.random(3) < 0.3, 1.0 - color, color) ** np.exp(rng.uniform(-0.5, 0.5, 3)))


@cache
def _photo(name: str) -> Float32:
    """(h, w, 3), 0..1."""
    from skimage import data

    photo = np.atleast_3d(getattr(data, name)())[..., :3].astype(np.float32) / np.float32(255.0)
    return np.broadcast_to(photo, (*photo.shape[:2], 3))


def _turned(descriptors: npt.NDArray[np.uint8], kin: int) -> npt.NDArray[np.uint8]:
    """SIFT histograms (P, 128) in one of 16 other orders that keep what is near near."""
    cells = descriptors.reshape(-1, 4, 4, 8)
    cells = cells[:, ::-1] if kin & 1 else cells
    cells = cells[:, :, ::-1] if kin & 2 else cells
    cells = cells.transpose(0, 2, 1, 3) if kin & 4 else cells
    cells = cells[..., -np.arange(8) % 8] if kin & 8 else cells
    return np.ascontiguousarray(cells.reshape(-1, 128))


def _recolored(sketch: Sketch, kin: int) -> Sketch:
    rng = np.random.default_rng(kin)
    order, power = rng.permutation(3), np.exp(rng.uniform(-0.5, 0.5, 3))
    features, looks = sketch.coarse.features.copy(), sketch.looks.copy()
    for scale in (0, 10):  # mean colour to a power, its gradients by a factor
        features[:, scale : scale + 3] = features[:, scale : scale + 3][:, order] ** power
        features[:, scale + 7 : scale + 10] = features[:, scale + 7 : scale + 10][:, order] * power
    looks[:, 3:] = looks[:, 3:][:, order] * power
    looks[:, :3] *= np.exp(rng.uniform(-0.3, 0.3, 3))
    return replace(sketch, looks=looks, coarse=Coarse(sketch.coarse.places, features, sketch.coarse.sizes))
