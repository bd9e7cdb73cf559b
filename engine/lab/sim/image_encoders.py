"""Attacks by software on the way: sizes there and back, WebP, AVIF, and video in which the picture is one frame.

A frame of a film is not coded by itself: most of it is predicted from its neighbors. So the picture is put in the
middle of a short film, a hand-held pan over the picture itself, and comes back as that frame. Image attacks as in
`engine.lab.sim.image_attacks`. Of ffmpeg only the command is used, through pipes; what it writes depends on its
version, so bytes are the same for the same installation (one thread, no time stamps).
"""

import io
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.sim.attack import Attacks
from engine.model import Float32

__all__ = ["ATTACKS", "bytes_of", "still", "values_of"]


ATTACKS: Attacks[Float32] = Attacks("image")

Uint8 = npt.NDArray[np.uint8]

MOST_PIXELS = 1 << 28
NEIGHBORS = 6  # frames before and after the picture in a film made of it
PAN = (1.7, 0.6)  # how far the pan goes from frame to frame, pixels right and down
FPS = 25.0

_SMALLER = (0.9, 0.75, 0.5, 0.35, 0.25)
_FACTORS = (2.0, 1.5, *_SMALLER)
_QUALITIES = (95, 90, 75, 50, 30, 20, 10)


@ATTACKS.add("to another size and back, nearest pixel", "factor on each side", 0.5, _SMALLER, "(0, inf)")
def resize_nearest(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    return _there_and_back(image, strength, "INTER_NEAREST_EXACT")


@ATTACKS.add("to another size and back, bilinear", "factor on each side", 0.5, _FACTORS, "(0, inf)")
def resize_bilinear(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    return _there_and_back(image, strength, "INTER_LINEAR")


@ATTACKS.add("to another size and back, area means", "factor on each side", 0.5, _SMALLER, "(0, inf)")
def resize_area(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    return _there_and_back(image, strength, "INTER_AREA")


@ATTACKS.add("to another size and back, Lanczos", "factor on each side", 0.5, _FACTORS, "(0, inf)")
def resize_lanczos(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """By Pillow's kernel, which widens when shrinking; OpenCV's do not."""
    return _there_and_back(image, strength, "LANCZOS")


@ATTACKS.add("lossy WebP", "quality", 50, _QUALITIES, "0..100")
def webp(image: Float32, strength: int, rng: np.random.Generator) -> Float32:
    return still(image, "WEBP", strength, method=4)


@ATTACKS.add("AVIF with 4:2:0 chroma", "quality", 50, _QUALITIES, "0..100")
def avif(image: Float32, strength: int, rng: np.random.Generator) -> Float32:
    from PIL import features

    if not features.check("avif"):
        raise InputError("this Pillow was built without AVIF")
    return still(image, "AVIF", strength, subsampling="4:2:0", speed=6, max_threads=1)


@ATTACKS.add(
    "one frame of an H.264 film (needs the ffmpeg command)",
    "constant rate factor",
    23,
    (17, 20, 23, 28, 33, 38, 43),
    "[0, 51]",
)
def h264(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """23 is x264's default."""
    return _film(image, f"-c:v libx264 -preset medium -crf {strength:g}")


@ATTACKS.add(
    "one frame of an H.265 film (needs the ffmpeg command)",
    "constant rate factor",
    28,
    (20, 24, 28, 33, 38, 43),
    "[0, 51]",
)
def h265(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """28 is x265's default."""
    return _film(image, f"-c:v libx265 -preset medium -crf {strength:g} -x265-params log-level=none:pools=1")


def bytes_of(image: Float32) -> Uint8:
    """The image in 8 bits, as encoders take it."""
    return np.asarray(np.round(np.clip(image, 0.0, 1.0) * 255.0), dtype=np.uint8)


def still(image: Float32, kind: str, quality: int, **options: Any) -> Float32:
    """A picture through a file of a format of Pillow's."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(bytes_of(image)).save(buffer, format=kind, quality=quality, **options)
    with Image.open(io.BytesIO(buffer.getvalue())) as decoded:
        return values_of(np.asarray(decoded.convert("RGB")))


def values_of(levels: npt.NDArray[Any]) -> Float32:
    """The image of 8 bits, 0..1."""
    return levels.astype(np.float32) / np.float32(255.0)


def _there_and_back(image: Float32, factor: float, kernel: str) -> Float32:
    height, width = image.shape[:2]
    rows, columns = max(1, round(height * factor)), max(1, round(width * factor))
    if rows * columns > MOST_PIXELS:
        raise InputError(f"resize factor {factor} makes {columns}x{rows} pixels; {MOST_PIXELS} at most")
    return _resized(_resized(image, rows, columns, kernel), height, width, kernel)


def _resized(image: Float32, height: int, width: int, kernel: str) -> Float32:
    if kernel == "LANCZOS":
        from PIL import Image

        planes = (Image.fromarray(plane) for plane in np.moveaxis(image, 2, 0))
        small = [np.asarray(plane.resize((width, height), Image.Resampling.LANCZOS)) for plane in planes]
        return np.stack(small, axis=-1)
    import cv2

    method = getattr(cv2, kernel)
    return np.asarray(cv2.resize(np.ascontiguousarray(image), (width, height), interpolation=method))


def _pan(image: Float32) -> list[Uint8]:
    """The film: the picture in the middle, at `NEIGHBORS`."""
    import cv2

    size = (image.shape[1], image.shape[0])
    frames = []
    for steps in range(-NEIGHBORS, NEIGHBORS + 1):
        matrix = np.array([[1.0, 0.0, steps * PAN[0]], [0.0, 1.0, steps * PAN[1]]])
        moved = cv2.warpAffine(image, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        frames.append(bytes_of(np.asarray(moved) if steps else image))
    return frames


def _padded(frame: Uint8) -> Uint8:
    """Even sides, as 4:2:0 needs."""
    return np.pad(frame, ((0, frame.shape[0] % 2), (0, frame.shape[1] % 2), (0, 0)), mode="edge")


def _film(image: Float32, encoder: str) -> Float32:
    """The picture as the middle frame of a film, through ffmpeg with an encoder and its settings."""
    frames = _pan(image)
    height, width = image.shape[:2]
    rows, columns = _padded(frames[0]).shape[:2]
    raw = b"".join(_padded(frame).tobytes() for frame in frames)
    with tempfile.TemporaryDirectory() as folder:  # MP4 needs a seekable file
        film = str(Path(folder) / "film.mp4")
        # One group of pictures: only the film's first frame stands by itself. The matrix of the bytes is named in the
        # file: players do not have to guess it from the size.
        _ffmpeg(
            f"-f rawvideo -pix_fmt rgb24 -s {columns}x{rows} -r {FPS:g} -i pipe:0"
            " -vf scale=out_color_matrix=bt709:out_range=tv"
            " -colorspace bt709 -color_primaries bt709 -color_trc bt709 -color_range tv"
            f" {encoder} -g {len(frames) + 1} -pix_fmt yuv420p -threads 1"
            " -fflags +bitexact -flags:v +bitexact -movflags +faststart -f mp4",
            film,
            given=raw,
        )
        decoded = _ffmpeg(
            "-nostdin -i",
            film,
            "-vf scale=in_color_matrix=bt709:in_range=tv -threads 1 -f rawvideo -pix_fmt rgb24 pipe:1",
        )
    found = np.frombuffer(decoded, dtype=np.uint8).reshape(-1, rows, columns, 3)
    return values_of(found[NEIGHBORS, :height, :width])


def _ffmpeg(options: str, file: str, more: str = "", given: bytes = b"") -> bytes:
    """What ffmpeg writes to its output; InputError where it is not here or refuses."""
    command = shutil.which("ffmpeg")
    if command is None:
        raise InputError("this needs the ffmpeg command, and ffmpeg is not here: install it, or do without video")
    arguments = [command, *["-hide_banner", "-loglevel", "error", "-y"], *options.split(), file, *more.split()]
    done = subprocess.run(arguments, input=given, capture_output=True, check=False)
    if done.returncode != 0:
        reason = done.stderr.decode(errors="replace").strip().splitlines()
        raise InputError(f"ffmpeg failed: {reason[-1] if reason else f'exit code {done.returncode}'}")
    return done.stdout
