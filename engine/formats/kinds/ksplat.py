"""The .ksplat format of mkkellogg/GaussianSplats3D, read only: its project is at rest and points to other formats.

After a header of 4,096 bytes and one of 1,024 for each section come the sections: lengths of the buckets that are not
full, centres of all buckets, rows. Level 0 stores float32; levels 1 and 2 centres as 16 bits about their bucket's
centre, the rest as float16, level 2 spherical harmonics as bytes between two bounds. These stand channel after channel
within each degree (``PlyParserUtils.js``: degree1Fields, degree2Fields), the axes are those of PLY. Layout:
``src/loaders/SplatBuffer.js``; playcanvas/splat-transform reads it alike (``read-ksplat.ts``).
"""

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.declaration import Kind
from engine.formats.guards import check_count
from engine.formats.other_files import advice_for
from engine.formats.repairs import ALPHA_LOGITS, Repair, clean
from engine.model import SH_C0, Float32, GaussianModel

HEADER, SECTION_HEADER = 4096, 1024
REST_COEFFICIENTS = (0, 3, 8)
"""Coefficients a channel above DC, by degree; nothing writes a third one."""

_HEAD = struct.Struct("<BBxxIIIIHxx12xff")
_SECTION = struct.Struct("<IIIIfHxxIIIIH")
_BUCKET = 12
_SCALE_RANGE = 32767
_SH_RANGE = 1.5


@dataclass(frozen=True)
class _Section:
    """What a section's header says, its bytes known to be there."""

    count: int  # rows that are loaded; the room is for more
    bucket_size: int
    block: float  # side of a bucket's cube, scene units
    steps: int  # of a centre, either side of its bucket's
    full: int  # buckets that are full, then those that are not
    partial: int
    buckets: int
    degree: int
    start: int  # of the lengths of the partial buckets
    rows: int  # offset of the rows


def looks_like_ksplat(data: bytes | memoryview) -> bool:
    """Whether bytes begin as a file of this format: it has no magic, but a version, a level and counts that fit."""
    if len(data) < HEADER + SECTION_HEADER:
        return False
    major, minor, sections, _, _, count, level, _, _ = _HEAD.unpack_from(data)
    room = 1 <= sections <= (len(data) - HEADER) // SECTION_HEADER
    return (major, bytes(data[2:4])) == (0, b"\0\0") and 1 <= minor < 16 and level <= 2 and count > 0 and room


def read_ksplat(data: bytes | memoryview, *, file: str) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """Read a .ksplat file of any compression level, degree 0 to 2.

    UnsupportedFormatError for another version; FormatError if counts, buckets and bytes do not agree, which is checked
    before anything is decoded.
    """
    if len(data) < HEADER:
        raise FormatError(f"has {len(data)} bytes, its header alone takes {HEADER}", file=file)
    major, minor, sections, _, _, count, level, low, high = _HEAD.unpack_from(data)
    if major != 0 or minor < 1:
        raise UnsupportedFormatError(f".ksplat version {major}.{minor}, read is 0.1", file=file, element="header")
    if level > 2:
        raise FormatError(f"compression level {level}, known are 0 to 2", file=file, element="header")
    if not 1 <= sections <= (len(data) - HEADER) // SECTION_HEADER:
        raise FormatError(f"{sections} sections in {len(data)} bytes", file=file, element="header")
    check_count(count, len(data), file=file)
    found = _sections(data, sections, level, file)
    if (there := sum(section.count for section in found)) != count:
        raise FormatError(f"its sections hold {there} Gaussians, the header says {count}", file=file)
    bounds = (low or -_SH_RANGE, high or _SH_RANGE)  # as the public code: zero stands for its own range
    degree = max(section.degree for section in found)
    parts = [_decode(data, section, level, bounds, REST_COEFFICIENTS[degree], file) for section in found]
    means, log_scales, quats, logits, sh = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return clean(means, log_scales, quats, logits, sh, file=file, element="splat")


