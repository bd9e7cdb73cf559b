"""A glTF asset as its JSON and the bytes of its buffers: a GLB, or a .gltf with buffers in data URIs or beside it.

Khronos Group, "glTF 2.0 Specification", sections 3.6 (buffers, accessors) and 4 (GLB).
"""

import base64
import binascii
import json
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.guards import beside, json_object, read_regular
from engine.numerics.plain import Json

MAGIC = b"glTF"
MAX_JSON_BYTES = 1 << 24
"""A scene of one primitive takes 10 kB; 16 MB is a city of them."""

UNPACK = "unpack it (npx @gltf-transform/cli copy FILE unpacked.glb)"
"""What to do with meshes that Draco or meshopt packed."""

_HEADER, _CHUNK = struct.Struct("<4sII"), struct.Struct("<II")
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_DATA_URI = re.compile(r"data:[\w.+/-]*;base64,")
_CODES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_PADDING = {_JSON: b" ", _BIN: b"\0"}


@dataclass(frozen=True)
class Asset:
    """The JSON of an asset, which is an object, and its binary chunk."""

    json: Mapping[str, Any]
    binary: memoryview
    file: str
    folder: Path | None = None  # whose files it may name
    opened: list[Path] = field(default_factory=list)  # of these files
    decoded: dict[int, memoryview] = field(default_factory=dict)  # buffers out of data URIs, or other files

    def rows(self, kind: str) -> list[Any]:
        """A list at the top of the JSON, empty where there is none; FormatError if it is no list."""
        found = self.json.get(kind, [])
        if not isinstance(found, list):
            raise self.fault("is no list", kind)
        return found

    def row(self, kind: str, index: object) -> Mapping[str, Any]:
        """An object of such a list; FormatError if the index is none, or leads nowhere."""
        rows = self.rows(kind)
        if type(index) is not int or not 0 <= index < len(rows):
            raise self.fault(f"index {index!r:.40} leads nowhere: there are {len(rows)}", kind)
        row = rows[index]
        if not isinstance(row, dict):
            raise self.fault(f"number {index} is no object", kind)
        return row

    def fault(self, message: str, element: str, prop: str | None = None) -> FormatError:
        """What is wrong, and where."""
        return FormatError(message, file=self.file, element=element, prop=prop)

    @property
    def generator(self) -> str:
        """Name of the program that wrote the file; empty if the file does not give one."""
        about = self.json.get("asset")
        found = about.get("generator") if isinstance(about, dict) else None
        return found if isinstance(found, str) else ""

    @property
    def size_beside(self) -> int:
        """Bytes of its buffers in other files."""
        rows = self.rows("buffers") if self.folder else []
        return sum(len(self._buffer(k)) for k in range(len(rows)) if "uri" in self.row("buffers", k))

    def length(self, index: object) -> int:
        """Number of rows that an accessor claims."""
        return _whole(self, self.row("accessors", index), "count", f"accessor {index}")

    def values(self, index: object, widths: tuple[int, ...], prop: str) -> npt.NDArray[np.float32]:
        """(N, width) values of an accessor, integers as their component type says (normalised, or as they are).

        FormatError where it does not lie in its buffer, which is checked before anything is decoded, or has another
        width; UnsupportedFormatError if it is sparse.
        """
        accessor, element = self.row("accessors", index), f"accessor {index}"
        if "sparse" in accessor or "bufferView" not in accessor:
            message = "is sparse or has no bufferView, which is not read: export it as .ply or .spz"
            raise UnsupportedFormatError(message, file=self.file, element=element, prop=prop)
        code, kind = accessor.get("componentType"), accessor.get("type")
        width = _WIDTHS.get(str(kind))
        if not isinstance(code, int) or code not in _CODES or width is None or width not in widths:
            wanted = " or ".join(map(str, widths))
            raise self.fault(f"is of {kind!r:.20} and {code!r:.20}, expected {wanted} numbers a row", element, prop)
        view = self.row("bufferViews", accessor.get("bufferView"))
        if "extensions" in view:
            message = f"its buffer view has extensions: {ascii(view['extensions'])[:120]}; {UNPACK}"
            raise UnsupportedFormatError(message, file=self.file, element=element)
        count, dtype = _whole(self, accessor, "count", element), np.dtype(_CODES[code])
        buffer = self._buffer(view.get("buffer"))
        start, room = (_whole(self, view, key, "bufferView", 0) for key in ("byteOffset", "byteLength"))
        stride = _whole(self, view, "byteStride", "bufferView", 0) or width * dtype.itemsize
        first = _whole(self, accessor, "byteOffset", element, 0)
        end = first + (count - 1) * stride + width * dtype.itemsize if count else first
        if start + room > len(buffer) or end > room or not width * dtype.itemsize <= stride <= 252:
            message = f"{count} rows end at byte {end} of a view of {room} in a buffer of {len(buffer)}"
            raise self.fault(message, element, prop)
        at, strides = start + first, (stride, dtype.itemsize)
        table: npt.NDArray[Any] = np.ndarray((count, width), dtype, buffer, at, strides)
        found = table.astype(np.float32)
        if accessor.get("normalized") is True and dtype.kind in "iu":
            found = np.maximum(found / np.float32(np.iinfo(dtype).max), np.float32(-1.0))
        return found

    def attribute(self, attributes: Mapping[str, Any], name: str, *widths: int) -> npt.NDArray[np.float32]:
        """(N, width) values of an attribute of a primitive, as many as it has positions; errors as `values`."""
        found, count = self.values(attributes.get(name), widths, name), self.length(attributes["POSITION"])
        if len(found) != count:
            raise self.fault(f"has {len(found)} rows, POSITION {count}", "primitive", name)
        return found

    def blob(self, index: object) -> bytes:
        """The bytes of a buffer view; FormatError where they do not lie in its buffer."""
        view = self.row("bufferViews", index)
        buffer = self._buffer(view.get("buffer"))
        start, room = _whole(self, view, "byteOffset", "bufferView", 0), _whole(self, view, "byteLength", "bufferView")
        if start + room > len(buffer):
            raise self.fault(f"ends at byte {start + room} in a buffer of {len(buffer)}", f"bufferView {index}")
        return bytes(buffer[start : start + room])

    def _buffer(self, index: object) -> memoryview:
        buffer = self.row("buffers", index)
        assert isinstance(index, int)  # `row` has seen to it
        if index in self.decoded:
            return self.decoded[index]
        uri = buffer.get("uri")
        if uri is None:
            if index != 0 or not len(self.binary):
                raise self.fault(f"buffer {index} is nowhere: there is no binary chunk", "buffers")
            return self.binary
        self.decoded[index] = memoryview(self.resource(uri, f"buffer {index}", "buffers"))
        return self.decoded[index]

    def resource(self, uri: object, what: str, element: str) -> bytes:
        """The bytes that a URI stands for; UnsupportedFormatError where they lie in another file that is not given."""
        if isinstance(uri, str) and _DATA_URI.match(uri):
            try:
                return base64.b64decode(uri[uri.index(",") + 1 :], validate=True)
            except (binascii.Error, ValueError):
                raise self.fault(f"{what} is no base64", element) from None
        if not isinstance(uri, str) or self.folder is None:
            message = f"{what} lies in another file ({uri!r:.60}): give the scene as one file, .glb"
            raise UnsupportedFormatError(message, file=self.file, element=element)
        path = beside(self.folder, unquote(uri), self.file)
        self.opened.append(path)
        return read_regular(path, str(path))


