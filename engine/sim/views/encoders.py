"""Attacks by lossy encoders: WebP, AVIF, and video in which the picture is one frame. Image attacks.

A frame of a film is not coded by itself: most of it is predicted from its neighbours. So the picture is put in the
middle of a short film, by default of a hand-held pan over the picture itself, and comes back as that frame.
"""

import io
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Float32
from engine.sim.attack import check_positive
from engine.sim.views.checks import bytes_of, check_image, finished
from engine.sim.views.video_tools import decode_video, encode_video

__all__ = ["avif", "h264", "h265", "mpeg4", "webp"]

NEIGHBORS = 6
"""Frames before and after the picture in a film made of it."""
PAN = (1.7, 0.6)
"""How far the pan goes from frame to frame, pixels right and down."""
FPS = 25.0
MOST_GENERATIONS = 20

Film = tuple[Sequence[Float32], Sequence[Float32]]
"""Frames before the picture, and after it."""


def webp(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """Lossy WebP at quality `strength` and back."""
    return _still(image, "WEBP", _quality(strength, "WebP", 0), method=4)


def avif(image: Float32, strength: float, rng: np.random.Generator) -> Float32:
    """AVIF with 4:2:0 chroma at quality `strength` and back; InputError where Pillow has no AVIF."""
    from PIL import features

    if not features.check("avif"):
        raise InputError("this Pillow was built without AVIF")
    quality = _quality(strength, "AVIF", 0)
    return _still(image, "AVIF", quality, subsampling="4:2:0", speed=6, max_threads=1)


def h264(image: Float32, strength: float, rng: np.random.Generator, *, neighbors: Film | None = None) -> Float32:
    """One frame of an H.264 film at constant rate factor `strength`, by the ffmpeg command.

    Parameters
    ----------
    image : (H, W, 3) float32
    strength : float
        CRF, 0..51; 23 is x264's default.
    rng : numpy.random.Generator
        Not used.
    neighbors : pair of sequences of (H, W, 3) float32, optional
        Frames before and after the picture; a pan over the picture itself where not given.

    Returns
    -------
    (H, W, 3) float32

    Raises
    ------
    InputError
        If ffmpeg is not here, the strength is out of its range, or a frame has another size.
    """
    options = ("-c:v", "libx264", "-preset", "medium", "-crf", f"{_rate_factor(strength):g}")
    return _film(image, neighbors, options)


def h265(image: Float32, strength: float, rng: np.random.Generator, *, neighbors: Film | None = None) -> Float32:
    """One frame of an H.265 film at constant rate factor `strength` (28 is x265's default); else as `h264`."""
    crf = f"{_rate_factor(strength):g}"
    options = ("-c:v", "libx265", "-preset", "medium", "-crf", crf, "-x265-params", "log-level=none:pools=1")
    return _film(image, neighbors, options)


def mpeg4(image: Float32, strength: float, rng: np.random.Generator, *, neighbors: Film | None = None) -> Float32:
    """One frame of an MPEG-4 film after `strength` generations, by OpenCV's own writer at its own bit rate.

    For machines without the ffmpeg command: OpenCV's wheels bring an encoder along.
    """
    check_image(image)
    if not (1 <= strength <= MOST_GENERATIONS and float(strength).is_integer()):
        raise InputError(f"generations must be a whole number from 1 to {MOST_GENERATIONS}, got {strength}")
    frames, place = _frames(image, neighbors)
    for _ in range(int(strength)):
        frames = _rewritten(frames)
    return _whole(frames[place])


def _still(image: Float32, kind: str, quality: int, **options: Any) -> Float32:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(bytes_of(image)).save(buffer, format=kind, quality=quality, **options)
    with Image.open(io.BytesIO(buffer.getvalue())) as decoded:
        return _whole(np.asarray(decoded.convert("RGB")))


def _film(image: Float32, neighbors: Film | None, options: Sequence[str]) -> Float32:
    frames, place = _frames(image, neighbors)
    # One group of pictures: only the film's first frame stands by itself.
    data = encode_video(frames, FPS, (*options, "-g", str(len(frames) + 1)))
    return _whole(decode_video(data, *image.shape[:2])[place])


def _frames(image: Float32, neighbors: Film | None) -> tuple[list[npt.NDArray[np.uint8]], int]:
    """The film in 8 bits and the picture's place in it."""
    check_image(image)
    before, after = neighbors if neighbors is not None else _pan(image)
    frames = [bytes_of(np.asarray(frame, dtype=np.float32)) for frame in (*before, image, *after)]
    for frame in frames:
        if frame.shape != image.shape:
            raise InputError(f"the frames of a film must have one size: {frame.shape} beside {image.shape}")
    return frames, len(before)


def _pan(image: Float32) -> Film:
    import cv2

    def shifted(steps: int) -> Float32:
        matrix = np.array([[1.0, 0.0, steps * PAN[0]], [0.0, 1.0, steps * PAN[1]]])
        size = (image.shape[1], image.shape[0])
        moved = cv2.warpAffine(image, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        return np.asarray(moved)

    steps = range(1, NEIGHBORS + 1)
    return [shifted(-k) for k in reversed(steps)], [shifted(k) for k in steps]


def _rewritten(frames: list[npt.NDArray[np.uint8]]) -> list[npt.NDArray[np.uint8]]:
    """The frames through an MPEG-4 file written and read by OpenCV."""
    import cv2

    height, width = frames[0].shape[:2]
    pad = ((0, height % 2), (0, width % 2), (0, 0))
    with tempfile.TemporaryDirectory() as folder:
        name = str(Path(folder) / "film.mp4")
        size = (width + pad[1][1], height + pad[0][1])
        writer = cv2.VideoWriter(name, cv2.VideoWriter.fourcc(*"mp4v"), FPS, size)
        if not writer.isOpened():
            raise InputError("this OpenCV was built without an MPEG-4 encoder")
        for frame in frames:
            writer.write(np.ascontiguousarray(np.pad(frame, pad, mode="edge")[..., ::-1]))
        writer.release()
        reader = cv2.VideoCapture(name)
        decoded = []
        while True:
            ok, frame = reader.read()
            if not ok:
                break
            decoded.append(np.ascontiguousarray(frame[:height, :width, ::-1]))
        reader.release()
    if len(decoded) != len(frames):
        raise InputError(f"OpenCV wrote {len(frames)} frames and read {len(decoded)} back")
    return decoded


def _whole(levels: npt.NDArray[Any]) -> Float32:
    return finished(levels.astype(np.float32) / np.float32(255.0))


def _quality(strength: float, what: str, least: int) -> int:
    if not (least <= strength <= 100 and float(strength).is_integer()):
        raise InputError(f"{what} quality must be a whole number from {least} to 100, got {strength}")
    return int(strength)


def _rate_factor(strength: float) -> float:
    crf = check_positive(strength, "rate factor", zero=True)
    if crf > 51:
        raise InputError(f"rate factor must lie in 0..51, got {strength}")
    return crf
