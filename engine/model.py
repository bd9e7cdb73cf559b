"""The two types that everything uses: a Gaussian model and a camera. See docs/CONVENTIONS.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import CameraError, InputError

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]

SH_C0 = 0.28209479177387814
"""Y_00: a DC coefficient c shows as colour 0.5 + SH_C0 * c."""


DISC_THICKNESS = 1e-6
"""A 2DGS disc has two scales; its third becomes this times the smaller of them. Any similarity of the scene
keeps the ratio, and its square, 1e-12, is far below what float32 resolves in a covariance matrix."""

ATTRIBUTES = ("means", "log_scales", "quats", "opacity_logits", "sh")
"""Names of a model's arrays, a row a Gaussian."""

_FLAT = 1e-5  # third over smaller scale of a disc: ten times the above, so that rounding and noise keep a disc one
_FLAT_SHARE = 0.99  # of a model's rows, so that a few absurd ones do not change how the others are drawn


@dataclass(frozen=True, eq=False)
class FileRows:
    """Which rows of a file its Gaussians are, where some rows were of no use."""

    rows: Int64  # (N,)
    count: int  # of rows in the file

    def spread(self, values: npt.NDArray[Any], missing: int) -> npt.NDArray[Any]:
        """(count, ...) values (N, ...) of the Gaussians at their rows in the file, `missing` at all others."""
        whole = np.full((self.count, *values.shape[1:]), missing, values.dtype)
        whole[self.rows] = values
        return whole


