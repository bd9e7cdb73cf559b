"""What other programs make of a Gaussian PLY: other names, colors in place of harmonics, half floats in integers."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError
from engine.formats.ply.extras import GAUSSIAN, named
from engine.formats.ply.header import TYPE_NAMES, Header
from engine.formats.repairs import LOG_SCALE_RANGE, OPACITY_LOGIT_LIMIT, VISIBLE_ROUNDING, Repair
from engine.model import SH_C0, Float32

DC = ("f_dc_0", "f_dc_1", "f_dc_2")
COLORS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_OTHERS = {"rot": ("rotation",), "scale": ("scaling", "scales"), "f_dc": ("features_dc", "sh_dc", "dc")}
_ALIASES = {f"{other}_{i}": f"{own}_{i}" for own, others in _OTHERS.items() for other in others for i in range(4)}
_ALIASES |= {f"{own}[{i}]": f"{own}_{i}" for own in _OTHERS for i in range(4)}  # lists
_ALIASES |= {f"{start}{axis}": f"rot_{i}" for i, axis in enumerate("wxyz") for start in ("rot_", "q")}
_ALIASES |= {f"scale_{axis}": f"scale_{i}" for i, axis in enumerate("xyz")}  # names that scripts write, and INRIA's
_HALF_LIMITS = {"scale": -LOG_SCALE_RANGE[0], "opacity": OPACITY_LOGIT_LIMIT, "f_": 100.0, "rot": 100.0}
_LEAST_HALF = 2.0**-10
"""Whole numbers below 5,120 are half floats below this: a column of them has no larger value."""

_SOUND_SHARE = 0.99
"""Of values that are no NaN: of random bits, one half float in 32 is infinite or none."""

_LARGEST_HALF = 65504.0

_LEAST_BYTE = 40.0
"""No logit or coefficient of a trained scene is larger, where none is negative."""

_FEW = 64  # too few to say from their values what they are


def plain_names(header: Header) -> tuple[Header, list[Repair]]:
    """The header with INRIA's names, where a program put a prefix before them (CloudCompare: ``scalar_``) or wrote
    colors where the first coefficients should be (nerfstudio: ``red``, ``green``, ``blue``)."""
    vertex, repairs = header.element("vertex"), list[Repair]()
    if vertex is None:
        gaussians = [element for element in header.elements if element.names >= GAUSSIAN]
        if len(gaussians) != 1:
            return header, []
        vertex = gaussians[0]
        repairs.append(Repair("element_renamed", vertex.count, f"element {vertex.name!a} was read as 'vertex'"))
    names = [p.name for p in vertex.properties]
    prefix = next((name.removesuffix("opacity") for name in names if name.endswith("opacity")), "")

    def unprefixed(name: str) -> str:
        plain = name.removeprefix(prefix)
        return plain if plain and plain not in names else name

    for code, rename, how in (
        ("names_lowered", str.lower, "in lower case"),
        ("names_prefixed", unprefixed, f"without the prefix {prefix[:40]!r}"),
        ("names_replaced", lambda name: str(_ALIASES.get(name, name)), "as those of INRIA's files"),
    ):
        new = [rename(name) for name in names]
        changed = [old for old, name in zip(names, new, strict=True) if old != name]
        gained = (set(new) - set(names)) & {*GAUSSIAN, DC[0]}
        if set(new) >= GAUSSIAN and gained and len(set(new)) == len(new):
            repairs.append(Repair(code, len(changed), f"names {named(changed)} were read {how}"))
            names = new
    colors = next((c for c in COLORS if set(c) <= set(names)), None)
    if colors and not set(DC) & set(names) and set(names) >= GAUSSIAN:
        table = dict(zip(colors, DC, strict=True))
        names = [table.get(name, name) for name in names]
        text = f"colors {named(colors)} were read as the first coefficients of harmonics"
        repairs.append(Repair("colors_read", vertex.count, text))
    properties = tuple(replace(p, name=name) for name, p in zip(names, vertex.properties, strict=True))
    read = replace(vertex, name="vertex", properties=properties)
    return replace(header, elements=tuple(read if e is vertex else e for e in header.elements)), repairs


def plain_types(
    records: npt.NDArray[np.void], used: Iterable[str], *, file: str
) -> tuple[npt.NDArray[np.void], list[Repair]]:
    """The records with every property in `used` a float: 16-bit integers are viewed as half floats where all of them
    are plausible as such. FormatError for any other integers: a whole number is no size, opacity or rotation."""
    fields = {name: field[0] for name, field in (records.dtype.fields or {}).items()}
    whole = [name for name in used if fields[name].kind in "iu"]
    if not whole:
        return records, []
    odd = next((name for name in whole if fields[name].itemsize != 2), None)
    if odd is None:
        as_halves = np.dtype([(name, f"{t.str[0]}f2" if name in whole else t) for name, t in fields.items()])
        viewed: npt.NDArray[np.void] = records.view(as_halves)
        odd = next((name for name in whole if not _plausible(viewed[name], name)), None)
        with np.errstate(invalid="ignore"):  # signalling NaN
            size = np.median(records["scale_0"].astype(np.float64))
        if set(whole) <= set("xyz") and size > np.log(1 / 20):  # not far below one unit: centers may be whole numbers
            odd = whole[0]
        if odd is None:
            kinds = {TYPE_NAMES[fields[name].str[1:]] for name in whole}
            text = f"{len(whole)} properties of type {named(sorted(kinds))} were read as the half floats that they hold"
            return viewed, [Repair("half_floats", len(whole), text)]
    kind = TYPE_NAMES[fields[odd].str[1:]]
    message = f"is {kind}, and its values are no half floats either: a whole number cannot be one; export it as float"
    raise FormatError(message, file=file, element="vertex", prop=odd)


def _plausible(values: npt.NDArray[Any], name: str) -> bool:
    """Whether half floats can be what a property of this name holds."""
    with np.errstate(invalid="ignore"):  # signalling NaN
        found = np.abs(values.astype(np.float32))
    limit = next((most for start, most in _HALF_LIMITS.items() if name.startswith(start)), _LARGEST_HALF)
    good = (found <= limit) | (np.isinf(found) & (name == "opacity"))  # an opacity of 1 has an infinite logit
    if np.count_nonzero(good) < _SOUND_SHARE * len(found):
        return False
    return name.startswith("f_rest") or not found.any() or float(found[good].max()) >= _LEAST_HALF


def dc_of_colors(colors: Float32, code: np.dtype[Any]) -> Float32:
    """(N, 3) first coefficients of colors of that type: floats in 0..1, else 0..255, or all that their type holds."""
    most = float(np.nanmax(colors, initial=0.0))
    full = 1.0 if code.kind == "f" and most <= 2.0 else 255.0 if code.kind == "f" or most <= 255 else np.iinfo(code).max
    return ((colors / np.float32(full) - np.float32(0.5)) / np.float32(SH_C0)).astype(np.float32)


def georeferenced(
    records: npt.NDArray[np.void], means: Float32, log_scales: Float32
) -> tuple[tuple[float, float, float], list[Repair]]:
    """Origin (x, y, z) of the centers, and repairs.

    Where float32 would round a center in double precision by more than `VISIBLE_ROUNDING` of its Gaussian's size, the
    origin is the median center in whole units, and `means` becomes relative to it, in place. A repair counts the
    centers that are still rounded so much.
    """
    origin = (0.0, 0.0, 0.0)
    if all(records.dtype[axis].itemsize < 8 for axis in "xyz"):
        return origin, _coarse(means, log_scales)
    with np.errstate(over="ignore", invalid="ignore"):
        exact = np.stack([records[axis].astype(np.float64) for axis in "xyz"], axis=1)  # (N, 3)
        allowed = VISIBLE_ROUNDING * np.exp(np.median(log_scales, axis=1).astype(np.float64))  # of a disc, within it
        rows, _ = _rounded(exact, allowed)
        if not len(rows):
            return origin, []
        x, y, z = (float(np.rint(np.nanmedian(column))) for column in exact.T)
        moved = exact - np.array([x, y, z])
        left, error = _rounded(moved, allowed)
        repairs = []
        if len(left) < len(rows):
            origin, means[:] = (x, y, z), moved
            text = f"{len(rows)} centers are doubles that float32 would round: read relative to"
            text += f" ({x:.0f}, {y:.0f}, {z:.0f}), which .ply gets back"
            repairs.append(Repair("origin_moved", len(rows), text))
    if len(left):
        text = (
            f"{len(left)} centers (first in row {left[0]}) are doubles that float32 rounds by up to {error:.2g}, more"
            " than 1/20 of their Gaussian's size"
        )
        repairs.append(Repair("centers_rounded", len(left), text))
    return origin, repairs


def _coarse(means: Float32, log_scales: Float32) -> list[Repair]:
    """What is said where most centers lie so far out that float32 had no digits left for them."""
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.spacing(np.abs(means).max(axis=1)) / 2
        rows = np.flatnonzero(steps > VISIBLE_ROUNDING * np.exp(log_scales.max(axis=1)))  # thin ones are not far out
    if 2 * len(rows) <= len(means):
        return []
    text = (
        f"{len(rows)} centers (first in row {rows[0]}) lie so far out that their type, float32, rounds them by up to"
        f" {steps[rows].max():.2g}, more than 1/20 of their Gaussian's size: export doubles, or around a local origin"
    )
    return [Repair("centers_coarse", len(rows), text)]


def _rounded(exact: npt.NDArray[np.float64], allowed: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.intp], float]:
    """Rows that float32 rounds by more than is allowed, and by how much at most."""
    error = np.abs(exact - exact.astype(np.float32)).max(axis=1)
    rows = np.flatnonzero(np.isfinite(error) & (error > allowed))
    return rows, float(error[rows].max(initial=0.0))


def activation_hints(log_scales: Float32, logits: Float32, dc: Float32) -> list[Repair]:
    """Hints where what is stored as logarithms, logits and coefficients looks like sizes, opacities and colors.

    Of a trained scene, some sizes lie below one unit (a negative logarithm) and some opacities below 1/2 (a negative
    logit) and above 0.73, and some colors are darker than gray (a negative coefficient); values of which not one does
    are what the activation yields.
    """
    if len(logits) < _FEW:
        return []
    what = "no change was made; if it renders as fog, export raw values"
    opacities, colors = _as_shown(logits), _as_shown(dc)
    raised = log_scales.min() > 0 and (opacities or np.median(log_scales) < 1)
    hints = {"scales": "already exponentiated" if raised else None, "opacities": opacities, "colors": colors}
    return [
        Repair(f"{name}_activated", len(logits), f"{name} look activated ({how}): {what}")
        for name, how in hints.items()
        if how
    ]


def _as_shown(values: Float32) -> str | None:
    """What a screen's range the values fill, if one."""
    low, high = float(values.min()), float(values.max())
    if low < 0 or low == high or not high <= 255:
        return None
    return "already 0 to 1" if high <= 1 else "already 0 to 255" if high > _LEAST_BYTE else None
