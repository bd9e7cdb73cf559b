"""Lossless images, WebP or PNG: the size is read from the header, and only a size that was expected is decoded."""

import io
import struct

import numpy as np
import numpy.typing as npt
from PIL import Image

from engine.errors import FormatError, UnsupportedFormatError

Pixels = npt.NDArray[np.uint8]

_PNG, _IHDR = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", struct.Struct(">IIB")

REENCODED = (
    "a SOG's images are numbers: resizing or packing with loss, as image optimizers and CDNs do, destroys them; export"
    " the scene again, and serve it as it is"
)

MAX_SIDE = 16383
"""Largest side of a WebP image."""

METHOD, QUALITY = 1, 50
"""Effort of libwebp: half the time of method 4 at the same size (0.6 s for the images of 524k Gaussians);
method 0 is five times faster still, but means_u and the labels grow by 60 %."""


def lossless_size(data: bytes, *, file: str, element: str) -> tuple[int, int]:
    """Width and height of a still, lossless WebP or PNG image of eight bits, from its header alone.

    UnsupportedFormatError if it is lossy, animated or of another depth: such an image does not keep the numbers that
    its pixels are. FormatError if it is no such image, or one without a picture.
    """
    if data.startswith(_PNG):
        if len(data) < len(_PNG) + _IHDR.size:
            raise FormatError("PNG image is cut off", file=file, element=element)
        width, height, depth = _IHDR.unpack_from(data, len(_PNG))
        if depth != 8:
            raise UnsupportedFormatError(f"is a PNG image of {depth} bits a channel, not 8", file=file, element=element)
        if b"acTL" in data[: data.find(b"IDAT") + 1]:
            raise UnsupportedFormatError("is an animated PNG image", file=file, element=element)
        return width, height
    if len(data) < 12 or data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        raise FormatError(f"is no WebP or PNG image; {REENCODED}", file=file, element=element)
    position = 12
    while position + 8 <= len(data):
        tag, length = struct.unpack_from("<4sI", data, position)
        position += 8
        if tag in (b"VP8 ", b"ANIM", b"ANMF"):
            message = f"is a lossy or animated WebP image; {REENCODED}"
            raise UnsupportedFormatError(message, file=file, element=element)
        if tag == b"VP8L":
            if position + 5 > len(data) or data[position] != 0x2F:
                break
            bits = struct.unpack_from("<I", data, position + 1)[0]
            return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
        position += length + (length & 1)
    raise FormatError("WebP image holds no lossless picture", file=file, element=element)


def decode_lossless(data: bytes, size: tuple[int, int], *, file: str, element: str) -> Pixels:
    """(H, W, 4) red, green, blue, alpha of an image whose size was read and accepted before."""
    try:
        with Image.open(io.BytesIO(data), formats=["WEBP", "PNG"]) as image:
            if image.size != size:  # the canvas of an extended header may differ from its picture
                message = f"canvas is {image.width}x{image.height}, the picture {size[0]}x{size[1]}"
                raise FormatError(message, file=file, element=element)
            pixels: Pixels = np.asarray(image if image.mode == "RGBA" else image.convert("RGBA"))
    except (OSError, ValueError, SyntaxError, EOFError, MemoryError, Image.DecompressionBombError) as fault:
        raise FormatError(f"damaged image ({fault})", file=file, element=element) from None
    if pixels.shape != (size[1], size[0], 4):
        raise FormatError(f"image unpacks to shape {pixels.shape}", file=file, element=element)
    return pixels


def encode_webp(pixels: Pixels) -> bytes:
    """Lossless WebP of (H, W, 3 or 4) pixels; colours under zero alpha are kept."""
    buffer = io.BytesIO()
    image = Image.fromarray(pixels)
    image.save(buffer, "WEBP", lossless=True, exact=True, method=METHOD, quality=QUALITY)
    return buffer.getvalue()
