"""Files that a request names, read; what is wrong with them is said without saying where they lie."""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from PIL import ExifTags, Image

from engine.errors import CameraError, FormatError, InputError
from engine.formats import read_cameras
from engine.formats.image_files import MAX_PICTURE_PIXELS, MAX_PIXELS_TOGETHER, check_picture, is_picture, read_picture
from engine.model import Camera, Float32
from engine.scenes.scene_files import Loaded, read_suspect
from service.problems import Problem
from service.work.process import Request, name_of

MOST_PICTURES = 64


def load_model(request: Request) -> Loaded:
    """The model of a request, which may be colored points; it holds at least one Gaussian."""
    loaded = read_suspect(request["model"], name=name_of(request), spz_frame=request.get("spz_frame") or "auto")
    check_model(loaded)
    return loaded


def check_model(loaded: Loaded) -> None:
    """Refuse a model without Gaussians."""
    if len(loaded.model) == 0:
        raise Problem("unreadable-model", "the model holds no Gaussians")


def picture_sizes(paths: Sequence[str]) -> list[tuple[int, int]]:
    """Width and height of 1 to MOST_PICTURES pictures, as their headers say; "unreadable-image", which names the
    picture by its number, where one is none, or they are too large to be read together."""
    if not 1 <= len(paths) <= MOST_PICTURES:
        raise Problem("invalid-request", f"1 to {MOST_PICTURES} pictures go together, got {len(paths)}")
    with warnings.catch_warnings(action="ignore"):  # Pillow's, of damage that it reads around
        sizes = [_size(Path(path), number) for number, path in enumerate(paths, start=1)]
    together = sum(width * height for width, height in sizes)
    if together > MAX_PIXELS_TOGETHER:
        text = f"the pictures have {together:,} pixels together, more than {MAX_PIXELS_TOGETHER:,}"
        raise Problem("unreadable-image", text)
    return sizes


def load_pictures(paths: Sequence[str]) -> list[Float32]:
    """Pictures, each (H, W, 3) float32; errors as `picture_sizes`."""
    picture_sizes(paths)
    return [_read(Path(path), number) for number, path in enumerate(paths, start=1)]


def load_cameras(path: str | None, *, count: int | None = None) -> list[Camera] | None:
    """The cameras of a request, if it names any; where there are `count` pictures, one for each."""
    if path is None:
        return None
    try:
        cameras = read_cameras(path)
    except (CameraError, InputError) as error:
        raise Problem("unreadable-cameras", str(error).replace(path, "the cameras")) from None
    if count is not None and len(cameras) != count:
        raise Problem("unreadable-cameras", f"{count} pictures, but {len(cameras)} cameras")
    if count is not None and max(c.width * c.height for c in cameras) > MAX_PICTURE_PIXELS:
        raise Problem("unreadable-cameras", f"a camera has more than {MAX_PICTURE_PIXELS:,} pixels")
    return cameras


def _size(path: Path, number: int) -> tuple[int, int]:
    with _told_by_number(path, number):
        if not is_picture(path):
            raise Problem("unreadable-image", f"picture {number}: is no PNG, JPEG, WebP, AVIF, BMP, GIF or TIFF")
        with Image.open(path) as picture:
            check_picture(picture, str(path))
            exif = picture.getexif() if "exif" in picture.info else {}  # of a PNG without, all would be decoded
            lies = exif.get(ExifTags.Base.Orientation) in (5, 6, 7, 8)
            return picture.size[::-1] if lies else picture.size


def _read(path: Path, number: int) -> Float32:
    with _told_by_number(path, number):
        return read_picture(path)


@contextmanager
def _told_by_number(path: Path, number: int) -> Iterator[None]:
    """Pillow's parsers raise whatever hostile bytes make them raise."""
    try:
        yield
    except (MemoryError, Problem):
        raise
    except FormatError as error:
        text = error.message.replace(str(path), "it")
        raise Problem("unreadable-image", f"picture {number}: {text}") from None
    except Image.DecompressionBombError:
        raise Problem("unreadable-image", f"picture {number}: has too many pixels") from None
    except Exception as error:
        raise Problem("unreadable-image", f"picture {number}: cannot be read ({type(error).__name__})") from None