@dataclass(frozen=True, eq=False)
class Carried:
    """What a PLY holds besides its Gaussians, and gets back: nothing here looks at it."""

    columns: npt.NDArray[np.void]  # (N,) a record a Gaussian, of properties under their names
    comments: tuple[str, ...] = ()  # one character a byte, whatever the encoding

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the properties, in the order of the file."""
        return self.columns.dtype.names or ()


@dataclass(frozen=True, eq=False)
class GaussianModel:
    """N Gaussians as INRIA stores them (raw activations), one C-contiguous float32 array per attribute."""

    means: Float32  # (N, 3) centres, scene units
    # (N, 3) natural logarithm of the standard deviations, scene units. A 2DGS disc has a third scale of
    # `DISC_THICKNESS` times the smaller of the others.
    log_scales: Float32
    quats: Float32  # (N, 4) rotation as unit quaternion w, x, y, z
    opacity_logits: Float32  # (N,) logit of the opacity; finite
    sh: Float32  # (N, K, 3) spherical-harmonic colour, coefficient-major, DC first, K = (degree + 1)^2 in {1, 4, 9, 16}
    # Trained to be drawn with an opacity that falls as the low pass widens a Gaussian (`RasterSettings.antialiased`);
    # files say "mip" or "antialiased". Discs never are.
    antialiased: bool = False
    # What was taken from the centers on reading, scene units: what float32 cannot hold, of scenes in map coordinates
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    file_rows: FileRows | None = None  # None: each Gaussian is the row of its own number
    carried: Carried | None = None

    def __post_init__(self) -> None:
        n = len(self.means)
        shapes = {
            "means": (n, 3),
            "log_scales": (n, 3),
            "quats": (n, 4),
            "opacity_logits": (n,),
            "sh": (n, self.sh.shape[1] if self.sh.ndim == 3 else -1, 3),
        }
        for name, shape in shapes.items():
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float32)
            if array.shape != shape:
                raise InputError(f"{name} has shape {array.shape}, expected {shape}")
            object.__setattr__(self, name, array)
        if self.sh.shape[1] not in (1, 4, 9, 16):
            raise InputError(f"sh has {self.sh.shape[1]} coefficients a channel, expected 1, 4, 9 or 16")

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return {1: 0, 4: 1, 9: 2, 16: 3}[self.sh.shape[1]]

    @property
    def scales(self) -> Float32:
        """(N, 3) metric standard deviations."""
        return np.exp(self.log_scales)

    @property
    def opacities(self) -> Float32:
        """(N,) opacity in (0, 1)."""
        return (1.0 / (1.0 + np.exp(-self.opacity_logits.astype(np.float64)))).astype(np.float32)

    @property
    def is_flat(self) -> bool:
        """Whether these are the discs of 2DGS: hardly any has a third scale above 1e-5 of the others."""
        for rows, share in ((self.log_scales[:256], 0.5), (self.log_scales, _FLAT_SHARE)):
            thin = rows[:, 2] - np.minimum(rows[:, 0], rows[:, 1]) <= np.log(_FLAT)
            if np.count_nonzero(thin) < max(share * len(thin), 1):  # most models tell by their first rows
                return False
        return True

    def take(self, index: npt.NDArray[Any]) -> GaussianModel:
        """The Gaussians at an integer index or under a boolean mask, in that order."""
        whole = self.file_rows
        kept = None if whole is None else FileRows(whole.rows[index], whole.count)
        more = None if self.carried is None else Carried(self.carried.columns[index], self.carried.comments)
        return replace(self, file_rows=kept, carried=more, **{name: getattr(self, name)[index] for name in ATTRIBUTES})

    def with_(self, **arrays: Any) -> GaussianModel:
        """A copy with some attributes replaced."""
        if len(arrays.get("means", self.means)) != len(self):
            arrays = {"file_rows": None, "carried": None, **arrays}
        return replace(self, **arrays)

    def row_of(self, index: int) -> int:
        """The row of its file that a Gaussian is."""
        return index if self.file_rows is None else int(self.file_rows.rows[index])

    def with_dc(self, dc: npt.NDArray[Any]) -> GaussianModel:
        """A copy with the DC coefficients replaced; dc is (N, 3)."""
        sh = self.sh.copy()
        sh[:, 0] = dc
        return replace(self, sh=sh)


def joined(parts: Sequence[GaussianModel]) -> GaussianModel:
    """One model of several, one after another, of the highest degree among them; antialiased where all are."""
    if len(parts) == 1:
        return parts[0]
    rows = None
    if any(part.file_rows is not None for part in parts):
        each = [part.file_rows or FileRows(np.arange(len(part)), len(part)) for part in parts]
        starts = np.cumsum([0, *(one.count for one in each)])
        rows = FileRows(np.concatenate([one.rows + at for one, at in zip(each, starts, strict=False)]), int(starts[-1]))
    whole: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in ATTRIBUTES if name != "sh"
    }
    whole["sh"] = np.zeros((len(whole["means"]), max(part.sh.shape[1] for part in parts), 3), dtype=np.float32)
    start = 0
    for part in parts:
        whole["sh"][start : start + len(part), : part.sh.shape[1]] = part.sh
        start += len(part)
    return GaussianModel(**whole, antialiased=all(part.antialiased for part in parts), file_rows=rows)


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera, OpenCV frame (x right, y down, z forward); pixel centres lie at half integers."""

    viewmat: Float64  # (4, 4) world to camera
    K: Float64  # (3, 3) intrinsics in pixels
    width: int  # of the image, pixels; so is the height
    height: int

    def __post_init__(self) -> None:
        for name, shape in (("viewmat", (4, 4)), ("K", (3, 3))):
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if array.shape != shape or not np.isfinite(array).all():
                raise CameraError(f"{name} must be a finite {shape} matrix, got shape {array.shape}")
            object.__setattr__(self, name, array)
        if self.width < 1 or self.height < 1:
            raise CameraError(f"image size must be positive, got {self.width}x{self.height}")
        if self.K[0, 0] <= 0 or self.K[1, 1] <= 0:
            raise CameraError(f"focal lengths must be positive, got {self.K[0, 0]}, {self.K[1, 1]}")

    @property
    def position(self) -> Float64:
        """(3,) the camera's centre in the world."""
        return -self.viewmat[:3, :3].T @ self.viewmat[:3, 3]

    def resized(self, width: int, height: int) -> Camera:
        """The same view with another number of pixels (intrinsics scaled per axis)."""
        sx, sy = width / self.width, height / self.height
        return Camera(self.viewmat, np.diag([sx, sy, 1.0]) @ self.K, width, height)

    def relative_to(self, origin: npt.ArrayLike) -> Camera:
        """The same view of a scene whose origin moves to a point."""
        viewmat = self.viewmat.copy()
        viewmat[:3, 3] += viewmat[:3, :3] @ np.asarray(origin, dtype=np.float64)
        return Camera(viewmat, self.K, self.width, self.height)

    def with_side(self, side: int) -> Camera:
        """The same view with `side` pixels along its longer side."""
        scale = side / max(self.width, self.height)
        return self.resized(max(1, round(self.width * scale)), max(1, round(self.height * scale)))


def look_at(
    eye: npt.ArrayLike, target: npt.ArrayLike, up: npt.ArrayLike, focal: float, width: int, height: int
) -> Camera:
    """Camera at `eye` looking at `target`, `up` pointing up in the image, focal length in pixels."""
    eye, target, up = (np.asarray(v, dtype=np.float64) for v in (eye, target, up))
    z = target - eye
    distance = float(np.linalg.norm(z))
    if distance == 0:
        raise CameraError("camera and target coincide")
    z = z / distance
    x = np.cross(z, up)
    if np.linalg.norm(x) < 1e-9:  # looking along up: any right vector will do
        x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x = x / np.linalg.norm(x)
    y = np.cross(z, x)
    viewmat = np.eye(4)
    viewmat[:3, :3] = [x, y, z]
    viewmat[:3, 3] = -viewmat[:3, :3] @ eye
    K = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    return Camera(viewmat, K, width, height)
