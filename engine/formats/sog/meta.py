"""meta.json of a SOG scene: checked, and brought to lookup tables that are the same for both versions."""

import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.guards import json_object
from engine.formats.modes import ANTIALIASED
from engine.formats.repairs import ALPHA_LOGITS, Repair
from engine.model import Float64
from engine.numerics.plain import Json

LEVELS = 256
PALETTE_ROW = 64
"""Code vectors in one row of the image of centroids."""

MAX_PALETTE = 1 << 16
REST_COEFFICIENTS = {1: 3, 2: 8, 3: 15}
"""Coefficients above DC for each number of bands."""

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]{0,99}")
_FILES = {"means": 2, "scales": 1, "quats": 1, "sh0": 1, "shN": 2}


@dataclass(frozen=True, eq=False)
class Palette:
    """Spherical harmonics above DC: `table` (256,) is the coefficient of each pixel value.

    `bands` (1 to 3) and the `count` of code vectors are None where the size of the image of centroids must tell
    (version 1, and some writers).
    """

    bands: int | None
    count: int | None
    table: Float64


@dataclass(frozen=True, eq=False)
class SogMeta:
    """What meta.json says."""

    version: int  # 1 (SOGS, linear ranges) or 2 (codebooks)
    count: int  # Gaussians claimed
    files: dict[str, tuple[str, ...]]  # names of the images of each property
    mins: Float64  # (3,) range of the centres in the domain sign(x) log(1 + abs(x))
    maxs: Float64
    scales: Float64  # (3, 256) log scale of each pixel value, by axis
    dc: Float64  # (3, 256) DC coefficient of each pixel value, by channel
    opacity: Float64  # (256,) logit of each alpha; infinite for 0 and 255 in version 2
    palette: Palette | None  # None for spherical harmonics of degree 0
    mode: object  # how it is to be drawn, see `engine.formats.modes`
    repairs: tuple[Repair, ...]  # faults of meta.json that were mended

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all images."""
        return tuple(name for names in self.files.values() for name in names)


def parse_meta(text: bytes, *, file: str) -> SogMeta:
    """Check a meta.json and turn it into tables.

    UnsupportedFormatError for another version than 1 (which names none) and 2; FormatError if it is no JSON, or a
    member is missing, of the wrong kind, or no finite number.
    """
    return _Reader(json_object(text, file=file, element="meta.json"), file).parse()


class _Reader:
    """Takes members out of the parsed JSON; every complaint names the file and the member."""

    def __init__(self, meta: Json, file: str) -> None:
        self._file, self._meta = file, meta
        self._repairs: list[Repair] = []

    def parse(self) -> SogMeta:
        version = self._meta.get("version", 1)
        if isinstance(version, bool) or version not in (1, 2):
            message = f"SOG version {version!r:.40}, read are 1 and 2"
            raise UnsupportedFormatError(message, file=self._file, element="meta.json", prop="version")
        if "opacities" in self._meta:
            message = "is gsplat's own compression, no SOG: export the model as .ply (gsplat.export_splats)"
            raise UnsupportedFormatError(message, file=self._file, element="meta.json")
        codebooks = version == 2
        count = self._integer(self._meta.get("count"), "count") if codebooks else self._shape_count()
        files = {key: self._names(key, n) for key, n in _FILES.items() if key != "shN" or "shN" in self._meta}
        if codebooks:
            scales, dc = (np.tile(self._codebook(key), (3, 1)) for key in ("scales", "sh0"))
            opacity = ALPHA_LOGITS
        else:
            scales, color = self._ramps("scales", 3), self._ramps("sh0", 4)
            dc, opacity = color[:3], color[3]
        mins, maxs = self._numbers("means", "mins", 3), self._numbers("means", "maxs", 3)
        if (mins > maxs).any():
            raise self._fault("is below means.mins", "means.maxs")
        return SogMeta(
            version=version,
            count=count,
            files=files,
            mins=mins,
            maxs=maxs,
            scales=scales,
            dc=dc,
            opacity=opacity,
            palette=self._palette(codebooks) if "shN" in files else None,
            mode=self._meta.get("model", ANTIALIASED if self._meta.get("antialias") is True else None),
            repairs=tuple(self._repairs),
        )

    def _fault(self, message: str, prop: str) -> FormatError:
        return FormatError(message, file=self._file, element="meta.json", prop=prop)

    def _member(self, key: str) -> Json:
        member = self._meta.get(key)
        if not isinstance(member, dict):
            raise self._fault("is missing or no object", key)
        return member

    def _integer(self, value: Any, prop: str) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise self._fault(f"{value!r:.40} is no integer", prop)
        return value

    def _shape_count(self) -> int:
        shape = self._member("means").get("shape")
        if not isinstance(shape, list) or not shape:
            raise self._fault("is missing: neither version 2 nor a list of version 1", "means.shape")
        return self._integer(shape[0], "means.shape")

    def _names(self, key: str, count: int) -> tuple[str, ...]:
        names = self._member(key).get("files")
        if not isinstance(names, list) or len(names) != count:
            raise self._fault(f"must list {count} names", f"{key}.files")
        for name in names:
            if not isinstance(name, str) or not _NAME.fullmatch(name):
                raise self._fault(f"{name!r:.120} is no plain file name", f"{key}.files")
        return tuple(names)

    def _finite(self, values: Any, count: int, prop: str) -> Float64:
        if not isinstance(values, list) or len(values) != count:
            raise self._fault(f"must list {count} numbers", prop)
        for value in values:
            kind_ok = isinstance(value, int | float) and not isinstance(value, bool)
            if not kind_ok or abs(value) > 1e30 or not math.isfinite(value):
                raise self._fault(f"{value!r:.40} is no finite number", prop)
        return np.array(values, dtype=np.float64)

    def _numbers(self, key: str, name: str, count: int) -> Float64:
        return self._finite(self._member(key).get(name), count, f"{key}.{name}")

    def _ramps(self, key: str, channels: int) -> Float64:
        """(channels, 256) linear ranges of version 1."""
        low, high = self._numbers(key, "mins", channels), self._numbers(key, "maxs", channels)
        return low[:, None] + (high - low)[:, None] * (np.arange(LEVELS) / (LEVELS - 1.0))

    def _codebook(self, key: str) -> Float64:
        """(256,) codebook of version 2; what a short one lacks is NaN, so that those rows fall out."""
        values = self._member(key).get("codebook")
        if not isinstance(values, list) or not 1 <= len(values) <= LEVELS:
            raise self._fault(f"must list 1 to {LEVELS} numbers", f"{key}.codebook")
        values = list(values)
        if values[0] is None and len(values) == LEVELS:
            # Early splat-transform lost the first entry; PlayCanvas's engine extends the codebook downwards.
            rest = self._finite(values[1:], LEVELS - 1, f"{key}.codebook")
            values[0] = float(rest[0] + (rest[0] - rest[-1]) / (LEVELS - 1))
            self._repairs.append(Repair("codebook_entry", 1, f"first entry of the {key} codebook was lost"))
        table = np.full(LEVELS, np.nan)
        table[: len(values)] = self._finite(values, len(values), f"{key}.codebook")
        return table

    def _palette(self, codebooks: bool) -> Palette:
        if codebooks:
            member = self._member("shN")
            bands = self._integer(member.get("bands"), "shN.bands") or None  # gsbox wrote 0
            if bands and bands not in REST_COEFFICIENTS:
                raise self._fault(f"{bands} bands, expected 1 to 3", "shN.bands")
            said = member["count"] if "count" in member else member.get("palette_size")  # LichtFeld's name for it
            count = self._integer(said, "shN.count")
            if not 1 <= count <= MAX_PALETTE:
                raise self._fault(f"{count} code vectors, expected 1 to {MAX_PALETTE}", "shN.count")
            return Palette(bands, count, self._codebook("shN"))
        member = self._member("shN")
        ends = self._finite([member.get("mins"), member.get("maxs")], 2, "shN.mins, shN.maxs")
        return Palette(None, None, np.linspace(ends[0], ends[1], LEVELS))
