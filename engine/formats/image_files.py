"""Picture files: known by their first bytes, read as floats."""

import io
import re
import warnings
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, ImageChops, ImageCms, ImageFile, UnidentifiedImageError

from engine.errors import FormatError, InputError
from engine.formats.color_coding import coding_of
from engine.formats.kinds.splat import looks_like_splat
from engine.formats.other_files import RAW_ENDINGS, RAW_PHOTO
from engine.model import Float32

MAX_PICTURE_PIXELS = 64_000_000
"""Larger pictures are refused before they are decoded: no screen or phone makes them."""
MAX_PIXELS_TOGETHER = 200_000_000
"""Of all pictures of one suspect: 2.4 GB in memory."""

_DNG_VERSION, _BITS, _PLANES, _SEPARATE = 50706, 258, 284, 2  # tags, and a value
_SRGB = ImageCms.createProfile("sRGB")
_ROUNDING = 2  # levels of 255
_MAX_HEAD = 1 << 16  # bytes
_AV1 = re.compile(rb"av1C\x81.(.)", re.DOTALL)  # AVIF's bits a channel: AV1-ISOBMFF, 2.3.3

_MAGICS = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"BM", b"GIF8", b"II*\0", b"MM\0*")


def is_picture(path: Path, name: str = "") -> bool:
    """Whether a file starts like a PNG, JPEG, BMP, GIF, TIFF, WebP or AVIF, whatever its name (`name`, or its path's
    own) says: except for a .splat that is one by its rows, since its first number may be any bytes."""
    if path.is_dir():
        return False
    try:
        with path.open("rb") as file:
            head = file.read(64)
        webp = head[:4] == b"RIFF" and head[8:12] == b"WEBP"
        avif = head[4:8] == b"ftyp" and re.search(rb"avi[fs]", head[8 : int.from_bytes(head[:4])]) is not None
        named = (name or path.name).lower().endswith(".splat")
        return (webp or avif or head.startswith(_MAGICS)) and not (named and looks_like_splat(path.read_bytes()))
    except OSError as error:
        raise InputError(f"cannot read {str(path)!r}: {error.strerror}") from error


def read_picture(source: Path | bytes, name: str = "", *, managed: bool = True) -> Float32:
    """(H, W, 3) float32 in 0..1, upright, transparent parts over black, of a file, or of its content, which messages
    call `name`; in sRGB where `managed`, else whatever its color profile or its coding says. FormatError if it is no
    picture, is damaged, holds several or a camera's raw values, or has more than MAX_PICTURE_PIXELS pixels."""
    file = name or str(source)
    opened = io.BytesIO(source) if isinstance(source, bytes) else source
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(opened) as picture:  # of damage that is read around
            check_picture(picture, file)
            head = _head(picture)
            coding = coding_of(head, picture.info) if managed else None
            picture.load()
            turn = picture.getexif().get(ExifTags.Base.Orientation, 1) - 1
            profiled = managed and coding is None and "icc_profile" in picture.info
            values = None if profiled or "transparency" in picture.info else _deep_values(head, source)
            if values is None:
                values = _values(_in_srgb(picture) if profiled else picture, layers=picture.format != "BMP")
    except FormatError:
        raise
    except Image.DecompressionBombError as error:
        raise FormatError("picture has too many pixels", file=file) from error
    except Exception as error:  # decoders raise whatever they stumble over
        if isinstance(error, UnidentifiedImageError):
            is_raw = file.lower().endswith(RAW_ENDINGS)
            text = (
                RAW_PHOTO if is_raw else "no readable picture (damaged, or of a kind that is not read): save it as PNG"
            )
            raise FormatError(text, file=file) from error
        raise FormatError(f"no readable picture ({error})", file=file) from error
    values = np.ascontiguousarray(_upright(values, turn))
    return values if coding is None else coding.to_srgb(values)


def _head(picture: ImageFile.ImageFile) -> bytes:
    """The first bytes of a PNG, up to its pixels, or of an AVIF."""
    if picture.format not in ("PNG", "AVIF") or picture.fp is None:
        return b""
    at = picture.fp.tell()
    picture.fp.seek(0)
    head: bytes = picture.fp.read(min(at, _MAX_HEAD))
    picture.fp.seek(at)
    return head


