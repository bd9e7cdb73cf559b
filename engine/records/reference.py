"""The canonical reference: a model on fixed grids, small enough to keep and exact enough to subtract.

Every attribute is rounded to a grid that its own values cannot move, so encoding is a projection:
encode(decode(encode(m))) == encode(m), byte for byte. The digest of these bytes names the reference.
Row order is kept.

=================  =======================================================  ==========================
attribute          grid                                                     kept range
=================  =======================================================  ==========================
means              power of two, 2^-12 of the 10 % quantile of the largest   any float32
                   axes' standard deviations
log_scales         2^-10 (2^-8 in version 1)                                 +-32
quats              q / q_largest in steps of 1/2047                         unit length
opacity_logits     2^-7                                                     +-16
sh, DC             2^-9                                                     +-64
sh, rest           2^-8: one byte, or 255 and a 16-bit exception            +-128
=================  =======================================================  ==========================

Integers are laid out as byte planes, least significant first, one attribute component after the other: low
planes are noise, high planes nearly constant, and an entropy coder gets the second for free.
"""

import hashlib
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError, MalformedRecordError
from engine.kernels.jit import parallel_kernel, share_of
from engine.model import GaussianModel

Arrays = dict[str, npt.NDArray[Any]]
_UInt8 = npt.NDArray[np.uint8]
_Ints = npt.NDArray[np.int64]

_VERSION = 2
# Steps per unit, largest integer either side, by version of the grid: a grain on fine scenes moves log scales by 0.003
_LOG_SCALES = {1: (256, 32 * 256 - 1), 2: (1024, 32 * 1024 - 1)}
_LOGIT_STEPS, _LOGIT_LIMIT = 128, 16 * 128 - 1
_DC_STEPS, _DC_LIMIT = 512, 64 * 512 - 1
_REST_STEPS, _REST_LIMIT = 256, 128 * 256 - 1
_QUAT_STEPS = 2047
# Grid of the means: 2^-12 of a typical small Gaussian. At 2^-8 splats of nearly equal depth swap order: 59 dB
# on a real scene, against 66 dB here, for 1.5 bytes.
_MEAN_STEPS_LOG2 = 12
_MEAN_LIMIT = 1 << 52
_ESCAPE = 255
_ROWS = 4096  # rows at a time: they pass through the cache once
_BLOCK = 64  # of them, 12 kB, to which columns are written
_NAMES = ("dc", "grid", "log_scales", "means", "opacity_logits", "quat_largest", "quats", "rest", "rest_escape")


def encode_reference(model: GaussianModel, version: int = _VERSION) -> Arrays:
    """Canonical arrays of a model, about 78 bytes a Gaussian at SH 3 before compression, about 57 after.

    The version is the grids'. InputError if the model is empty or holds a NaN or an infinity.
    """
    if len(model) == 0:
        raise InputError("an empty model cannot be a reference")
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        array = getattr(model, name)
        if not (math.isfinite(array.min()) and math.isfinite(array.max())):  # NaN comes through min and max
            raise InputError(f"{name} of the reference is not finite")
    steps, limit = _LOG_SCALES[version]
    scales = _round(model.log_scales, steps, limit)
    exponent = _mean_exponent(scales / steps, float(np.abs(model.means).max()))
    means = np.rint(model.means * 2.0**-exponent).astype(np.int64)
    base = means.min(axis=0)
    largest, quats = _encode_quats(model.quats)
    dc = _round(model.sh[:, 0], _DC_STEPS, _DC_LIMIT)
    rest, escape = _encode_rest(model.sh)
    logits = _round(model.opacity_logits[:, None], _LOGIT_STEPS, _LOGIT_LIMIT)
    return {
        "grid": np.array([version, len(model), model.sh_degree, exponent, *base], dtype=np.int64),
        "means": _to_planes(means - base),
        "log_scales": _to_planes(scales + limit),
        "quats": _to_planes(quats + _QUAT_STEPS),
        "quat_largest": largest,
        "opacity_logits": _to_planes(logits + _LOGIT_LIMIT),
        "dc": _to_planes(dc + _DC_LIMIT),
        "rest": rest,
        "rest_escape": escape,
    }


