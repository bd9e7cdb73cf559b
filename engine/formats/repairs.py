"""What is wrong in a file yet harmless is repaired here, the same way for every format, and reported."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError
from engine.model import Bool, FileRows, Float32, GaussianModel

INFINITE_OPACITY_LOGIT = float(np.log(511.0))
"""An opacity of exactly 1 (or 0) becomes 1 - 1/512 (or 1/512): such values come from 8-bit alpha, whose last
step spans half of 1/255, so that the repaired value still rounds to 255 (or 0)."""

OPACITY_LOGIT_LIMIT = 80.0
"""Finite logits beyond it are clamped: exp(80) is the largest round power that float32 holds in comfort."""

LOG_SCALE_RANGE = (-30.0, 20.0)
"""Logarithm of 1e-13 and of 5e8 scene units: beyond, squared scales times focal lengths leave float32."""

MAGNITUDE_LIMIT = 1e12
"""A centre or a coefficient beyond it is no datum: its square times a focal length leaves float32."""

VISIBLE_ROUNDING = 1 / 20
"""Of a Gaussian's size: what a center may be rounded by before it is worth a word."""

UNIT_TOLERANCE = 1e-6
"""A quaternion this near to unit length keeps its bits: normalising it again would only add rounding."""

_alpha = np.arange(256) / 255
with np.errstate(divide="ignore"):
    ALPHA_LOGITS = np.log(_alpha) - np.log1p(-_alpha)
"""(256,) float64 logit of every 8-bit alpha; those of 0 and 255 are infinite, which `clean` mends."""

_CHUNK = 1 << 16
_LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class Repair:
    """One kind of harmless fault that was mended, or ignored, on loading.

    `code` is a stable identifier such as ``"rows_dropped"``, `count` tells how many Gaussians (or properties) it
    concerned, `text` is one sentence for the user.
    """

    code: str
    count: int
    text: str