def _deep_values(head: bytes, source: Path | bytes) -> Float32 | None:
    """(H, W, 3) from 0 to 1, over black, of a PNG or an AVIF in color of more than 8 bits, which are all that Pillow
    keeps; None of any other picture."""
    bits = head[24] if head.startswith(b"\x89PNG") and head[25] else 0
    if av1 := _AV1.search(head):
        bits = 12 if av1[1][0] & 0x20 else 10 if av1[1][0] & 0x40 else 8
    if bits <= 8:
        return None
    import cv2  # a heavy import that few pictures need

    data = source if isinstance(source, bytes) else source.read_bytes()
    levels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if levels is None or levels.dtype != np.uint16:
        return None
    values = np.atleast_3d(levels).astype(np.float32) / np.float32(2**bits - 1)
    colors = values[..., 2::-1] * values[..., 3:] if values.shape[2] == 4 else values[..., 2::-1]
    return np.broadcast_to(colors, (*colors.shape[:2], 3))


def _upright(values: Float32, turn: int) -> Float32:
    """As Exif's orientation, less one, says: 4 to 7 are 0 to 3 with rows and columns exchanged before."""
    values = values.swapaxes(0, 1) if 4 <= turn < 8 else values
    return values[:: -1 if turn % 4 >= 2 else 1, :: -1 if turn % 4 in (1, 2) else 1] if 0 < turn < 8 else values


def _values(picture: Image.Image, *, layers: bool) -> Float32:
    """(H, W, 3) from 0 to 1; what should be the transparency of a BMP is often 0 everywhere: viewers leave it out."""
    if picture.mode.startswith("I;16") or picture.mode == "I":  # 16-bit grey
        gray = np.asarray(picture, dtype=np.float32) / np.float32(65535.0)
        return np.ascontiguousarray(np.repeat(np.clip(gray, 0.0, 1.0)[:, :, None], 3, axis=2))
    if layers and ("A" in picture.getbands() or "transparency" in picture.info):
        layered = picture.convert("RGBA")
        picture = Image.new("RGBA", layered.size, (0, 0, 0, 255))
        picture.alpha_composite(layered)
    levels = np.asarray(picture.convert("RGB"), dtype=np.float32)
    return np.ascontiguousarray(levels / np.float32(255.0))


def check_picture(picture: Image.Image, file: str) -> None:
    """FormatError where one picture of 8 or 16 bits, and of MAX_PICTURE_PIXELS at most, is not all that the file
    holds; by its headers."""
    if picture.width * picture.height > MAX_PICTURE_PIXELS:
        raise FormatError(f"{picture.width}x{picture.height} pixels, which is too large", file=file)
    frames = getattr(picture, "n_frames", 1)
    tags = getattr(picture, "tag_v2", {})
    if _DNG_VERSION in tags:
        raise FormatError(RAW_PHOTO, file=file)
    if tags.get(_PLANES) == _SEPARATE and max(tags.get(_BITS, (8,))) > 8:  # Pillow takes one plane for the whole
        raise FormatError("holds its channels of 16 bits one after another: save it as PNG", file=file)
    if frames > 1 and picture.format != "MPO":  # a phone's JPEG, with its depth or brightness as a second picture
        message = f"holds {frames} pictures (an animation, or pages): save those that show something, each as a PNG"
        raise FormatError(message, file=file)
    if picture.mode == "F" or (picture.mode == "I" and picture.format == "TIFF"):
        raise FormatError("holds numbers of 32 bits, of no agreed range: save it as PNG, as it is displayed", file=file)


def _in_srgb(picture: Image.Image) -> Image.Image:
    """The picture in sRGB, where it has a color profile (screenshots of a wide-gamut display, printers' CMYK) that can
    be used and makes a difference."""
    profile = picture.info["icc_profile"]
    keyed = "transparency" in picture.info
    plain = picture.convert("RGBA" if keyed else "RGB") if keyed or picture.mode == "P" else picture
    output = "RGBA" if plain.mode == "RGBA" else "RGB"
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        converted = ImageCms.profileToProfile(plain, source, _SRGB, outputMode=output)
    except (ImageCms.PyCMSError, OSError, ValueError):
        return picture
    if converted is None or np.asarray(ImageChops.difference(converted, plain.convert(output))).max() <= _ROUNDING:
        return picture  # sRGB itself, rounded once more, would lose the steps of a JPEG
    return converted