def decode_reference(arrays: Mapping[str, npt.NDArray[Any]]) -> GaussianModel:
    """The model that `encode_reference` put on its grids.

    MalformedRecordError if arrays are missing, of another type or shape than the grid says, or out of range.
    """
    if tuple(sorted(arrays)) != _NAMES:
        raise MalformedRecordError(f"a reference holds {', '.join(_NAMES)}, not {', '.join(sorted(arrays))}")
    grid = arrays["grid"]
    if grid.dtype != np.int64 or grid.shape != (7,):
        raise MalformedRecordError("the grid of the reference is malformed")
    version, n, degree, exponent, *base = (int(v) for v in grid)
    sound = n >= 1 and 0 <= degree <= 3 and -300 <= exponent <= 128 and max(map(abs, base)) <= _MEAN_LIMIT
    if version not in _LOG_SCALES or not sound:
        raise MalformedRecordError(f"the grid of the reference is out of range: {grid.tolist()}")
    means = _from_planes(arrays, "means", (3, n), 2 * _MEAN_LIMIT, np.array(base), 2.0**exponent)
    if not np.abs(means).max() < np.finfo(np.float32).max:
        raise MalformedRecordError("means of the reference are out of range")
    sh = np.empty((n, (degree + 1) ** 2, 3), dtype=np.float32)
    _decode_rest(arrays["rest"], arrays["rest_escape"], sh)
    steps, limit = _LOG_SCALES[version]
    sh[:, 0] = _from_planes(arrays, "dc", (3, n), 2 * _DC_LIMIT, -_DC_LIMIT, 1.0 / _DC_STEPS)
    return GaussianModel(
        means,
        _from_planes(arrays, "log_scales", (3, n), 2 * limit, -limit, 1.0 / steps),
        _decode_quats(
            arrays["quat_largest"], _from_planes(arrays, "quats", (3, n), 2 * _QUAT_STEPS, -_QUAT_STEPS, 1.0)
        ),
        _from_planes(arrays, "opacity_logits", (1, n), 2 * _LOGIT_LIMIT, -_LOGIT_LIMIT, 1.0 / _LOGIT_STEPS)[:, 0],
        sh,
    )


def reference_digest(arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    """SHA-256 (32 bytes) over names, types, shapes and bytes of the canonical arrays."""
    digest = hashlib.sha256(b"mark3dgs reference\0")
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape} {array.nbytes}\n".encode())
        digest.update(array.data if array.size else b"")
    return digest.digest()


def _round(values: npt.NDArray[np.float32], steps: int, limit: int) -> npt.NDArray[np.int32]:
    k: npt.NDArray[np.int32] = np.clip(np.rint(values * np.float32(steps)), -limit, limit).astype(np.int32)
    return k


def _mean_exponent(scales: npt.NDArray[np.float64], reach: float) -> int:
    """log2 of the grid of the means. Follows from the *rounded* log scales, so decoding does not move it."""
    largest = scales.max(axis=1)
    rank = len(largest) // 10
    small = float(np.partition(largest, rank)[rank])  # natural logarithm of a deviation
    exponent = math.floor(small / math.log(2)) - _MEAN_STEPS_LOG2
    # At most 2^52 steps either side, so that one stray Gaussian does not coarsen the grid of all others.
    # Where even this binds, the farthest mean, of 24 bits, is not rounded at all: decoding keeps the grid.
    return max(exponent, math.frexp(reach)[1] - 52)


def _encode_quats(quats: npt.NDArray[np.float32]) -> tuple[_UInt8, npt.NDArray[np.int32]]:
    """(N,) index of the largest component, (N,3) the others in steps of 1/2047 of it."""
    rows = np.arange(len(quats))
    top = np.abs(quats).max(axis=1)
    k = np.rint(quats * (_QUAT_STEPS / np.where(top > 0, top, 1))[:, None]).astype(np.int32)
    k[top == 0, 0] = _QUAT_STEPS  # no rotation
    # Index and sign are chosen after rounding: of components that round to equal size, the first leads.
    index = (np.abs(k) == _QUAT_STEPS).argmax(axis=1)
    k *= np.sign(k[rows, index])[:, None]
    return index.astype(np.uint8), k[np.arange(4) != index[:, None]].reshape(-1, 3)


