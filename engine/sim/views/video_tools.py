"""The ffmpeg command as two functions: frames to encoded bytes, encoded bytes to frames.

Only the command is used, through pipes; what it writes depends on its version, so bytes are the same for the same
installation (one thread, no time stamps).
"""

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from engine.errors import InputError

__all__ = ["decode_video", "encode_video", "ffmpeg_command"]

Uint8 = npt.NDArray[np.uint8]


def ffmpeg_command() -> str:
    """Path of the ffmpeg command; InputError where there is none."""
    found = shutil.which("ffmpeg")
    if found is None:
        raise InputError("this needs the ffmpeg command, and ffmpeg is not here: install it, or do without video")
    return found


def encode_video(frames: Sequence[Uint8], fps: float, options: Sequence[str]) -> bytes:
    """Frames as an MP4 file with 4:2:0 chroma.

    Parameters
    ----------
    frames : sequence of (H, W, 3) uint8
        At least one, all of one size; an odd side grows by one pixel, as 4:2:0 needs.
    fps : float
        Frames a second.
    options : sequence of str
        The encoder and its settings, e.g. ("-c:v", "libx264", "-crf", "23").

    Raises
    ------
    InputError
        If ffmpeg is not here or refuses.
    """
    height, width = frames[0].shape[:2]
    pad = (height % 2, width % 2)
    raw = b"".join(np.pad(f, ((0, pad[0]), (0, pad[1]), (0, 0)), mode="edge").tobytes() for f in frames)
    with tempfile.TemporaryDirectory() as folder:  # MP4 wants a file it can seek in
        out = Path(folder) / "film.mp4"
        _run(
            [
                "-f",
                "rawvideo",
                "-pix_fmt",
                "rgb24",
                "-s",
                f"{width + pad[1]}x{height + pad[0]}",
                "-r",
                f"{fps:g}",
                "-i",
                "pipe:0",
                # The matrix of the bytes is named in the file: players do not have to guess it from the size.
                "-vf",
                "scale=out_color_matrix=bt709:out_range=tv",
                "-colorspace",
                "bt709",
                "-color_primaries",
                "bt709",
                "-color_trc",
                "bt709",
                "-color_range",
                "tv",
                *options,
                "-pix_fmt",
                "yuv420p",
                "-threads",
                "1",
                "-fflags",
                "+bitexact",
                "-flags:v",
                "+bitexact",
                "-movflags",
                "+faststart",
                "-f",
                "mp4",
                str(out),
            ],
            raw,
        )
        return out.read_bytes()


def decode_video(data: bytes, height: int, width: int) -> list[Uint8]:
    """All frames of a film, cut to the size its frames had before `encode_video`.

    Parameters
    ----------
    height, width : int
        Pixels.

    Returns
    -------
    list of (height, width, 3) uint8

    Raises
    ------
    InputError
        If ffmpeg is not here or refuses.
    """
    rows, columns = height + height % 2, width + width % 2
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "film.mp4"
        source.write_bytes(data)
        raw = _run(
            [
                "-i",
                str(source),
                "-vf",
                "scale=in_color_matrix=bt709:in_range=tv",
                "-threads",
                "1",
                "-f",
                "rawvideo",
                "-pix_fmt",
                "rgb24",
                "pipe:1",
            ],
            b"",
        )
    frames = np.frombuffer(raw, dtype=np.uint8).reshape(-1, rows, columns, 3)
    return [np.ascontiguousarray(frame[:height, :width]) for frame in frames]


def _run(arguments: list[str], given: bytes) -> bytes:
    command = [ffmpeg_command(), "-hide_banner", "-loglevel", "error", "-nostdin", "-y", *arguments]
    if given:
        command.remove("-nostdin")
    done = subprocess.run(command, input=given, capture_output=True, check=False)
    if done.returncode != 0:
        reason = done.stderr.decode(errors="replace").strip().splitlines()
        raise InputError(f"ffmpeg failed: {reason[-1] if reason else f'exit code {done.returncode}'}")
    return done.stdout
