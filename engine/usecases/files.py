"""Files as requests see them: outputs that appear whole or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from engine.errors import InputError

if TYPE_CHECKING:
    from engine.model import Float32

JPEG_QUALITY = 95

PICTURE_ENDINGS = (".png", ".jpg", ".jpeg", ".webp")

_KEPT_NAME = 40
"""Characters of a target's name in its part's: a name of 255 bytes has room for no more than itself."""


@contextmanager
def whole_file(target: Path, *, overwrite: bool = True) -> Iterator[Path]:
    """A path to write to in the target's folder; it becomes the target when the block ends without an error.

    InputError if the folder does not exist, or the target does and is not to be overwritten.
    """
    check_target(target, overwrite=overwrite)
    part = _part_of(target)
    try:
        yield part
        if overwrite:
            os.replace(part, target)
        else:
            _publish(part, target)
    finally:
        with suppress(FileNotFoundError):
            part.unlink()


FOLDERS = ("codebook", "frames")
"""Formats of which a model is a folder."""


def format_for(path: Path, source: Path | None = None) -> str:
    """Format that the ending of an output file names; where the source is a folder of frames or codebooks, that."""
    if source is not None and source.is_dir():
        from engine.scenes.scene_files import folder_kind

        if (kind := folder_kind(source)) is not None:
            return kind
    from engine.formats.known_formats import kind_of

    return kind_of(path.name).name


def check_output(target: Path, kind: str) -> None:
    """Refuse a model to write that cannot be written, before any work is done for it."""
    (check_folder if kind in FOLDERS else check_target)(target)


def whole_output(target: Path, kind: str) -> AbstractContextManager[Path]:
    """A file, or a folder, to write to next to the target; see `whole_file`."""
    return (whole_folder if kind in FOLDERS else whole_file)(target)


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """A folder to fill next to the target; it becomes the target when the block ends without an error.

    InputError as `check_folder`.
    """
    check_folder(target)
    part = _part_of(target)
    part.mkdir()
    try:
        yield part
        os.replace(part, target)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _part_of(target: Path) -> Path:
    return target.with_name(f".{target.name[:_KEPT_NAME]}.{secrets.token_hex(6)}.part")


def _check_parent(target: Path) -> None:
    folder = target.parent
    if not folder.is_dir():
        raise InputError(f"cannot write {str(target)!r}: there is no folder {str(folder)!r}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"cannot write {str(target)!r}: this user may not write in the folder {str(folder)!r}")


def check_folder(target: Path) -> None:
    """Refuse a folder to write that cannot be made, or that has something in it."""
    if not target.name:
        raise InputError(f"{str(target)!r} is no name of a folder")
    _check_parent(target)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(f"{str(target)!r} exists: give the name of a new folder")


def _publish(part: Path, target: Path) -> None:
    try:
        os.link(part, target)  # unlike a rename, fails where the target has appeared meanwhile
    except FileExistsError:
        raise _exists(target) from None
    except OSError:  # a file system without hard links
        check_target(target, overwrite=False)
        os.replace(part, target)


def check_target(target: Path, *, overwrite: bool = True) -> None:
    """Refuse a target that cannot be written, before any work is done for it."""
    if not target.name:
        raise InputError(f"{str(target)!r} is no file name")
    _check_parent(target)
    if target.is_dir():
        raise InputError(f"cannot write {str(target)!r}: it is a folder")
    if target.exists() and not target.is_file():
        raise InputError(f"cannot write {str(target)!r}: it is a device or a pipe")
    if not overwrite and target.exists():
        raise _exists(target)


def _exists(target: Path) -> InputError:
    return InputError(f"{str(target)!r} exists; a record is irreplaceable, so give another name or --force")


def refuse_same(source: Path, target: Path) -> None:
    """Refuse to write over the input."""
    if source.exists() and target.exists() and source.samefile(target):
        raise InputError(f"{str(target)!r} is the input itself; give the result another name")


def write_secret(path: Path, data: bytes) -> None:
    """Write a new file that only its owner can read (mode 0600)."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def read_bytes(path: Path, what: str) -> bytes:
    """Content of a file; InputError naming what was expected there."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {what} {str(path)!r}: {error.strerror}") from error


def write_picture(image: Float32, path: Path, target: Path, quality: int = JPEG_QUALITY) -> None:
    """Store a picture at `path`, in the format that the ending of `target` names.

    The image (H, W, 3) is clipped to 0..1 and stored with 8 bits; `quality` is a JPEG's, other formats lose nothing.
    """
    import numpy as np
    from PIL import Image

    check_picture_ending(target)
    levels = np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
    kind = {".jpg": "JPEG", ".jpeg": "JPEG", ".png": "PNG", ".webp": "WEBP"}[target.suffix.lower()]
    choices: dict[str, dict[str, int]] = {"JPEG": {"quality": quality}, "WEBP": {"lossless": True}}
    Image.fromarray(levels).save(path, format=kind, **choices.get(kind, {}))


def check_picture_ending(target: Path) -> None:
    """Refuse an ending that names no picture format."""
    if target.suffix.lower() not in PICTURE_ENDINGS:
        raise InputError(f"{str(target)!r} must end in one of {', '.join(PICTURE_ENDINGS)}")
