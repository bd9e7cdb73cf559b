"""Deterministic container of named arrays and JSON: the inside of a record.

Layout, little-endian: u32 length of the index; the index, canonical JSON
{"arrays": [[name, type, shape], ...], "meta": {...}}, arrays sorted by name; then each array's bytes, C
order, at the next multiple of 64 from the start, gaps zero. Same content, same bytes. Reading trusts nothing:
types from a white list, sizes checked against the bytes really there before anything is allocated, no byte
left over.
"""

import json
import math
import struct
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import MalformedRecordError
from engine.numerics.plain import Json

Arrays = dict[str, npt.NDArray[Any]]

DTYPES = ("|u1", "|i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f4", "<f8")
_ALIGN = 64
_MAX_INDEX_BYTES = 16 << 20
_MAX_DIMENSIONS = 8


def canonical_json(value: Any) -> bytes:
    """The one JSON text of a value: sorted keys, no spaces, ASCII, finite numbers only.

    TypeError or ValueError if the value is no JSON, has keys that are not strings, or holds a NaN or an infinity.
    """
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return text.encode("ascii")


def parse_json(data: bytes, what: str) -> Any:
    """Value of a canonical JSON text; refuses every other spelling of it."""
    try:
        value = json.loads(data.decode("ascii"))
        canonical = canonical_json(value)
    except (ValueError, TypeError, RecursionError) as error:
        raise MalformedRecordError(f"{what} is no valid JSON") from error
    if canonical != data:
        raise MalformedRecordError(f"{what} is not in canonical form")
    return value


def pack(meta: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    """Bytes of a container of JSON values (tuples come back as lists) and arrays.

    The arrays are of the types of `DTYPES`, in any byte order, and have at most 8 dimensions. ValueError or TypeError
    if one has another type, or meta is no JSON.
    """
    return b"".join(packed_parts(meta, arrays))


def packed_parts(meta: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Iterator[bytes | memoryview]:
    """What `pack` joins, piece by piece: arrays that lie as they will be written are not copied. Errors as there."""
    index, blobs = [], []
    for name in sorted(arrays):
        array = np.asarray(arrays[name])
        dtype = array.dtype.newbyteorder("<")
        if dtype.str not in DTYPES or array.ndim > _MAX_DIMENSIONS:
            raise ValueError(f"array {name!r} of type {array.dtype} and shape {array.shape} cannot be recorded")
        index.append([name, dtype.str, list(array.shape)])
        blobs.append(np.ascontiguousarray(array, dtype=dtype).reshape(-1).view(np.uint8).data)
    head = canonical_json({"arrays": index, "meta": dict(meta)})
    if len(head) > _MAX_INDEX_BYTES:
        raise ValueError(f"meta of {len(head)} bytes is too long for a record")
    yield struct.pack("<I", len(head))
    yield head
    size = 4 + len(head)
    for blob in blobs:
        gap = -size % _ALIGN
        yield bytes(gap)
        yield blob
        size += gap + len(blob)


def unpack(data: bytes) -> tuple[Json, Arrays]:
    """Meta and arrays of a container; the arrays are read-only views of `data`.

    MalformedRecordError if any byte is not as `pack` would have written it.
    """
    if len(data) < 4:
        raise MalformedRecordError("the container is cut off")
    (length,) = struct.unpack_from("<I", data)
    if length > min(_MAX_INDEX_BYTES, len(data) - 4):
        raise MalformedRecordError(f"the container's index of {length} bytes does not fit")
    index = parse_json(data[4 : 4 + length], "the container's index")
    if not isinstance(index, dict) or set(index) != {"arrays", "meta"} or not isinstance(index["meta"], dict):
        raise MalformedRecordError("the container's index is malformed")
    if not isinstance(index["arrays"], list):
        raise MalformedRecordError("the container's list of arrays is malformed")
    arrays: Arrays = {}
    end, last = 4 + length, None
    for entry in index["arrays"]:
        name, dtype, shape = _entry(entry)
        if last is not None and name <= last:
            raise MalformedRecordError(f"array {name!r} is out of order")
        start = end + -end % _ALIGN
        count = math.prod(shape)
        end, gap, last = start + count * dtype.itemsize, data[end:start], name
        if end > len(data) or any(gap):
            raise MalformedRecordError(f"array {name!r} of {count} values does not fit")
        arrays[name] = np.frombuffer(data, dtype, count, start).reshape(shape)
    if end != len(data):
        raise MalformedRecordError(f"{len(data) - end} bytes follow the last array")
    return index["meta"], arrays


def _entry(entry: Any) -> tuple[str, np.dtype[Any], tuple[int, ...]]:
    if isinstance(entry, list) and len(entry) == 3:
        name, dtype, shape = entry
        if (
            isinstance(name, str)
            and dtype in DTYPES
            and isinstance(shape, list)
            and len(shape) <= _MAX_DIMENSIONS
            and all(type(size) is int and 0 <= size < 1 << 48 for size in shape)
        ):
            return name, np.dtype(dtype), tuple(shape)
    raise MalformedRecordError("an entry of the container's index is malformed")
