"""Picture files: known by their first bytes, read as floats."""

import io
import re
import warnings
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import ExifTags, Image, ImageChops, ImageCms, ImageFile, UnidentifiedImageError

from engine.errors import FormatError
from engine.formats.color_coding import coding_of
from engine.formats.guards import opening
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
_ROWS_AT_ONCE = 256
_AV1 = re.compile(rb"av1C\x81.(.)", re.DOTALL)  # AVIF's bits a channel: AV1-ISOBMFF, 2.3.3

_MAGICS = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"BM", b"GIF8", b"II*\0", b"MM\0*")


def is_picture(path: Path, name: str = "") -> bool:
    """Whether a file starts like a PNG, JPEG, BMP, GIF, TIFF, WebP or AVIF, whatever its name (`name`, or its path's
    own) says: except for a .splat that is one by its rows, since its first number may be any bytes."""
    if path.is_dir():
        return False
    with opening(path, name or str(path)):
        with path.open("rb") as file:
            head = file.read(64)
        webp = head[:4] == b"RIFF" and head[8:12] == b"WEBP"
        avif = head[4:8] == b"ftyp" and re.search(rb"avi[fs]", head[8 : int.from_bytes(head[:4])]) is not None
        named = (name or path.name).lower().endswith(".splat")
        return (webp or avif or head.startswith(_MAGICS)) and not (named and looks_like_splat(path.read_bytes()))


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
            if deep := _deep(head, picture, source):
                values = _deep_in_srgb(deep[0], picture.info["icc_profile"]) if profiled else deep[0]
                values = np.broadcast_to(values if deep[1] is None else values * deep[1], (*values.shape[:2], 3))
            else:
                values = _values(_in_srgb(picture) if profiled else picture, layers=picture.format != "BMP")
    except FormatError:
        raise
    except Image.DecompressionBombError as error:
        raise FormatError("picture has too many pixels", file=file) from error
    except Exception as error:  # decoders raise whatever they stumble over
        if isinstance(error, UnidentifiedImageError):
            is_raw = file.lower().endswith(RAW_ENDINGS)
            unknown = "no readable picture (damaged, or of a kind that is not read): save it as PNG"
            raise FormatError(RAW_PHOTO if is_raw else unknown, file=file) from error
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


def _deep(head: bytes, picture: Image.Image, source: Path | bytes) -> tuple[Float32, Float32 | None] | None:
    """Colors (H, W, 1 or 3) and opacities (H, W, 1), from 0 to 1, of a picture of more than 8 bits, which are all that
    Pillow keeps of colors; None of any other picture."""
    if (bits := _bits(head, picture)) <= 8:
        return None
    gray = picture.mode.startswith("I")
    found = np.clip(np.asarray(picture), 0, 65535)[..., None] if gray else _decoded(picture, source)
    if found is None:
        return None
    values = found.astype(np.float32) / np.float32(2**bits - 1)
    key = picture.info.get("transparency")
    if values.shape[2] < 4 and key is not None:
        return values, (found != key).any(axis=2, keepdims=True).astype(np.float32)
    return values[..., :3], values[..., 3:] if values.shape[2] == 4 else None


def _bits(head: bytes, picture: Image.Image) -> int:
    """Of a channel."""
    if picture.mode.startswith("I"):
        return 16
    if av1 := _AV1.search(head):
        return 12 if av1[1][0] & 0x20 else 10 if av1[1][0] & 0x40 else 8
    return head[24] if head.startswith(_MAGICS[0]) else max(getattr(picture, "tag_v2", {}).get(_BITS, (8,)))


def _decoded(picture: Image.Image, source: Path | bytes) -> npt.NDArray[np.uint16] | None:
    """(H, W, 1, 3 or 4) levels by OpenCV; None where it reads other ones than Pillow."""
    import cv2  # a heavy import that few pictures need

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)  # unknown tags are none
    data = source if isinstance(source, bytes) else source.read_bytes()
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if found is None or found.dtype != np.uint16:
        return None
    levels = np.atleast_3d(found)[..., [2, 1, 0, 3][: 1 if found.ndim < 3 else found.shape[2]]]
    if picture.format == "TIFF":
        width = 4 if "A" in picture.getbands() else 3
        levels, shallow = levels[..., :width], np.asarray(picture)[..., :width]
        if levels.shape != shallow.shape or np.abs((levels >> 8).astype(np.int16) - shallow).max() > 1:
            return None
    return np.asarray(levels)


def _deep_in_srgb(colors: Float32, profile: bytes) -> Float32:
    """Colors (H, W, 1 or 3) in sRGB, interpolated between those of the levels of 8 bits around, which Pillow converts;
    as they are where that makes no difference."""
    channels, converted = colors.shape[2], np.empty((*colors.shape[:2], 3), np.float32)
    for top in range(0, len(colors), _ROWS_AT_ONCE):
        block = colors[top : top + _ROWS_AT_ONCE] * 255
        below = np.minimum(block, 254).astype(np.uint8)
        shown = []
        for step in (np.zeros(channels, np.uint8), *np.eye(channels, dtype=np.uint8)):
            image = Image.fromarray((below + step).reshape(below.shape[: 2 + (channels > 1)]))
            if (seen := _converted(image, profile, "RGB")) is None:
                return colors
            shown.append(np.asarray(seen, np.float32))
        parts = ((block - below)[..., [c]] * (shown[1 + c] - shown[0]) for c in range(channels))
        converted[top : top + _ROWS_AT_ONCE] = sum(parts, shown[0])
    converted /= 255
    return converted if np.abs(converted - colors).max() * 255 > _ROUNDING else colors


def _upright(values: Float32, turn: int) -> Float32:
    """As Exif's orientation, less one, says: 4 to 7 are 0 to 3 with rows and columns exchanged before."""
    values = values.swapaxes(0, 1) if 4 <= turn < 8 else values
    return values[:: -1 if turn % 4 >= 2 else 1, :: -1 if turn % 4 in (1, 2) else 1] if 0 < turn < 8 else values


def _values(picture: Image.Image, *, layers: bool) -> Float32:
    """(H, W, 3) from 0 to 1; what should be the transparency of a BMP is often 0 everywhere: viewers leave it out."""
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
    keyed = "transparency" in picture.info
    plain = picture.convert("RGBA" if keyed else "RGB") if keyed or picture.mode == "P" else picture
    output = "RGBA" if plain.mode == "RGBA" else "RGB"
    converted = _converted(plain, picture.info["icc_profile"], output)
    if converted is None or np.asarray(ImageChops.difference(converted, plain.convert(output))).max() <= _ROUNDING:
        return picture  # sRGB itself, rounded once more, would lose the steps of a JPEG
    return converted


def _converted(picture: Image.Image, profile: bytes, output: str) -> Image.Image | None:
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        return ImageCms.profileToProfile(picture, source, _SRGB, outputMode=output)
    except (ImageCms.PyCMSError, OSError, ValueError):
        return None
