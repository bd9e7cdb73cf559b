"""The .splat format: 32 bytes a Gaussian, no header, no spherical harmonics (antimatter15/splat)."""

import numpy as np

from engine.errors import FormatError
from engine.formats.declaration import Kind, Range
from engine.formats.repairs import ALPHA_LOGITS, Repair, clean, to_bytes
from engine.model import SH_C0, GaussianModel

RECORD = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("quats", "u1", 4)])
"""Centre and metric scales, color and alpha in steps of 1/255, quaternion w, x, y, z as 128 + 128 q."""

_SAMPLE = 4096
_PLAUSIBLE_MAGNITUDE = 1e9


def looks_like_splat(data: bytes | memoryview) -> bool:
    """Whether bytes without any magic, the whole file, are probably Gaussians of this format.

    The length is a multiple of 32, and of up to 4,096 rows spread over the file at least half hold a finite centre,
    three scales that are not negative, and a quaternion of about unit length. Of random rows, about one in a hundred
    does.
    """
    if len(data) == 0 or len(data) % RECORD.itemsize:
        return False
    records = np.frombuffer(data, dtype=RECORD)
    rows = records[:: -(-len(records) // _SAMPLE)]
    scales = rows["scales"]
    norms = np.linalg.norm((rows["quats"].astype(np.float32) - 128) / 128, axis=1)
    good = (np.abs(rows["means"]) < _PLAUSIBLE_MAGNITUDE).all(axis=1)
    good &= ((scales >= 0) & (scales < _PLAUSIBLE_MAGNITUDE)).all(axis=1)
    good &= np.abs(norms - 1) < 0.1
    return bool(2 * np.count_nonzero(good) >= len(rows))


def read_splat(data: bytes | memoryview, *, file: str) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """Read a .splat file; degree 0. FormatError if the length is no multiple of 32, or no Gaussian is usable."""
    if len(data) % RECORD.itemsize:
        message = f"{len(data)} bytes are no multiple of {RECORD.itemsize} bytes: cut off, or bytes follow"
        raise FormatError(message, file=file, element="vertex", row=len(data) // RECORD.itemsize)
    records = np.frombuffer(data, dtype=RECORD)
    with np.errstate(divide="ignore", invalid="ignore"):  # a scale of zero is mended, a negative one is a fault
        log_scales = np.log(records["scales"])
        quats = (records["quats"].astype(np.float32) - 128) / 128
        norms = np.linalg.norm(quats, axis=1, keepdims=True)
        quats /= np.where(np.abs(norms - 1) < 0.02, norms, 1)  # eight bits never give unit length: no fault
        rgba = records["rgba"]
        logits = ALPHA_LOGITS.astype(np.float32)[rgba[:, 3]]
    dc = ((rgba[:, :3] / 255 - 0.5) / SH_C0).astype(np.float32)
    return clean(records["means"], log_scales, quats, logits, dc[:, None, :], file=file)


def write_splat(model: GaussianModel) -> bytes:
    """The file, 32 bytes a Gaussian in their order; harmonics beyond degree 0 are lost, colors are clipped to 0..1."""
    records = np.empty(len(model), dtype=RECORD)
    records["means"], records["scales"] = model.means, model.scales
    records["rgba"][:, :3] = to_bytes((0.5 + SH_C0 * model.sh[:, 0]) * 255)
    records["rgba"][:, 3] = to_bytes(model.opacities * 255)
    records["quats"] = to_bytes(model.quats * 128 + 128)
    return records.tobytes()


SPLAT = Kind(
    "splat",
    lambda data, file: looks_like_splat(data),
    lambda data, file, _: read_splat(data, file=file),
    lambda model: [write_splat(model)],
    guessed=True,
    ranges=(Range("colors", -0.5 / SH_C0, 0.5 / SH_C0, 1 / 255 / SH_C0),),
)
KINDS = (SPLAT,)
