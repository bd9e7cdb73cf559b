"""Files of .ksplat put together by hand, as `generateFromUncompressedSplatArrays` of its project does."""

from __future__ import annotations

import struct

import numpy as np
import numpy.typing as npt

from engine.model import SH_C0, GaussianModel

BLOCK, RANGE = 5.0, 32767


def section_of(
    model: GaussianModel, level: int, *, bucket: int = 256, room: int = 0, bounds: tuple[float, float] = (-1.5, 1.5)
) -> tuple[bytes, bytes]:
    """Header (1,024 bytes) and content of one section; `room` for more Gaussians than there are."""
    cubes = np.floor(model.means / BLOCK).astype(int)
    _, full, partial = _buckets(cubes, bucket)
    centers = [(cubes[rows[0]] + 0.5) * BLOCK for rows in full + partial] if level else []
    rows = b"".join(
        _row(model, i, centers[number] if level else None, level, bounds)
        for number, bucket_rows in enumerate(full + partial)
        for i in bucket_rows
    )
    stride = len(rows) // len(model)
    content = b"".join(struct.pack("<I", len(rows)) for rows in partial) if level else b""
    content += b"".join(struct.pack("<3f", *center) for center in centers)
    content += rows + bytes(stride * room)
    buckets, wide = (len(full) + len(partial), len(full)) if level else (0, 0)
    head = struct.pack(
        "<IIIIfHxxIIIIH",
        *(len(model), len(model) + room, bucket if level else 0, buckets, BLOCK if level else 0.0),
        *(12 if level else 0, RANGE if level else 0, len(content), wide, len(partial) if level else 0),
        model.sh_degree,
    )
    return head + bytes(1024 - len(head)), content


def in_file_order(model: GaussianModel, bucket: int = 256) -> GaussianModel:
    """The Gaussians as such a section stores them: bucket after bucket."""
    return model.take(_buckets(np.floor(model.means / BLOCK).astype(int), bucket)[0])


def ksplat_of(
    *sections: tuple[bytes, bytes], count: int, level: int, bounds: tuple[float, float] = (0.0, 0.0)
) -> bytes:
    """A whole file; bounds of zero stand for the public code's own."""
    number = len(sections)
    head = struct.pack("<BBxxIIIIHxx12xff", 0, 1, number, number, count, count, level, *bounds)
    parts = [head, bytes(4096 - len(head)), *(head for head, _ in sections), *(content for _, content in sections)]
    return b"".join(parts)


def _buckets(cubes: npt.NDArray[np.int64], size: int) -> tuple[npt.NDArray[np.int64], list[list[int]], list[list[int]]]:
    full, open_ones = [], {}
    for i, cube in enumerate(map(tuple, cubes)):
        open_ones.setdefault(cube, []).append(i)
        if len(open_ones[cube]) == size:
            full.append(open_ones.pop(cube))
    partial = list(open_ones.values())
    return np.array([i for rows in full + partial for i in rows]), full, partial


def _row(
    model: GaussianModel, i: int, center: npt.NDArray[np.float64] | None, level: int, bounds: tuple[float, float]
) -> bytes:
    rgb = np.clip(np.floor((0.5 + SH_C0 * model.sh[i, 0]) * 255), 0, 255).astype(np.uint8).tobytes()
    color = rgb + bytes([int(np.floor(model.opacities[i] * 255))])
    # channel after channel in degree 1, then in degree 2
    rest = np.concatenate([model.sh[i, 1:4].T.ravel(), model.sh[i, 4:9].T.ravel()])[: 3 * (model.sh.shape[1] - 1)]
    if center is None:
        return b"".join(a.astype("<f4").tobytes() for a in (model.means[i], model.scales[i], model.quats[i])) + (
            color + rest.astype("<f4").tobytes()
        )
    place = np.round((model.means[i] - center) * (RANGE / (BLOCK / 2))) + RANGE
    halves = b"".join(a.astype("<f2").tobytes() for a in (model.scales[i], model.quats[i]))
    packed = (
        rest.astype("<f2").tobytes()
        if level == 1
        else np.floor((np.clip(rest, *bounds) - bounds[0]) / (bounds[1] - bounds[0]) * 255).astype(np.uint8).tobytes()
    )
    return np.clip(place, 0, 2 * RANGE + 1).astype("<u2").tobytes() + halves + color + packed
