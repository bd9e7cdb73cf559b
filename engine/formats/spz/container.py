"""The containers of SPZ: one stream, gzip or plain (versions 1 to 3), and a header with zstd streams (version 4)."""

import struct
import zlib
from dataclasses import dataclass
from itertools import accumulate, pairwise

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats import zstd
from engine.formats.guards import GZIP_MAGIC, check_count, gunzip

MAGIC = 0x5053474E
"""The bytes "NGSP"."""

ANTIALIASED, HAS_EXTENSIONS, LEVELS_OF_DETAIL = 0x01, 0x02, 0x80
"""Bits of the header's flags. The last is Spark's: the rows are a tree of nested levels, not one scene."""

STREAM_VERSIONS = (1, 2, 3)
"""Those of one stream: 1 has centres in half floats, 3 quaternions without their largest component."""

MAX_DEGREE = 4
MAX_EXTENSION_BYTES = 1 << 16
MAX_FRACTIONAL_BITS = 24
"""Positions are 24-bit fixed point."""

ZLIB_LEVEL = 3
"""The 65 MB of 1M Gaussians with SH of degree 3 take 1.3 s; level 6 takes 1.6 to 3 times as long and saves nothing."""

_HEADER = struct.Struct("<IIIBBBB")
_HEADER_V4 = struct.Struct("<IIIBBBBI12x")
_TOC_ENTRY = struct.Struct("<QQ")
_ZSTD_RATIO = 1 << 15
"""No zstd stream expands further: the smallest block has 4 bytes and yields at most 128 KiB."""


@dataclass(frozen=True)
class Header:
    """What an SPZ file says about its rows."""

    version: int
    count: int
    sh_degree: int
    fractional_bits: int
    flags: int = 0

    @property
    def section_strides(self) -> tuple[int, ...]:
        """Bytes a Gaussian of positions, alphas, colors, scales, rotations, sh: the order of every file."""
        position, rotation = 6 if self.version == 1 else 9, 3 if self.version < 3 else 4
        return (position, 1, 3, 3, rotation, 3 * (self.sh_degree + 1) ** 2 - 3)

    @property
    def section_sizes(self) -> tuple[int, ...]:
        """Bytes of each section."""
        return tuple(stride * self.count for stride in self.section_strides)

    @property
    def spare(self) -> int:
        """Most bytes of extension records that may follow the sections of one stream."""
        return MAX_EXTENSION_BYTES if self.flags & HAS_EXTENSIONS else 0


@dataclass(frozen=True)
class Payload:
    """An unpacked SPZ file: header, its six sections, and its extension records."""

    header: Header
    sections: tuple[memoryview, ...]
    extensions: bytes


def unpack(data: bytes, *, file: str) -> Payload:
    """Take an SPZ file of version 1 to 4 apart.

    UnsupportedFormatError for another version, spherical harmonics beyond degree 4, or a tree of levels of detail;
    FormatError if it is no SPZ file, or its bytes are not those that its header implies. Never more than those is
    unpacked.
    """
    packed, version = data[:2] == GZIP_MAGIC, int.from_bytes(data[4:8], "little")
    if not packed and int.from_bytes(data[:4], "little") != MAGIC:
        raise FormatError("is no SPZ file: neither gzip nor NGSP at its start", file=file)
    if not packed and len(data) >= 8 and version not in STREAM_VERSIONS:
        return _unpack_zstd(data, file=file)
    head = gunzip(data, _HEADER.size, file=file) if packed else data[: _HEADER.size]
    if len(head) < _HEADER.size:
        raise FormatError(f"header has {len(head)} bytes, expected {_HEADER.size}", file=file)
    magic, version, count, degree, bits, flags, _ = _HEADER.unpack(head)
    header = Header(version, count, degree, bits, flags)
    _check_header(header, magic, STREAM_VERSIONS, len(data), file=file)
    # One byte more than may be there: it tells a longer stream apart, and the checksum is reached.
    most = _HEADER.size + sum(header.section_sizes) + header.spare + 1
    return _split(header, (gunzip(data, most, file=file) if packed else data)[_HEADER.size :], file=file)


