"""The axes in which an SPZ file stores its scene, and the way from there to the axes of PLY."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError, InputError
from engine.model import Float32, Float64
from engine.numerics.spherical_harmonics import sh_basis

Frame = Literal["auto", "spec", "ply"]
"""What a reader takes the axes of a file for: what the file says (else the specification's), the
specification's, or those of PLY."""

COORDINATE_SYSTEM_EXTENSION = 0xADBE0003
"""SPZ_ADOBE_coordinate_system: one uint32, the number of a frame."""

_DIRECTIONS = {"L": (-1, 0, 0), "R": (1, 0, 0), "D": (0, 1, 0), "U": (0, -1, 0), "F": (0, 0, 1), "B": (0, 0, -1)}
_NAMES = "RUB LDB RDB LUB RUB LDF RDF LUF RUF LFD RFD LFU RFU LBD RBD LBU RBU"
"""Frames by number, as nianticlabs/spz numbers them: 4, RUB, is the specification's, 6, RDF, that of PLY; 0,
unspecified, falls back to RUB there too."""

_QUARTER_TURN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_IRRATIONAL_DIRECTION = np.array([0.3, 0.5, 0.8]) / np.sqrt(0.98)  # no basis function vanishes here


@dataclass(frozen=True)
class FrameChange:
    """p_ply = turn @ (signs * p_file): +-1 for each axis of the file (3,), then a quarter turn about x (3, 3), None
    where the signs are enough."""

    signs: Float64
    turn: Float64 | None = None

    def apply_signs(self, means: Float32, quats: Float32, sh: Float32) -> None:
        """Flip centres (N, 3), quaternions (N, 4) and coefficients (N, K, 3) in place; exact in float32."""
        if (self.signs == 1).all():
            return
        with np.errstate(invalid="ignore"):  # signalling NaN, which `clean` finds
            means *= self.signs.astype(np.float32)
            quats[:, 1:] *= self.quaternion_signs
        for k, sign in enumerate(self.coefficient_signs(sh.shape[1])):
            if sign < 0:
                np.negative(sh[:, k], out=sh[:, k])

    @property
    def quaternion_signs(self) -> Float32:
        """(3,) signs of x, y, z: M R(q) M has, for a diagonal M, the axis of q times M's cofactors."""
        return (np.prod(self.signs) * self.signs).astype(np.float32)

    def coefficient_signs(self, coefficients: int) -> Float32:
        """(K,) sign of each basis function under the flip: Y_k(signs * d) = sign_k Y_k(d)."""
        degree = round(coefficients**0.5) - 1
        d = _IRRATIONAL_DIRECTION
        flipped: npt.NDArray[Any] = sh_basis(d * self.signs, degree) * sh_basis(d, degree)
        return np.asarray(np.sign(flipped).astype(np.float32))


SPECIFICATION = FrameChange(np.array([1.0, -1.0, -1.0]))
"""RUB to RDF; its own inverse, so that the writer uses it as well."""


def frame_change(frame: str, extensions: bytes, *, file: str) -> FrameChange:
    """The change of axes that brings a file's scene to those of PLY, from a `Frame` and the file's extension records,
    back to back.

    InputError if there is no such frame; FormatError if the records do not fit into their bytes, or name a frame that
    does not exist.
    """
    if frame not in get_args(Frame):
        raise InputError(f"frame is {frame!r}, expected one of {', '.join(get_args(Frame))}")
    declared = _declared_frame(extensions, file=file)
    if frame == "spec" or (frame == "auto" and declared is None):
        return SPECIFICATION
    if frame == "ply" or declared is None:
        return FrameChange(np.ones(3))
    names = _NAMES.split()
    if declared >= len(names):
        message = f"declares frame {declared}, known are 0 to {len(names) - 1}; name the frame to use"
        raise FormatError(message, file=file, element="SPZ_ADOBE_coordinate_system")
    axes = [_DIRECTIONS[axis] for axis in names[declared]]
    to_ply = np.array(axes, dtype=np.float64).T  # its columns are the file's axes
    if (to_ply == np.diag(np.diag(to_ply))).all():
        return FrameChange(np.diag(to_ply).copy())
    return FrameChange(np.diag(_QUARTER_TURN.T @ to_ply).copy(), _QUARTER_TURN)


def other_extensions(extensions: bytes, *, file: str) -> list[str]:
    """Types of the extension records that say nothing of the axes."""
    return [f"{kind:#010x}" for kind, _ in _records(extensions, file) if kind != COORDINATE_SYSTEM_EXTENSION]


def _declared_frame(extensions: bytes, *, file: str) -> int | None:
    for kind, record in _records(extensions, file):
        if kind == COORDINATE_SYSTEM_EXTENSION:
            if len(record) != 4:
                raise FormatError(f"frame takes {len(record)} bytes, expected 4", file=file, element="extensions")
            return int.from_bytes(record, "little")
    return None


def _records(extensions: bytes, file: str) -> Iterator[tuple[int, bytes]]:
    """Type and content of each record."""
    position = 0
    while position < len(extensions):
        if position + 8 > len(extensions):
            raise FormatError("an extension record is cut off", file=file, element="extensions")
        kind, length = struct.unpack_from("<II", extensions, position)
        position += 8
        if length > len(extensions) - position:
            message = f"extension {kind:#010x} claims {length} bytes, {len(extensions) - position} are left"
            raise FormatError(message, file=file, element="extensions")
        yield kind, extensions[position : position + length]
        position += length