def _decode_quats(index: npt.NDArray[Any], others: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    n = len(others)
    if index.dtype != np.uint8 or index.shape != (n,) or index.max() > 3:
        raise MalformedRecordError("quaternions of the reference are malformed")
    quats = np.empty((n, 4), dtype=np.float32)
    _complete(np.ascontiguousarray(index), others, quats)
    return quats


@parallel_kernel
def _complete(index, others, quats, call):  # type: ignore[no-untyped-def]
    """Unit quaternions (N, 4) of their components (N, 3) but for the largest, which is at `index` (N,)."""
    for i in share_of(len(index), call):
        top = index[i]
        squares = float(_QUAT_STEPS * _QUAT_STEPS)
        for k in range(3):
            squares += float(others[i, k]) * others[i, k]
        # As single precision divides, which the freedoms of kernels would not; in double they leave no trace.
        norm = float(np.float32(math.sqrt(squares)))
        for k in range(4):
            step = float(_QUAT_STEPS) if k == top else float(others[i, k - (k > top)])
            quats[i, k] = np.float32(step / norm)


def _encode_rest(sh: npt.NDArray[np.float32]) -> tuple[_UInt8, npt.NDArray[np.uint16]]:
    """(K-1)*3 rows of N bytes, and the exceptions in the order of their 255s."""
    n, width = len(sh), 3 * (sh.shape[1] - 1)
    flat = sh.reshape(n, -1)[:, 3:]
    rest = np.empty((width, n), dtype=np.uint8)
    for start in range(0, n, _ROWS):
        zigzag = _zigzag(flat[start : start + _ROWS])
        rest[:, start : start + _ROWS] = np.minimum(zigzag, _ESCAPE).T
    column, row = np.nonzero(rest == _ESCAPE)
    return rest, _zigzag(flat[row, column])


def _zigzag(values: npt.NDArray[np.float32]) -> npt.NDArray[np.uint16]:
    """0, -1, 1, -2, ... to 0, 1, 2, 3, ...: small magnitudes become small unsigned integers."""
    steps = np.rint(values * np.float32(_REST_STEPS))
    k = np.clip(steps, -_REST_LIMIT, _REST_LIMIT, out=steps).astype(np.int16)
    zigzag: npt.NDArray[np.uint16] = ((k << 1) ^ (k >> 15)).view(np.uint16)
    return zigzag


def _decode_rest(rest: npt.NDArray[Any], escape: npt.NDArray[Any], sh: npt.NDArray[np.float32]) -> None:
    n, width = len(sh), 3 * (sh.shape[1] - 1)
    if rest.dtype != np.uint8 or rest.shape != (width, n) or escape.dtype != np.uint16 or escape.ndim != 1:
        raise MalformedRecordError("SH of the reference are malformed")
    rest, escapes = np.ascontiguousarray(rest), np.empty((width, -(-n // _ROWS)), dtype=np.int64)
    _count_escapes(rest, escapes)
    if escapes.sum() != len(escape) or (escape < _ESCAPE).any():
        raise MalformedRecordError("SH exceptions of the reference are malformed")
    first = np.cumsum(escapes).reshape(escapes.shape) - escapes
    if width:  # rows of nothing have a layout of their own, for which a kernel would be compiled
        _look_up_rows(rest, _unzigzag(np.arange(_ESCAPE)), _unzigzag(escape), first, sh.reshape(n, -1)[:, 3:])


def _unzigzag(values: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    zigzag = values.astype(np.int64)
    return ((zigzag >> 1) ^ -(zigzag & 1)).astype(np.float32) / np.float32(_REST_STEPS)


@parallel_kernel
def _count_escapes(codes, counts, call):  # type: ignore[no-untyped-def]
    """How many codes (K, N) of each column stand for an exception, by blocks of rows: (K, B)."""
    count = codes.shape[1]
    for cell in share_of(counts.size, call):
        k, block = cell // counts.shape[1], cell % counts.shape[1]
        found = 0
        for i in range(block * _ROWS, min((block + 1) * _ROWS, count)):
            found += codes[k, i] == _ESCAPE
        counts[k, block] = found


@parallel_kernel
def _look_up_rows(codes, table, exact, following, rows, call):  # type: ignore[no-untyped-def]
    """Entries of a table by codes (K, N), to rows (N, K), in blocks that stay in the cache. `following` (K, B): where
    the next exception of each column and block of rows is in `exact`."""
    count = len(rows)
    for block in share_of(following.shape[1], call):
        for first in range(block * _ROWS, min((block + 1) * _ROWS, count), _BLOCK):
            for k in range(len(codes)):
                for i in range(first, min(first + _BLOCK, count)):
                    code = codes[k, i]
                    if code == _ESCAPE:
                        rows[i, k] = exact[following[k, block]]
                        following[k, block] += 1
                    else:
                        rows[i, k] = table[code]


def _to_planes(values: npt.NDArray[Any]) -> _UInt8:
    """(N,D) non-negative integers to (P,D,N) bytes, P the fewest planes that hold the largest."""
    planes = max(1, -(-int(values.max()).bit_length() // 8))
    columns = np.ascontiguousarray(values.T, dtype="<u4" if planes <= 4 else "<u8")
    words = columns.view(np.uint8).reshape(*columns.shape, columns.itemsize)
    return np.ascontiguousarray(np.moveaxis(words, 2, 0)[:planes])


def _from_planes(
    arrays: Mapping[str, Any], name: str, shape: tuple[int, int], limit: int, base: _Ints | int, step: float
) -> npt.NDArray[np.float32]:
    """(N,D) integers of `_to_planes`, plus base (D,), times step; refuses other shapes, and integers above the
    limit."""
    planes = arrays[name]
    if planes.dtype != np.uint8 or planes.ndim != 3 or planes.shape[1:] != shape or not 1 <= len(planes) <= 7:
        raise MalformedRecordError(f"{name} of the reference has shape {planes.shape}")
    columns, n = shape
    rows, largest = np.empty((n, columns), dtype=np.float32), np.empty(-(-n // _ROWS), dtype=np.int64)
    _join_planes(np.ascontiguousarray(planes), np.broadcast_to(base, columns).astype(np.int64), step, rows, largest)
    if int(largest.max()) > limit:
        raise MalformedRecordError(f"{name} of the reference is out of range")
    return rows


@parallel_kernel
def _join_planes(planes, base, step, rows, largest, call):  # type: ignore[no-untyped-def]
    """`_from_planes`, to `rows`; and the largest integer of each block of rows, to `largest` (B,)."""
    count, columns = rows.shape
    for block in share_of(len(largest), call):
        most = np.int64(0)
        for i in range(block * _ROWS, min((block + 1) * _ROWS, count)):
            for d in range(columns):
                value = np.int64(0)
                for p in range(len(planes)):
                    value |= np.int64(planes[p, d, i]) << (8 * p)
                most = max(most, value)
                rows[i, d] = np.float32((value + base[d]) * step)
        largest[block] = most
