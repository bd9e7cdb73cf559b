"""What a record may hold: checked whole before anything in it is used.

A record is sealed by a key, but that key may be a stranger's (a dispute), and whatever is in the plan decides the
chips: a field that is not read would be a free number to try records out with. So names that no table here knows are
refused, and of those that it knows, type, shape, range and finiteness are checked. A new field is a new row.

Sizes in shapes: N Gaussians of the reference, M_s code vectors of stage s, R carriers in D numbers of a colour (3 of
DC, or all that the reference has), C = R * sum M_s chips, P chips of the copy layer's tint, V key views, L landmarks.
A size that no earlier row fixed is taken from the array, within its limits.
"""

import base64
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError, MalformedRecordError
from engine.watermark.messages import message_signs

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class ArrayRule:
    """What an array of the plan must be."""

    dtypes: tuple[str, ...]
    shape: tuple[str | int, ...]  # names of sizes, or numbers
    low: float  # smallest and largest value
    high: float
    group: str = ""  # of a group all are there or none; without one the array is always there
    each_stage: bool = False  # one for each stage, its name followed by "/" and the stage


PLAN_ARRAYS: Mapping[str, ArrayRule] = {
    "labels": ArrayRule(("<u2", "<i4"), ("N",), 0, 2**31, each_stage=True),
    "directions": ArrayRule(("<f8",), ("R", "D"), -1.001, 1.001, each_stage=True),
    "amplitudes": ArrayRule(("<f4",), ("C",), 0.0, 1e3),
    "multiples": ArrayRule(("|u1",), ("N",), 0, 192, group="multiples"),
    "copies/labels": ArrayRule(("<u2", "<i4"), ("N",), 0, 2**31, group="copies"),
    "copies/amplitudes": ArrayRule(("<f4",), ("P",), 0.0, 1e3, group="copies"),
    "copies/multiples": ArrayRule(("|u1",), ("N",), 0, 192, group="copies/multiples"),
    "cameras/viewmats": ArrayRule(("<f8",), ("V", 4, 4), -1e12, 1e12),
    "cameras/intrinsics": ArrayRule(("<f8",), ("V", 3, 3), -1e7, 1e7),
    "cameras/sizes": ArrayRule(("<i4",), ("V", 2), 1, 1 << 14),
    "landmarks/points": ArrayRule(("<f4",), ("L", 3), -1e12, 1e12, group="landmarks"),
    "landmarks/descriptors": ArrayRule(("|u1",), ("L", 128), 0, 255, group="landmarks"),
    "landmarks/views": ArrayRule(("<i4",), ("L",), 0, 1 << 14, group="landmarks"),
}
"""Arrays of the plan."""

SIZES: Mapping[str, tuple[int, int]] = {"R": (1, 3), "D": (3, 48), "V": (1, 4096), "L": (0, 1 << 22), "P": (1, 1 << 24)}
"""Limits of sizes that follow from an array itself."""
MOST_STAGES, MOST_CHIPS = 16, 1 << 24
MOST_DRAWS = 256
"""Times that a copy's layer is drawn."""
MOST_NAME = 400
"""Characters of a copy's name, and of a commitment."""
MOST_STAMPS, MOST_STAMP = 16, 1 << 17
"""Time stamps that drew for a plan, and characters of one."""


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value <= 1e6


def _is_message(value: Any) -> bool:
    try:
        return isinstance(value, str) and value == value.lower() and len(message_signs(value)) == 4 * len(value)
    except InputError:
        return False


def _is_codes(value: Any) -> bool:
    whole = isinstance(value, list) and 1 <= len(value) <= MOST_STAGES
    return whole and all(type(count) is int and 1 <= count <= MOST_CHIPS for count in value)


def _is_grain(value: Any) -> bool:
    if not isinstance(value, dict) or set(value) != {"center", "scale"}:
        return False
    return all(type(step) is float and 0.0 <= step <= 1.0 for step in value.values()) and any(value.values())


