"""SuperSplat's compressed PLY: chunks of 256 Gaussians, four 32-bit words each, 8-bit spherical harmonics.

The conventions are those of playcanvas/splat-transform: 11-10-11 bits for centre and log scale between the
chunk's bounds, 2-10-10-10 for the quaternion without its largest component, 8-8-8-8 for color and opacity.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError
from engine.formats.modes import comment_of, mode_of_comments, with_mode
from engine.formats.morton import morton_order
from engine.formats.ply.body import read_tables
from engine.formats.ply.extras import carried_by, carrying, ignored, lines_of
from engine.formats.ply.header import ANY_BYTES, Element, Header, parse_header
from engine.formats.repairs import Repair, clean, degree_dropped
from engine.formats.smallest_three import put_together, take_apart
from engine.model import SH_C0, Float32, Float64, GaussianModel

CHUNK = 256
"""Gaussians that share bounds."""

_BOUNDS = [
    f"{end}_{name}"
    for names in (("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b"))
    for end in ("min", "max")
    for name in names
]
_WORDS = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
_SCALE_LIMIT = 20.0  # the format clamps log scales there
_REST_VALUES = np.array([-4, *(np.arange(1, 255) / 32 - 3.984375), 4], np.float32)
"""Coefficient of every byte: the middle of its step, the two ends for 0 and 255."""
_CHUNKS_AT_ONCE = 64
_MAX_REST = 15  # coefficients beyond the first that a model holds


def is_compressed(header: Header) -> bool:
    """Whether a PLY header announces this format rather than plain Gaussians."""
    vertex = header.element("vertex")
    return vertex is not None and "packed_position" in vertex.names


def read_compressed_ply(data: bytes | memoryview, *, file: str) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """Read a compressed PLY, degree 0 to 3 (4 up to 3), with or without color bounds.

    FormatError if the bytes are not what the header says, or an element or property is missing or of the wrong kind.
    """
    header = parse_header(data, file=file)
    chunk, vertex, sh = _check_elements(header, file)
    kept = [e.name for e in header.elements if e in (chunk, vertex, sh)]
    tables = read_tables(data, header, kept, file=file)
    bounded_color = "min_r" in chunk.names
    bounds = np.stack([tables["chunk"][name] for name in _BOUNDS[: 18 if bounded_color else 12]], axis=1)
    with np.errstate(invalid="ignore"):  # signalling NaN
        bounds = bounds.astype(np.float64)  # (C, 12 or 18)
    if not bounded_color:
        bounds = np.hstack([bounds, np.zeros((len(bounds), 3)), np.ones((len(bounds), 3))])  # (C, 18)

    count, words = vertex.count, tables["vertex"]
    channel = 0 if sh is None else len(sh.properties) // 3  # coefficients a channel in the file
    rest = min(channel, _MAX_REST)
    means, log_scales = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    quats, logits = np.empty((count, 4), np.float32), np.empty(count, np.float32)
    coefficients = np.empty((count, 1 + rest, 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # hostile bounds are found by `clean`
        for start in range(0, count, CHUNK * _CHUNKS_AT_ONCE):
            rows = slice(start, min(start + CHUNK * _CHUNKS_AT_ONCE, count))
            block = words[rows]
            box = np.repeat(bounds[start // CHUNK : -(-rows.stop // CHUNK)], CHUNK, axis=0)[: len(block)]
            means[rows] = _between(box[:, 0:6], _unpack(block["packed_position"], (11, 10, 11)))
            log_scales[rows] = _between(box[:, 6:12], _unpack(block["packed_scale"], (11, 10, 11)))
            color = _unpack(block["packed_color"], (8, 8, 8, 8))
            coefficients[rows, 0] = (_between(box[:, 12:18], color[:, :3]) - 0.5) / SH_C0
            logits[rows] = np.log(color[:, 3]) - np.log1p(-color[:, 3])
            quats[rows] = _unpack_rotations(block["packed_rotation"])
            for c in range(3 if rest else 0):
                for k in range(rest):
                    coefficients[rows, 1 + k, c] = _REST_VALUES[tables["sh"][rows][f"f_rest_{c * channel + k}"]]
    model, repairs = clean(means, log_scales, quats, logits, coefficients, file=file)
    if channel > rest:
        repairs = (degree_dropped(4, count), *repairs)
    others = [e.name for e in header.elements if e.name not in kept]
    if others:
        repairs = (ignored("elements", others), *repairs)
    more = [name for name in (p.name for p in vertex.properties) if name not in _WORDS]
    repairs = (*carrying(header, more), *repairs)
    used = None if model.file_rows is None else model.file_rows.rows
    model = model.with_(carried=carried_by(header, words, more, used))
    return with_mode(model, mode_of_comments(header.comments)), repairs


def write_compressed_ply(model: GaussianModel) -> bytes:
    """The file: 16 bytes a Gaussian, 72 a chunk, and one for every coefficient beyond the first three.

    The Gaussians stand in Morton order, so that a chunk is small. Errors are at most half a step of the chunk's extent
    / 2047 (y: 1023), 1/255 in color and opacity; a coefficient within +-4 is off by up to 1/32, one beyond is clipped.
    """
    order = morton_order(model.means)
    rest, comment = _quantize_rest(model.sh, order), [*comment_of(model), *lines_of(model.carried)[0]]
    model = model.with_(sh=model.sh[:, :1]).take(order)
    count, chunks = len(model), -(-len(model) // CHUNK)
    colors = 0.5 + SH_C0 * model.sh[:, 0].astype(np.float64)
    log_scales = np.clip(model.log_scales, -_SCALE_LIMIT, _SCALE_LIMIT)
    bounds, packed = [], {}
    for word, values in (("packed_position", model.means), ("packed_scale", log_scales), ("packed_color", colors)):
        low, high = _chunk_bounds(values, chunks)
        bounds += [low, high]
        steps = _within(values.astype(np.float64), low, high)
        if word == "packed_color":
            packed[word] = _pack(np.column_stack([steps, model.opacities]), (8, 8, 8, 8))
        else:
            packed[word] = _pack(steps, (11, 10, 11))
    packed["packed_rotation"] = _pack_rotations(model.quats)

    words = np.column_stack([packed[word] for word in _WORDS]).astype("<u4")  # (N, 4)
    lines = ["ply", "format binary_little_endian 1.0", *comment, f"element chunk {chunks}"]
    lines += [f"property float {name}" for name in _BOUNDS]
    lines += [f"element vertex {count}", *(f"property uint {word}" for word in _WORDS)]
    if rest.shape[1]:
        lines += [f"element sh {count}", *(f"property uchar f_rest_{i}" for i in range(rest.shape[1]))]
    header = ("\n".join([*lines, "end_header"]) + "\n").encode(*ANY_BYTES)
    return b"".join([header, np.hstack(bounds).astype("<f4").tobytes(), words.tobytes(), rest.tobytes()])


def rounded(values: Float32, means: Float32, tops: tuple[int, ...]) -> Float64:
    """(N, 3) values as the file holds them, in the order given: in so many steps between the bounds of a chunk."""
    order = morton_order(means)
    ordered = values[order].astype(np.float64)
    low, high = _chunk_bounds(values[order], -(-len(means) // CHUNK))
    steps = np.clip(np.floor(_within(ordered, low, high) * tops + 0.5), 0, tops) / tops
    box = np.repeat(np.hstack([low, high]).astype(np.float64), CHUNK, axis=0)[: len(ordered)]
    found = np.empty_like(ordered)
    found[order] = _between(box, steps)
    return found


def _quantize_rest(sh: Float32, order: npt.NDArray[np.int64]) -> npt.NDArray[np.uint8]:
    """(N, 3 (K - 1)) bytes of all coefficients but the first, channel-major as in PLY, rows in that order."""
    coefficients = sh.shape[1] - 1
    quantized = np.empty((len(sh), 3, coefficients), dtype=np.uint8)
    for start in range(0, len(sh) if coefficients else 0, CHUNK * _CHUNKS_AT_ONCE):
        rows = slice(start, start + CHUNK * _CHUNKS_AT_ONCE)
        steps = sh[order[rows], 1:] * np.float32(32) + np.float32(128)
        quantized[rows] = np.clip(steps, 0, 255, out=steps).astype(np.uint8).transpose(0, 2, 1)
    return quantized.reshape(len(sh), -1)


def _check_elements(header: Header, file: str) -> tuple[Element, Element, Element | None]:
    """The three elements once their counts and properties are known to agree."""
    chunk, vertex, sh = (header.element(name) for name in ("chunk", "vertex", "sh"))
    if vertex is None or chunk is None:
        raise FormatError("is missing", file=file, element="vertex" if vertex is None else "chunk")
    for element, names, code in ((chunk, _BOUNDS[:12], "f4"), (vertex, _WORDS, "u4")):
        types = {p.name: p.code for p in element.properties}
        if element is chunk and "min_r" in types:
            names = _BOUNDS
        for name in names:
            if types.get(name) != code:
                what = "is missing" if name not in types else f"must be {np.dtype(code).name}"
                raise FormatError(what, file=file, element=element.name, prop=name)
    if chunk.count != -(-vertex.count // CHUNK):
        message = f"{chunk.count} chunks for {vertex.count} Gaussians, expected one for every {CHUNK}"
        raise FormatError(message, file=file, element="chunk")
    if sh is not None:
        if sh.count != vertex.count:
            raise FormatError(f"{sh.count} rows for {vertex.count} Gaussians", file=file, element="sh")
        if len(sh.properties) not in (9, 24, 45, 72):
            message = f"{len(sh.properties)} coefficients, expected 9, 24, 45 or 72 (degree 1 to 4)"
            raise FormatError(message, file=file, element="sh")
        types = {p.name: p.code for p in sh.properties}
        for i in range(len(sh.properties)):
            if types.get(f"f_rest_{i}") != "u1":
                raise FormatError("is missing or no uchar", file=file, element="sh", prop=f"f_rest_{i}")
    return chunk, vertex, sh


def _unpack(words: npt.NDArray[Any], bits: tuple[int, ...]) -> Float64:
    """(N, len(bits)) fractions in 0..1; the first stands in the highest bits."""
    columns, shift = [], 32
    for width in bits:
        shift -= width
        top = (1 << width) - 1
        columns.append(((words >> shift) & top) / top)
    return np.stack(columns, axis=1)


def _pack(fractions: npt.NDArray[Any], bits: tuple[int, ...]) -> npt.NDArray[np.uint32]:
    """(N,) words of (N, len(bits)) fractions in 0..1, rounded to the nearest step."""
    word: npt.NDArray[np.uint32] = np.zeros(len(fractions), dtype=np.uint32)
    for column, width in zip(fractions.T, bits, strict=True):
        top = (1 << width) - 1
        step = np.clip(np.floor(column * top + 0.5), 0, top).astype(np.uint32)
        word = (word << np.uint32(width)) | step
    return word


def _between(box: Float64, fractions: Float64) -> Float64:
    """Values between the bounds of a box (N, 6); the bounds themselves are met exactly."""
    return box[:, :3] * (1 - fractions) + box[:, 3:] * fractions


def _within(values: Float64, low: Float32, high: Float32) -> Float64:
    """Inverse of `_between`, of chunks' bounds (C, 3)."""
    base = np.repeat(low.astype(np.float64), CHUNK, axis=0)[: len(values)]
    extent = np.repeat(high.astype(np.float64), CHUNK, axis=0)[: len(values)] - base
    return (values - base) / np.where(extent > 0, extent, 1.0)


def _chunk_bounds(values: npt.NDArray[Any], chunks: int) -> tuple[Float32, Float32]:
    """(C, 3) smallest and largest values of every chunk; the last chunk may be short."""
    starts = np.arange(chunks) * CHUNK
    low = np.minimum.reduceat(values, starts, axis=0)
    return low.astype(np.float32), np.maximum.reduceat(values, starts, axis=0).astype(np.float32)


def _unpack_rotations(words: npt.NDArray[Any]) -> Float64:
    """(N, 4) quaternions; a component other than the largest lies within +-sqrt(1/2)."""
    small = (_unpack(words & 0x3FFFFFFF, (2, 10, 10, 10))[:, 1:] - 0.5) * np.sqrt(2)
    return put_together(small, words >> 30)


def _pack_rotations(quats: Float32) -> npt.NDArray[np.uint32]:
    small, largest = take_apart(quats)
    packed = _pack(small * np.sqrt(0.5) + 0.5, (10, 10, 10))
    index: npt.NDArray[np.uint32] = largest.astype(np.uint32) << np.uint32(30)
    return packed | index
