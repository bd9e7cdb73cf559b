"""LZF, the compression inside binary_compressed PCD files (liblzf by Marc Lehmann: one page, no header)."""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError
from engine.kernels.jit import kernel

__all__ = ["GROWTH", "decompress"]


GROWTH = 88
"""The longest copy is 264 bytes out of 3: no stream can grow by more."""

_ENDS_EARLY, _BEFORE_START, _TOO_LONG = -1, -2, -3
_FAULTS = {
    _ENDS_EARLY: "ends in the middle of an instruction",
    _BEFORE_START: "copies from before its beginning",
    _TOO_LONG: "holds more than the header says",
}


def decompress(data: bytes | memoryview, size: int, *, file: str) -> npt.NDArray[np.uint8]:
    """Decompress to exactly `size` bytes.

    FormatError if the stream is broken or holds another number of bytes; one that cannot hold so many is refused before
    anything is allocated.
    """
    if size > GROWTH * len(data):
        raise FormatError(f"claims {size} bytes compressed to {len(data)}", file=file)
    out = np.empty(size, dtype=np.uint8)
    length = int(_decompress(np.frombuffer(data, dtype=np.uint8), out))
    if length < 0:
        raise FormatError(f"the compressed body {_FAULTS[length]}", file=file)
    if length != size:
        raise FormatError(f"the compressed body holds {length} bytes, expected {size}", file=file)
    return out


@kernel
def _decompress(data: Any, out: Any) -> int:
    """Length written to out, or a negative fault."""
    at, end = 0, 0
    while at < len(data):
        control = int(data[at])
        at += 1
        if control < 32:  # so many bytes, and one, as they are
            length = control + 1
            if at + length > len(data):
                return _ENDS_EARLY
            if end + length > len(out):
                return _TOO_LONG
            for k in range(length):
                out[end + k] = data[at + k]
            at += length
        else:  # bytes that were there before
            length = (control >> 5) + 2
            if length == 9:
                if at >= len(data):
                    return _ENDS_EARLY
                length += int(data[at])
                at += 1
            if at >= len(data):
                return _ENDS_EARLY
            source = end - (((control & 31) << 8) | int(data[at])) - 1
            at += 1
            if source < 0:
                return _BEFORE_START
            if end + length > len(out):
                return _TOO_LONG
            for k in range(length):  # byte by byte: source and target may overlap
                out[end + k] = out[source + k]
        end += length
    return end