def _is_copies(value: Any) -> bool:
    """What the copy layer holds in addition to its arrays: number of code vectors, the grain, and which draw it is."""
    if not isinstance(value, dict) or not {"codes", "draw"} <= set(value) <= {"codes", "draw", "grain"}:
        return False
    whole = type(value["codes"]) is int and 1 <= value["codes"] <= MOST_CHIPS
    drawn = type(value["draw"]) is int and 0 <= value["draw"] < MOST_DRAWS
    return whole and drawn and ("grain" not in value or _is_grain(value["grain"]))


def _is_texts(value: Any) -> bool:
    return isinstance(value, dict) and 1 <= len(value) <= 16 and all(map(_is_text, (*value, *value.values())))


def _is_stamps(value: Any) -> bool:
    texts = isinstance(value, list) and 1 <= len(value) <= MOST_STAMPS and all(isinstance(each, str) for each in value)
    try:
        return texts and all(len(each) <= MOST_STAMP and base64.b64decode(each, validate=True) for each in value)
    except ValueError:
        return False


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= MOST_NAME and value.encode(errors="replace").decode() == value


@dataclass(frozen=True)
class Rule:
    """What a JSON value must be."""

    holds: Callable[[Any], bool]
    text: str  # for the reader of an error
    required: bool = True


PLAN: Mapping[str, Rule] = {
    "message": Rule(_is_message, "16 to 256 bits in lower-case hexadecimal digits"),
    "codes": Rule(_is_codes, f"1 to {MOST_STAGES} numbers of code vectors"),
    "grain": Rule(_is_grain, "two amplitudes from 0 to 1, not both 0", required=False),
    "copies": Rule(_is_copies, "code vectors, draw and grain of a copy layer", required=False),
    "commitments": Rule(_is_texts, "short texts by name", required=False),
    "antialiased": Rule(lambda value: value is True, "true, or not there", required=False),
}
"""JSON values of the plan."""

EXTRA: Mapping[str, Rule] = {
    "strength": Rule(_is_number, "a positive number up to 10^6", required=False),
    "settings": Rule(lambda value: isinstance(value, dict), "an object"),
    "stamps": Rule(_is_stamps, f"1 to {MOST_STAMPS} time stamps in base64", required=False),
}
"""JSON values outside the plan: nothing here may decide anything that the chips do not follow from."""


def admit(
    version: int,
    copy: Any,
    plan: Mapping[str, Any],
    extra: Mapping[str, Any],
    arrays: Mapping[str, Array],
    gaussians: int,
    coefficients: int = 1,
) -> None:
    """Raise MalformedRecordError unless everything in a record is what the tables of this module say.

    Parameters
    ----------
    version : int
        Of the record's format: the first has a strength, the second may have a grain, the third a copy layer.
    copy : str
        Name of the recipient.
    plan, extra : mapping
        JSON values of the plan, and outside it.
    arrays : mapping
        Arrays of the plan.
    gaussians, coefficients : int
        Of the reference, and how many its colours have.
    """
    if not _is_text(copy):
        raise MalformedRecordError("the record's copy has no usable name")
    _admit_values(plan, PLAN, "plan")
    _admit_values(extra, EXTRA, "settings")
    later = "copies" in plan or "multiples" in arrays or "stamps" in extra
    if ("strength" in extra) != (version == 1) or ("grain" in plan and version == 1) or (later and version < 3):
        raise MalformedRecordError(f"the record's fields are not those of format {version}")
    if ("copies" in plan) != ("copies/labels" in arrays) or ("copies/multiples" in arrays and "copies" not in plan):
        raise MalformedRecordError("the record's copy layer is not whole")
    codes = plan["codes"]
    _admit_arrays(arrays, len(codes), {"N": gaussians})
    chips = sum(codes) * len(arrays["directions/0"])
    if (width := arrays["directions/0"].shape[1]) not in (3, 3 * coefficients):
        raise MalformedRecordError(f"carriers of the record span {width} numbers of {3 * coefficients}")
    if chips > MOST_CHIPS or arrays["amplitudes"].shape != (chips,):
        raise MalformedRecordError(f"the record has {len(arrays['amplitudes'])} amplitudes for {chips} chips")
    for stage, count in enumerate(codes):
        if int(arrays[f"labels/{stage}"].max()) >= count:
            raise MalformedRecordError(f"labels of stage {stage} lie outside its {count} code vectors")
        _admit_directions(arrays[f"directions/{stage}"], stage)
    if "copies" in plan:
        count, carriers = plan["copies"]["codes"], len(arrays["directions/0"])
        if int(arrays["copies/labels"].max()) >= count or len(arrays["copies/amplitudes"]) != count * carriers:
            raise MalformedRecordError(f"the record's copy layer does not have {count} code vectors")
    _admit_cameras(arrays["cameras/viewmats"], arrays["cameras/intrinsics"])