def unpack(data: bytes, *, file: str, folder: Path | None = None) -> Asset:
    """Take an asset apart, which may name files in the folder, if one is given. FormatError if a GLB's lengths do not
    agree, or the JSON is none; UnsupportedFormatError for another version than 2."""
    if data[:4] != MAGIC:
        return Asset(_parse(data, file, limit=len(data)), memoryview(b""), file, folder)
    if len(data) < _HEADER.size + _CHUNK.size:
        raise FormatError(f"has {len(data)} bytes, its headers alone take {_HEADER.size + _CHUNK.size}", file=file)
    _, version, total = _HEADER.unpack_from(data)
    if version != 2:
        raise UnsupportedFormatError(f"glTF version {version}, read is 2", file=file, element="header")
    if total != len(data):
        what = "cut off" if total > len(data) else "bytes follow"
        raise FormatError(f"says it has {total} bytes, {len(data)} are there: {what}", file=file, element="header")
    length, kind = _CHUNK.unpack_from(data, _HEADER.size)
    start = _HEADER.size + _CHUNK.size
    if kind != _JSON or start + length > total:
        raise FormatError(f"the first chunk is {kind:#010x} of {length} bytes", file=file, element="header")
    parsed = _parse(data[start : start + length], file, limit=MAX_JSON_BYTES)
    start += length
    if start == total:
        return Asset(parsed, memoryview(b""), file, folder)
    if start + _CHUNK.size > total:
        raise FormatError("a chunk's header is cut off", file=file)
    length, kind = _CHUNK.unpack_from(data, start)
    start += _CHUNK.size
    if kind != _BIN or start + length > total:
        raise FormatError(f"the second chunk is {kind:#010x} of {length} bytes", file=file, element="header")
    return Asset(parsed, memoryview(data)[start : start + length], file, folder)


def pack_glb(parsed: Mapping[str, Any], binary: list[bytes]) -> list[bytes]:
    """A GLB in pieces, from its JSON and the parts of its binary chunk; no date, no trace of the machine."""
    text = json.dumps(parsed, separators=(",", ":"), allow_nan=False).encode()
    text += _PADDING[_JSON] * (-len(text) % 4)
    size = sum(map(len, binary))
    tail = _PADDING[_BIN] * (-size % 4)
    total = _HEADER.size + 2 * _CHUNK.size + len(text) + size + len(tail)
    head = _HEADER.pack(MAGIC, 2, total) + _CHUNK.pack(len(text), _JSON)
    return [head, text, _CHUNK.pack(size + len(tail), _BIN), *binary, tail]


def _parse(text: bytes, file: str, limit: int) -> Json:
    if len(text) > limit:
        raise FormatError(f"its JSON has {len(text)} bytes, more than {limit}", file=file)
    parsed = json_object(text, file=file, element="JSON")
    about = parsed.get("asset")
    if isinstance(about, dict) and str(about.get("version")).startswith("1."):
        raise UnsupportedFormatError(f"glTF version {str(about['version'])[:20]!a}, read is 2", file=file)
    return parsed


def _whole(asset: Asset, row: Mapping[str, Any], key: str, element: str, default: int | None = None) -> int:
    value = row.get(key, default)
    if type(value) is not int or not 0 <= value < 1 << 53:
        raise asset.fault(f"{value!r:.40} is no number of bytes or rows", element, key)
    return value