def _sections(data: bytes | memoryview, number: int, level: int, file: str) -> list[_Section]:
    found, offset = [], HEADER + number * SECTION_HEADER
    for index in range(number):
        element = f"section {index}"
        head = _SECTION.unpack_from(data, HEADER + index * SECTION_HEADER)
        count, room, bucket_size, buckets, block, bucket_bytes, steps, _, full, partial, degree = head
        if count > room:
            raise FormatError(f"holds {count} Gaussians in room for {room}", file=file, element=element)
        if degree >= len(REST_COEFFICIENTS):
            message = f"spherical harmonics of degree {degree}, the format has 0 to {len(REST_COEFFICIENTS) - 1}"
            raise FormatError(message, file=file, element=element)
        if level and (bucket_bytes != _BUCKET or full + partial > buckets):
            message = f"{full} full and {partial} other buckets of {buckets}, {bucket_bytes} bytes each"
            raise FormatError(message, file=file, element=element)
        if level and not 0.0 < block < 1e12:
            raise FormatError(f"buckets are {block} wide", file=file, element=element)
        rows = offset + 4 * partial + bucket_bytes * buckets
        end = rows + room * _row(level, degree).itemsize
        if end > len(data):
            message = f"{room} Gaussians end at byte {end}, the file at {len(data)}: cut off, or the count is wrong"
            raise FormatError(message, file=file, element=element)
        steps = steps or _SCALE_RANGE
        found.append(_Section(count, bucket_size, block, steps, full, partial, buckets, degree, offset, rows))
        offset = end
    if offset != len(data):
        raise FormatError(f"{len(data) - offset} bytes follow the last section", file=file)
    return found


def _row(level: int, degree: int) -> np.dtype[np.void]:
    place, value, rest = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))[level]
    fields = [("means", place, 3), ("scales", value, 3), ("quats", value, 4), ("rgba", "u1", 4)]
    return np.dtype([*fields, ("rest", rest, 3 * REST_COEFFICIENTS[degree])])


def _decode(
    data: bytes | memoryview, section: _Section, level: int, bounds: tuple[float, float], rest: int, file: str
) -> tuple[npt.NDArray[Any], ...]:
    """Means, log scales, quaternions, logits and sh of the rows of a section, the last padded to `rest`."""
    records = np.frombuffer(data, _row(level, section.degree), section.count, section.rows)
    means: npt.NDArray[Any] = records["means"]
    if level:
        centers = np.frombuffer(data, "<f4", 3 * section.buckets, section.start + 4 * section.partial).reshape(-1, 3)
        step = 0.5 * section.block / section.steps
        means = (means.astype(np.float64) - section.steps) * step + centers[_bucket_of(data, section, file)]
    with np.errstate(divide="ignore", invalid="ignore"):  # a scale of zero is mended, a negative one is a fault
        log_scales = np.log(records["scales"].astype(np.float32))
    quats = records["quats"].astype(np.float32)
    if level:  # half floats never give unit length: no fault of the file
        with np.errstate(invalid="ignore", over="ignore"):  # damaged ones are refused further on
            norms = np.linalg.norm(quats, axis=1, keepdims=True)
            quats /= np.where(norms > 0, norms, 1)
    sh = np.zeros((len(records), 1 + rest, 3), dtype=np.float32)
    sh[:, 0] = (records["rgba"][:, :3] / 255 - 0.5) / SH_C0
    values = records["rest"].astype(np.float32)
    if level == 2:
        values = values / np.float32(255) * np.float32(bounds[1] - bounds[0]) + np.float32(bounds[0])
    _spread(values, sh)
    return means, log_scales, quats, ALPHA_LOGITS.astype(np.float32)[records["rgba"][:, 3]], sh


def _bucket_of(data: bytes | memoryview, section: _Section, file: str) -> npt.NDArray[np.int64]:
    """(N,) bucket of each row: the full ones come first, then the others, whose lengths are listed."""
    filled = min(section.full * section.bucket_size, section.count)
    first = np.arange(filled, dtype=np.int64) // max(section.bucket_size, 1)
    lengths = np.frombuffer(data, "<u4", section.partial, section.start).astype(np.int64)
    left = section.count - filled
    if lengths.sum() < left:
        message = f"{section.full} full and {section.partial} other buckets have room for {filled + lengths.sum()}"
        raise FormatError(f"{message} of {section.count} Gaussians", file=file)
    ends = np.cumsum(lengths)
    return np.concatenate([first, section.full + np.searchsorted(ends, np.arange(left), side="right")])


def _spread(values: Float32, sh: Float32) -> None:
    """Fill sh[:, 1:] of (N, K, 3) from columns that stand channel after channel within each degree."""
    done = 0
    for width in (3, 5):
        if 3 * (done + width) <= values.shape[1]:
            band = values[:, 3 * done : 3 * (done + width)].reshape(len(values), 3, width)
            sh[:, 1 + done : 1 + done + width] = band.transpose(0, 2, 1)
            done += width


def _is_one(data: bytes, file: str) -> bool:
    """The name alone counts, too, unless the content shows what else it is."""
    named = file.lower().endswith(".ksplat") and len(data) > 0
    return looks_like_ksplat(data) or (named and advice_for(data, "") is None)


KINDS = (Kind("ksplat", _is_one, lambda data, file, _: read_ksplat(data, file=file), guessed=True),)