def _admit_values(values: Mapping[str, Any], rules: Mapping[str, Rule], what: str) -> None:
    if unknown := sorted(set(values) - set(rules)):
        raise MalformedRecordError(f"the record's {what} hold {unknown[0]!r}, which this program does not know")
    for name, rule in rules.items():
        if name not in values and rule.required:
            raise MalformedRecordError(f"the record's {what} lack {name!r}")
        if name in values and not rule.holds(values[name]):
            raise MalformedRecordError(f"{name!r} in the record's {what} must be {rule.text}")


def _admit_arrays(arrays: Mapping[str, Array], stages: int, sizes: dict[str, int]) -> None:
    """Names, types, shapes, ranges; fills in the sizes that follow."""
    groups = {rule.group for name, rule in PLAN_ARRAYS.items() if rule.group and name in arrays}
    expected = {}
    for name, rule in PLAN_ARRAYS.items():
        if not rule.group or rule.group in groups:
            names = [f"{name}/{stage}" for stage in range(stages)] if rule.each_stage else [name]
            expected.update(dict.fromkeys(names, rule))
    if set(arrays) != set(expected):
        odd = sorted(set(arrays) ^ set(expected))[0]
        verb = "hold the unknown array" if odd in arrays else "lack the array"
        raise MalformedRecordError(f"the record's arrays {verb} {odd!r}")
    for name, rule in expected.items():
        _admit_array(name, arrays[name], rule, sizes)


def _admit_array(name: str, array: Array, rule: ArrayRule, sizes: dict[str, int]) -> None:
    if array.dtype.str not in rule.dtypes or array.ndim != len(rule.shape):
        raise MalformedRecordError(f"array {name!r} of the record is {array.dtype} of shape {array.shape}")
    for size, wanted in zip(array.shape, rule.shape, strict=True):
        if isinstance(wanted, str) and wanted in SIZES and wanted not in sizes:
            low, high = SIZES[wanted]
            if not low <= size <= high:
                raise MalformedRecordError(f"array {name!r} of the record has {size} rows, allowed: {low} to {high}")
            sizes[wanted] = size
        known = sizes.get(wanted, size) if isinstance(wanted, str) else wanted
        if size != known:
            raise MalformedRecordError(f"array {name!r} of the record has shape {array.shape}, {known} expected")
    if array.size:
        low, high = array.min(), array.max()  # a NaN comes through both, and no comparison holds
        if not (rule.low <= low and high <= rule.high):
            raise MalformedRecordError(f"array {name!r} of the record goes from {low} to {high}")


def _admit_directions(directions: Array, stage: int) -> None:
    if not np.allclose(directions @ directions.T, np.eye(len(directions)), atol=1e-6):
        raise MalformedRecordError(f"the carriers of stage {stage} are not orthonormal")


def _admit_cameras(viewmats: Array, intrinsics: Array) -> None:
    turns = viewmats[:, :3, :3]
    rigid = np.allclose(turns @ np.swapaxes(turns, 1, 2), np.eye(3), atol=1e-3) and (np.linalg.det(turns) > 0).all()
    if not rigid or not np.allclose(viewmats[:, 3], [0.0, 0.0, 0.0, 1.0]):
        raise MalformedRecordError("a key view of the record is no rigid camera")
    lens = intrinsics[:, 0, 0] > 0, intrinsics[:, 1, 1] > 0, intrinsics[:, 2, 2] == 1, intrinsics[:, 2, :2] == 0
    if not all(part.all() for part in lens):
        raise MalformedRecordError("a key view of the record has no lens")
