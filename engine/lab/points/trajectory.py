"""Where a sensor was: trajectories as text, of the TUM benchmark and of KITTI odometry."""

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from engine.errors import FormatError, InputError
from engine.formats.cameras.files import read_limited
from engine.formats.repairs import MAGNITUDE_LIMIT
from engine.model import Float64

_TUM, _KITTI = 8, 12
_TOLERANCE = 1e-2
"""How far a written rotation may be from a true one: KITTI's own files keep six digits, odometry keeps three."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of a sensor in the world: x_world = R x_sensor + t. InputError if the arrays do not fit together."""

    positions: Float64  # (P, 3) scene units, finite; P >= 1
    quats: Float64  # (P, 4) unit quaternions w, x, y, z
    times: Float64 | None = None  # (P,) seconds, strictly increasing; None where the file knows only an order (KITTI)

    def __post_init__(self) -> None:
        n = len(self.positions)
        if n == 0 or self.positions.shape != (n, 3) or self.quats.shape != (n, 4):
            shapes = f"{self.positions.shape} and {self.quats.shape}"
            raise InputError(f"positions and quats have shapes {shapes}, expected (P, 3) and (P, 4)")
        if self.times is not None and (self.times.shape != (n,) or (np.diff(self.times) <= 0).any()):
            raise InputError(f"times must be {n} increasing numbers")

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def matrices(self) -> Float64:
        """(P, 4, 4) sensor to world."""
        from engine.numerics.similarity import quaternion_to_rotation

        result = np.zeros((len(self), 4, 4))
        result[:, :3, :3] = quaternion_to_rotation(self.quats)
        result[:, :3, 3] = self.positions
        result[:, 3, 3] = 1.0
        return result


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a trajectory from text, a pose a line; lines that start with ``#`` are comments.

    Eight numbers (TUM): time, position x y z, quaternion x y z w. Twelve (KITTI): the upper three rows of the matrix
    from sensor to world, row by row. FormatError, naming file and row, if a line is no pose, times do not increase, or
    a rotation is none; InputError if there is no such file.
    """
    try:
        data = read_limited(Path(path))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from None
    return parse_trajectory(data, file=str(path))


def parse_trajectory(data: bytes, *, file: str) -> Trajectory:
    """A trajectory from the bytes of a file; see `read_trajectory`."""
    rows: list[list[float]] = []
    for line in data.decode("utf-8", "replace").splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        row = len(rows)
        expected = len(rows[0]) if rows else len(words)
        if len(words) != expected or expected not in (_TUM, _KITTI):
            wanted = f"{expected}" if rows else f"{_TUM} (TUM) or {_KITTI} (KITTI)"
            raise FormatError(f"the line holds {len(words)} values, expected {wanted}", file=file, row=row)
        rows.append([_number(word, file, row) for word in words])
    if not rows:
        raise FormatError("holds no poses", file=file)
    table = np.array(rows)
    return _tum(table, file) if table.shape[1] == _TUM else _kitti(table, file)


def _number(word: str, file: str, row: int) -> float:
    try:
        value = float(word)
    except ValueError:
        raise FormatError(f"{word[:40]!a} is no number", file=file, row=row) from None
    if not (math.isfinite(value) and abs(value) <= MAGNITUDE_LIMIT):
        raise FormatError(f"{word[:40]!a} is no finite number of a pose", file=file, row=row)
    return value


def _tum(table: Float64, file: str) -> Trajectory:
    times = table[:, 0].copy()
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if len(late):
        row = int(late[0]) + 1
        raise FormatError(f"time {times[row]} does not follow {times[row - 1]}", file=file, row=row)
    quats = np.roll(table[:, 4:], 1, axis=1)
    norms = np.linalg.norm(quats, axis=1)
    bad = np.flatnonzero(np.abs(norms - 1.0) > _TOLERANCE)
    if len(bad):
        raise FormatError(f"the quaternion has length {norms[bad[0]]:.4g}, not 1", file=file, row=int(bad[0]))
    return Trajectory(np.ascontiguousarray(table[:, 1:4]), quats / norms[:, None], times)


def _kitti(table: Float64, file: str) -> Trajectory:
    from engine.numerics.similarity import rotation_to_quaternion

    matrices = table.reshape(-1, 3, 4)  # (P, 3, 4)
    rotations = matrices[:, :, :3]
    fault = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero(~((fault <= _TOLERANCE) & (np.linalg.det(rotations) > 0.0)))
    if len(bad):
        raise FormatError(f"the matrix is no rotation (off by {fault[bad[0]]:.4g})", file=file, row=int(bad[0]))
    u, _, vt = np.linalg.svd(rotations)  # the nearest rotations
    return Trajectory(np.ascontiguousarray(matrices[:, :, 3]), rotation_to_quaternion(u @ vt))
