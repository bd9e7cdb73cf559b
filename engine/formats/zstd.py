"""One zstd frame to bytes and back, by what Python 3.14 has built in (`backports.zstd` before)."""

import sys
from io import BytesIO

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ZstdError = zstd.ZstdError

_PIECE = 1 << 17


def compress(data: bytes, level: int) -> bytes:
    """One frame that names its content's size; the same bytes for the same data and level with one version of zstd."""
    return zstd.ZstdCompressor(level).compress(data, zstd.ZstdCompressor.FLUSH_FRAME)


def content_size(frame: bytes) -> int | None:
    """Bytes that a frame says it unpacks to, None where it does not; ZstdError if it is no frame."""
    return zstd.get_frame_info(frame).decompressed_size


def decompress(frame: bytes, size: int) -> bytes:
    """The content of a frame, of at most `size` bytes; ZstdError if it is damaged, cut off, longer or not alone."""
    opened, content, given = zstd.ZstdDecompressor(), BytesIO(), 0
    while given < len(frame) and not opened.eof:
        piece = memoryview(frame)[given : given + _PIECE]  # pieces, as the decompressor copies what it has not used
        given += len(piece)
        content.write(opened.decompress(piece, size + 1 - content.tell()))  # one more: it reaches the frame's end
        if content.tell() > size:
            raise ZstdError(f"more than {size} bytes")
    if not opened.eof:
        raise ZstdError("cut off")
    if given < len(frame) or opened.unused_data:
        raise ZstdError("more follows the frame")
    return content.getvalue()
