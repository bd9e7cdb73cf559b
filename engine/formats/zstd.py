"""One zstd frame to bytes and back, by what Python 3.14 has built in and `backports.zstd` brings to earlier versions."""

import sys

if sys.version_info >= (3, 14):
    from compression.zstd import ZstdCompressor, ZstdDecompressor, ZstdError, get_frame_info, zstd_version_info
else:
    from backports.zstd import ZstdCompressor, ZstdDecompressor, ZstdError, get_frame_info, zstd_version_info

__all__ = ["ZstdError", "compress", "content_size", "decompress", "zstd_version_info"]


def compress(data: bytes, level: int) -> bytes:
    """One frame that names its content's size; the same bytes for the same data and level with one version of zstd."""
    return ZstdCompressor(level).compress(data, ZstdCompressor.FLUSH_FRAME)


def content_size(frame: bytes) -> int | None:
    """Bytes that a frame says it unpacks to, None where it does not; ZstdError if it is no frame."""
    return get_frame_info(frame).decompressed_size


def decompress(frame: bytes, size: int) -> bytes:
    """The content of a frame, of at most `size` bytes; ZstdError if it is damaged, cut off, longer, or followed by more."""
    opened = ZstdDecompressor()
    content = opened.decompress(frame, size + 1)  # one more byte than may be there: it reaches the end of the frame
    if len(content) > size:
        raise ZstdError(f"more than {size} bytes")
    if not opened.eof:
        raise ZstdError("cut off")
    if opened.unused_data:
        raise ZstdError(f"{len(opened.unused_data)} bytes follow")
    return content