def _check_header(header: Header, magic: int, versions: tuple[int, ...], size: int, *, file: str) -> None:
    if magic != MAGIC:
        raise FormatError("is no SPZ file", file=file)
    if header.version not in versions:
        message = f"SPZ version {header.version}, read are 1 to 3, in gzip or plain, and 4: export these, or .ply"
        raise UnsupportedFormatError(message, file=file, element="header")
    if header.sh_degree > MAX_DEGREE:
        message = f"spherical harmonics of degree {header.sh_degree}, read are 0 to {MAX_DEGREE}"
        raise UnsupportedFormatError(message, file=file, element="header", prop="shDegree")
    if header.flags & LEVELS_OF_DETAIL:
        message = "holds a tree of levels of detail; export a single level"
        raise UnsupportedFormatError(message, file=file, element="header", prop="flags")
    if header.fractional_bits > MAX_FRACTIONAL_BITS:
        message = f"{header.fractional_bits} fractional bits, positions have {MAX_FRACTIONAL_BITS}"
        raise FormatError(message, file=file, element="header", prop="fractionalBits")
    check_count(header.count, size, file=file)


def _split(header: Header, body: bytes, *, file: str) -> Payload:
    expected, count = sum(header.section_sizes), header.count
    if len(body) < expected:
        message = f"{len(body)} bytes of {count} Gaussians, expected {expected}: cut off, or the count is wrong"
        raise FormatError(message, file=file)
    if len(body) > expected + header.spare:
        raise FormatError(f"more than the {expected} bytes that {count} Gaussians take", file=file)
    view = memoryview(body)
    borders = pairwise(accumulate(header.section_sizes, initial=0))
    return Payload(header, tuple(view[start:stop] for start, stop in borders), bytes(view[expected:]))


def _unpack_zstd(data: bytes, *, file: str) -> Payload:
    if len(data) < _HEADER_V4.size:
        raise FormatError(f"file has {len(data)} bytes, its header alone takes {_HEADER_V4.size}", file=file)
    magic, version, count, degree, bits, flags, streams, toc = _HEADER_V4.unpack_from(data)
    header = Header(version, count, degree, bits, flags)
    _check_header(header, magic, (4,), len(data), file=file)
    sizes = header.section_sizes
    wanted = sum(size > 0 for size in sizes)
    if streams != wanted:
        raise FormatError(f"{streams} streams, expected {wanted}", file=file, element="header")
    if not _HEADER_V4.size <= toc <= _HEADER_V4.size + MAX_EXTENSION_BYTES:
        raise FormatError(f"table of contents at byte {toc}", file=file, element="header")
    position = toc + streams * _TOC_ENTRY.size
    if position > len(data):
        raise FormatError(f"table of contents ends at byte {position} of {len(data)}", file=file)
    entries = list(_TOC_ENTRY.iter_unpack(data[toc:position]))
    total = position + sum(packed for packed, _ in entries)
    if total != len(data):
        raise FormatError(f"streams end at byte {total}, the file at {len(data)}", file=file)
    parts = []
    for index, (size, (packed, unpacked)) in enumerate(zip(filter(None, sizes), entries, strict=True)):
        element = f"stream {index}"
        if unpacked != size:
            raise FormatError(f"holds {unpacked} bytes, {count} Gaussians take {size}", file=file, element=element)
        parts.append(_unzstd(data[position : position + packed], size, file=file, element=element))
        position += packed
    filled = iter(parts)
    extensions = data[_HEADER_V4.size : toc] if flags & HAS_EXTENSIONS else b""
    return Payload(header, tuple(memoryview(next(filled) if size else b"") for size in sizes), extensions)


def _unzstd(stream: bytes, size: int, *, file: str, element: str) -> bytes:
    """Exactly `size` bytes of one zstd frame; refused before any allocation where that cannot be."""
    try:
        if zstd.content_size(stream) not in (size, None) or size > _ZSTD_RATIO * len(stream):
            raise FormatError(f"{len(stream)} bytes cannot hold {size}", file=file, element=element)
        body = zstd.decompress(stream, size)
    except (zstd.ZstdError, MemoryError) as fault:
        raise FormatError(f"damaged zstd stream ({fault})", file=file, element=element) from None
    if len(body) != size:
        raise FormatError(f"unpacks to {len(body)} bytes, expected {size}", file=file, element=element)
    return body


def pack(header: Header, sections: tuple[bytes, ...]) -> bytes:
    """A file of one stream in gzip; the same bytes for the same input (no date).

    Sections are positions, alphas, colors, scales, rotations, sh.
    """
    head = _HEADER.pack(MAGIC, header.version, header.count, header.sh_degree, header.fractional_bits, header.flags, 0)
    deflater = zlib.compressobj(ZLIB_LEVEL, zlib.DEFLATED, 31)  # 31: gzip with an empty date
    return b"".join([*(deflater.compress(part) for part in (head, *sections)), deflater.flush()])