def to_bytes(values: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Rounded to 0..255."""
    return np.asarray(np.clip(np.rint(values), 0, 255).astype(np.uint8))


def degree_dropped(degree: int, count: int) -> Repair:
    """The note on harmonics beyond the third degree, which a model cannot hold."""
    return Repair("degree_dropped", count, f"harmonics of degree {degree} were read to degree 3: the rest was dropped")


def clean(
    means: npt.NDArray[Any],
    log_scales: npt.NDArray[Any],
    quats: npt.NDArray[Any],
    opacity_logits: npt.NDArray[Any],
    sh: npt.NDArray[Any],
    *,
    file: str,
    element: str = "vertex",
    rows: FileRows | None = None,
) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """Turn decoded arrays into a model that every later stage may trust, and tell what was mended.

    `means` (N, 3); `log_scales` (N, 3), -inf for a scale of zero; `quats` (N, 4) w, x, y, z of any length;
    `opacity_logits` (N,), infinite for an opacity of exactly one or zero; `sh` (N, K, 3). `element` is what the format
    calls its list of Gaussians, for messages; `rows` are those of the file where some were left out before.

    Rows with a NaN, or with a centre, coefficient or scale that is infinite, are dropped; infinite opacities, zero
    scales, absurd scales and zero quaternions become finite; quaternions become unit vectors. The order is the file's.
    The caller's arrays are never written to; those that need no repair are passed on without a copy. FormatError if
    there is no Gaussian, or none that is usable.
    """
    arrays = (means, log_scales, quats, opacity_logits, sh)
    with np.errstate(over="ignore", invalid="ignore"):  # a double beyond float32 becomes infinite
        means, log_scales, quats, opacity_logits, sh = (np.ascontiguousarray(a, dtype=np.float32) for a in arrays)
    if len(means) == 0:
        raise FormatError("holds no Gaussians", file=file, element=element)

    faults: dict[str, Bool] = {
        "means": _out_of_bounds(means, MAGNITUDE_LIMIT),
        "log_scales": np.any(~(log_scales < np.inf), axis=1),
        "quats": _out_of_bounds(quats, _LARGEST),
        "opacity_logits": np.isnan(opacity_logits),
        "sh": _out_of_bounds(sh, MAGNITUDE_LIMIT),
    }
    bad: Bool = np.any(list(faults.values()), axis=0)
    log = _Log(rows)
    origin = np.arange(len(bad)) if rows is None else rows.rows
    if bad.any():
        first = int(np.argmax(bad))
        attribute = next(name for name, fault in faults.items() if fault[first])
        arrays = (means, log_scales, quats, opacity_logits, sh)
        prop, value = _name_fault(attribute, dict(zip(faults, arrays, strict=True))[attribute][first])
        if bad.all():
            message = f"no Gaussian is usable; the value here is {value}"
            raise FormatError(message, file=file, element=element, row=int(origin[first]), prop=prop)
        why = f"left out, because a value is no number of a scene ({prop} = {value})"
        log.note("rows_dropped", np.flatnonzero(bad), why)
        log.rows = rows = FileRows(origin[~bad], len(bad) if rows is None else rows.count)
        means, log_scales, quats, opacity_logits, sh = (array[~bad] for array in arrays)
    log_scales = _clamp_scales(log_scales, log)
    opacity_logits = _clamp_opacities(opacity_logits, log)
    quats = _normalize(quats, log)
    return GaussianModel(means, log_scales, quats, opacity_logits, sh, file_rows=rows), tuple(log.repairs)


class _Log:
    """Collects repairs, by rows of the file."""

    def __init__(self, rows: FileRows | None) -> None:
        self.repairs: list[Repair] = []
        self.rows = rows

    def note(self, code: str, rows: npt.NDArray[np.intp], what: str) -> None:
        if not len(rows):
            return
        first = rows[0] if self.rows is None else self.rows.rows[rows[0]]
        noun = "Gaussian" if len(rows) == 1 else "Gaussians"
        self.repairs.append(Repair(code, len(rows), f"{len(rows)} {noun} (first in row {first}): {what}"))


def _out_of_bounds(array: Float32, limit: float) -> Bool:
    """(N,) rows in which some value is NaN or larger than limit."""
    bad = np.zeros(len(array), dtype=np.bool_)
    for start in range(0, len(array), _CHUNK):
        chunk = array[start : start + _CHUNK].reshape(len(array[start : start + _CHUNK]), -1)
        if not (chunk.min() >= -limit and chunk.max() <= limit):  # false for NaN as well
            bad[start : start + _CHUNK] = ~(np.abs(chunk) <= limit).all(axis=1)
    return bad


def _name_fault(attribute: str, row: Float32) -> tuple[str, float]:
    """INRIA's name of the first unusable value in a Gaussian's attribute, and that value."""
    limits = {"means": MAGNITUDE_LIMIT, "sh": MAGNITUDE_LIMIT}
    flat = row.reshape(-1)
    fault = ~(flat < np.inf) if attribute == "log_scales" else ~(np.abs(flat) <= limits.get(attribute, _LARGEST))
    index = int(np.argmax(fault))
    value = float(flat[index])
    if attribute == "sh":
        coefficient, channel = divmod(index, 3)
        rest = len(flat) // 3 - 1
        return f"f_rest_{channel * rest + coefficient - 1}" if coefficient else f"f_dc_{channel}", value
    names = {"means": "xyz"[index % 3], "log_scales": f"scale_{index}", "quats": f"rot_{index}"}
    return names.get(attribute, "opacity"), value


def _clamp_scales(log_scales: Float32, log: _Log) -> Float32:
    low, high = LOG_SCALE_RANGE
    if log_scales.min() >= low and log_scales.max() <= high:
        return log_scales
    rows = np.flatnonzero(((log_scales < low) | (log_scales > high)).any(axis=1))
    log.note("scales_clamped", rows, f"scales clamped to [exp({low:g}), exp({high:g})]")
    return np.clip(log_scales, np.float32(low), np.float32(high))


def _clamp_opacities(logits: Float32, log: _Log) -> Float32:
    limit = OPACITY_LOGIT_LIMIT
    if logits.min() >= -limit and logits.max() <= limit:
        return logits
    infinite = np.isinf(logits)
    log.note(
        "opacities_infinite",
        np.flatnonzero(infinite),
        "opacity of exactly 0 or 1, usual in 8-bit files, became 1/512 or 511/512",
    )
    absurd = (np.abs(logits) > limit) & ~infinite
    log.note("opacities_clamped", np.flatnonzero(absurd), f"opacity logit clamped to +-{limit:g}")
    finite = np.clip(logits, np.float32(-limit), np.float32(limit))
    return np.where(infinite, np.copysign(np.float32(INFINITE_OPACITY_LOGIT), logits), finite)


def _normalize(quats: Float32, log: _Log) -> Float32:
    """Unit quaternions; those of unit length keep their bits, a zero quaternion is no rotation (as INRIA)."""
    norms = np.empty(len(quats))
    for start in range(0, len(quats), _CHUNK):
        chunk = quats[start : start + _CHUNK].astype(np.float64)
        norms[start : start + _CHUNK] = np.sqrt(np.einsum("nq,nq->n", chunk, chunk))
    other = np.flatnonzero(np.abs(norms - 1.0) > UNIT_TOLERANCE)
    if not len(other):
        return quats
    zero, scaled = other[norms[other] == 0.0], other[norms[other] != 0.0]
    result = quats.copy()
    result[zero] = np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32)
    result[scaled] = (quats[scaled] / norms[scaled, None]).astype(np.float32)
    log.note("quaternions_zero", zero, "zero quaternion read as no rotation")
    log.note("quaternions_normalized", scaled, "quaternion normalized")
    return result
