"""The lattices on which an original's values lie, and marked values put back on them (DESIGN 4.5).

A trained model that went through a byte format has few values of each attribute, or evenly spaced ones. A mark that
moved them in between would lie open: the distance to the nearest lattice value is the mark. So marked values lie on the
same lattice, by stochastic rounding whose dither follows from the key: on average each is where the plan wants it.

Lattices are found in the values themselves, column by column, since a file does not say through which formats it went:

- a *table*: few distinct values (codebooks of `.sog`);
- *even* steps, plain (bytes; 24-bit centres of `.spz`) or of sign(x) log(1 + |x|) (16-bit centres of `.sog`);
- *chunks*: even steps between the least and the largest of 256 rows in turn (compressed PLY);
- *segments*: even steps that change from some row to the next, where such files were cropped or several were merged.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from engine.model import Bool, Float32, Float64, GaussianModel
from engine.watermark.config import CONFIG
from engine.watermark.keys import uniform

_CONFIG = CONFIG.lattice
CHUNK = 256
"""Rows of a chunk."""
CHUNK_LEVELS = (2047, 1023, 255)
"""Steps between the least and the largest value of a chunk."""
ROUNDING = 16.0
"""Spacings of floats at a column's largest value by which values lie beside their steps from arithmetic alone."""


@dataclass(frozen=True, eq=False)
class Table:
    """The distinct values themselves, in order."""

    values: Float64  # (K,)

    def places(self, values: Float32) -> Float64:
        """(N,) where values lie: whole numbers on the lattice."""
        return np.asarray(np.interp(values, self.values, np.arange(len(self.values))))

    def inside(self, places: Float64) -> Bool:
        """(N,) places that a value may leave: all."""
        return np.ones(len(places), dtype=bool)

    def values_at(self, places: Float64) -> Float32:
        """(N,) values at whole places, the last one where a place is outside."""
        rows = np.clip(places, 0, len(self.values) - 1).astype(np.int64)
        return np.asarray(self.values[rows], dtype=np.float32)

    @property
    def step(self) -> float:
        """A usual step."""
        return float(np.median(np.diff(self.values))) if len(self.values) > 1 else 0.0


@dataclass(frozen=True, eq=False)
class Even:
    """Even steps, in the values or in their signed logarithm; in all of a column, or by chunks."""

    origin: Float64  # () or (N,)
    spacing: Float64  # () or (N,); 0 where a chunk has one value
    most: Float64  # () or (N,) last whole place; the first is 0
    logarithmic: bool = False
    known: Float32 = field(default_factory=lambda: np.empty(0, np.float32))  # distinct values in order, of no chunks

    def places(self, values: Float32) -> Float64:
        """As of `Table`."""
        at = _signed_log(values) if self.logarithmic else values.astype(np.float64)
        gap = at - self.origin
        return np.asarray(np.divide(gap, self.spacing, out=np.zeros_like(gap), where=self.spacing > 0))

    def inside(self, places: Float64) -> Bool:
        """As of `Table`: all but the ends, from which readers count."""
        return np.asarray((places > 0) & (places < self.most))

    def values_at(self, places: Float64) -> Float32:
        """As of `Table`; the original's own value, to the last bit, where it has one there."""
        at = self.origin + self.spacing * np.clip(places, 0, self.most)
        values = np.asarray(np.sign(at) * np.expm1(np.abs(at)) if self.logarithmic else at)
        if not len(self.known):
            return values.astype(np.float32)
        after = np.clip(np.searchsorted(self.known, values), 1, len(self.known) - 1)
        low, high = self.known[after - 1], self.known[after]
        nearest = np.where(values - low < high - values, low, high)
        same = np.rint(self.places(nearest)) == np.clip(places, 0, self.most)
        return np.where(same, nearest, values.astype(np.float32)).astype(np.float32)

    @property
    def step(self) -> float:
        """A usual step; of a logarithm that of small values."""
        return float(np.median(self.spacing))


Lattice = Table | Even


@dataclass(frozen=True, eq=False)
class Lattices:
    """Of each marked attribute, column by column; None where a column has none."""

    columns: dict[str, tuple[Lattice | None, ...]] = field(default_factory=dict)

    @property
    def there(self) -> bool:
        """Whether any column has one."""
        return any(each is not None for columns in self.columns.values() for each in columns)

    def step(self, name: str) -> float:
        """The usual step of an attribute's coarsest column, in its own units; 0 where values are free."""
        return max((each.step for each in self.columns.get(name, ()) if each is not None), default=0.0)

    def onto(self, original: GaussianModel, wanted: GaussianModel, subkey: bytes) -> GaussianModel:
        """The wanted model with every value that was moved on the original's lattice, on average where it was wanted.

        Parameters
        ----------
        original : GaussianModel
            In which the lattices were found.
        wanted : GaussianModel
            The same Gaussians, displaced.
        subkey : bytes
            32 bytes, from which the dither follows.
        """
        if not self.there:
            return wanted
        changed = {}
        for name, columns in self.columns.items():
            before, after = _columns(original, name), _columns(wanted, name)
            rounded = after.copy()
            for k, lattice in enumerate(columns):
                if lattice is not None:
                    dither = uniform(subkey, len(before), f"{name[:10]}{k}")
                    rounded[:, k] = _round(lattice, before[:, k], after[:, k], dither, LEAST_MOVE[name])
            changed[name] = rounded
        sh = wanted.sh.copy()
        sh[:, 0] = changed.get("dc", sh[:, 0])
        means, log_scales = changed.get("means", wanted.means), changed.get("log_scales", wanted.log_scales)
        return wanted.with_(means=means, log_scales=log_scales, sh=sh)


FREE = Lattices()
"""Values that may be moved anywhere."""


_GEOMETRY = _CONFIG.least_move_geometry
LEAST_MOVE = {"means": _GEOMETRY, "log_scales": _GEOMETRY, "dc": _CONFIG.least_move_color}


def _round(lattice: Lattice, before: Float32, after: Float32, dither: Float64, least: float) -> Float32:
    """(N,) values on a lattice; those that were moved by less than `least` steps, or are rounded to where they were,
    stay bit for bit. What a value lies beside its step, beyond rounding, it keeps: else moved values would show."""
    wanted, home = lattice.places(after), np.rint(lattice.places(before))
    places = np.floor(wanted + dither)
    moved = (after != before) & (places != home) & (np.abs(wanted - home) >= least) & lattice.inside(home)
    off = before - lattice.values_at(home)
    off[np.abs(off) <= ROUNDING * np.spacing(np.abs(before).max())] = 0.0
    return np.where(moved, lattice.values_at(places) + off, before).astype(np.float32)


def find_lattices(model: GaussianModel) -> Lattices:
    """The lattices on which centres, log scales and DC colours lie."""
    found = {name: tuple(_find(column) for column in _columns(model, name).T) for name in ("means", "log_scales", "dc")}
    return Lattices({name: columns for name, columns in found.items() if any(each is not None for each in columns)})


def _columns(model: GaussianModel, name: str) -> Float32:
    return model.sh[:, 0] if name == "dc" else getattr(model, name)


def _find(values: Float32) -> Lattice | None:
    """The lattice of one column (N,)."""
    values = np.ascontiguousarray(values)
    distinct = np.unique(values)
    if len(values) < _CONFIG.least_rows or len(distinct) < 2 or not np.isfinite(distinct).all():
        return None
    plain = _even(distinct.astype(np.float64))
    if plain is not None:
        return replace(plain, known=distinct)
    if len(distinct) <= _CONFIG.few * len(values):
        return Table(distinct.astype(np.float64))
    curved = _even(_signed_log(distinct))
    if curved is not None:
        return replace(curved, logarithmic=True, known=distinct)
    chunks = _chunks(values)
    if chunks is not None:
        return chunks
    exact, logs = values.astype(np.float64), _signed_log(values)
    ways = ((at, width, at is logs) for at in (exact, logs) for width in _CONFIG.windows)
    return next((found for way in ways if (found := _segments(*way)) is not None), None)


def _signed_log(values: Float32) -> Float64:
    exact = values.astype(np.float64)
    return np.asarray(np.sign(exact) * np.log1p(np.abs(exact)))


def _even(values: Float64) -> Even | None:
    """Even steps through distinct values in order, or None.

    The least gap is a step or a few: more and more gaps are held against it, and the step is fitted to all so far.
    """
    gaps = np.diff(values)
    finest = _CONFIG.finest * float(np.abs(values).max())
    clear = gaps[gaps > finest]
    if len(clear) < _CONFIG.least_rows // 2:
        return None
    least = float(clear.min())
    for parts in (1, 2, 3):
        step = _fitted(values, clear, least / parts)
        if step is None or step < finest:
            continue
        places = np.rint((values - values[0]) / step)
        slope, origin = np.polyfit(places, values, 1)
        return Even(np.asarray(origin), np.asarray(slope), np.asarray(places[-1]))
    return None


def _fitted(values: Float64, gaps: Float64, step: float) -> float | None:
    """A step that fits short gaps, then longer and longer stretches; None where it stops to fit."""
    reach = 8.0 * step
    for _ in range(64):
        near = gaps[gaps < reach]
        counts = np.rint(near / step)
        if not counts.sum() > 0:
            return None
        step = float(near.sum() / counts.sum())
        if reach > gaps.max():
            break
        reach *= 2.0
    stretch = 64  # gaps add up: each stretch tells the step so much better that the next can be counted
    while stretch < 4 * len(values):
        across = values[min(stretch, len(values) - 1) :] - values[: max(1, len(values) - stretch)]
        across = across[:: max(1, len(across) // 512)]
        counts = np.rint(across / step)
        if float(np.abs(across / step - counts).mean()) > 4.0 * _CONFIG.off:
            return None
        step = float(across.sum() / counts.sum())
        stretch *= 4
    return step


def _chunks(values: Float32) -> Even | None:
    """Even steps between the least and largest of CHUNK rows in turn, or None."""
    count = -(-len(values) // CHUNK)
    padded = np.concatenate([values, np.full(count * CHUNK - len(values), values[-1])]).reshape(count, CHUNK)
    low, high = padded.min(axis=1).astype(np.float64), padded.max(axis=1).astype(np.float64)
    wide = high - low
    inside = wide > 64.0 * np.spacing(np.maximum(np.abs(low), np.abs(high)).astype(np.float32))
    if inside.sum() < max(1, count // 2) or len(values) < CHUNK:
        return None
    share = (padded[inside] - low[inside, None]) / wide[inside, None]
    for levels in CHUNK_LEVELS:
        off = np.abs(levels * share - np.rint(levels * share))
        if float(off.mean()) < _CONFIG.off:
            spread = np.repeat(wide / levels, CHUNK)[: len(values)]
            origin = np.repeat(low, CHUNK)[: len(values)]
            return Even(origin, spread, np.full(len(values), float(levels)))
    return None


def _segments(at: Float64, width: int, logarithmic: bool = False) -> Even | None:
    """Even steps in `at` (N,), the values or their logarithm, that change between rows; or None.

    Rows that fit no segment's steps have none, and stay where they are.
    """
    starts = np.unique(np.linspace(0, max(0, len(at) - width), _CONFIG.probes).astype(np.int64))
    few = starts[:: _CONFIG.glance]  # enough where no window lies on any
    for probed, least in ((few, 1.0 / len(few)), (starts, _CONFIG.least_probes)):
        if np.mean([_steps(at[start : start + width]) is not None for start in probed]) < least:
            return None
    origin, spacing, most = np.zeros(len(at)), np.zeros(len(at)), np.zeros(len(at))
    start = 0
    while start + width <= len(at):
        found = _steps(at[start : start + width])
        length = 0 if found is None else _length(at[start:], width, *found)
        if found is None or length < width // 2:
            start += width // 8
            continue
        end = start + length
        places = (at[start:end] - found[0]) / found[1]
        whole = np.rint(places)
        on = np.abs(places - whole) < 2.0 * _CONFIG.off
        first, last = whole[on].min(), whole[on].max()
        origin[start:end] = found[0] + first * found[1]
        spacing[start:end], most[start:end] = np.where(on, found[1], 0.0), last - first
        start = end
    return Even(origin, spacing, most, logarithmic)


def _steps(at: Float64) -> tuple[float, float] | None:
    """Origin and spacing of even steps through a few values, or None."""
    even = _even(np.unique(at))
    if even is None:
        return None
    places = (at - even.origin) / even.spacing
    off = float(np.abs(places - np.rint(places)).mean())
    return (float(even.origin), float(even.spacing)) if off < _CONFIG.off else None


def _length(at: Float64, width: int, origin: float, spacing: float) -> int:
    """Rows from the first on, up to which most lie on these steps."""
    reach, width = width, width // 8
    while True:
        places = (at[:reach] - origin) / spacing
        misses = np.abs(places - np.rint(places)) > 2.0 * _CONFIG.off
        crowd = np.convolve(misses, np.ones(width), "valid") > width // 2
        if crowd.any():
            # From the first of the missing rows on
            begin = int(np.argmax(crowd))
            return max(1, begin + int(np.argmax(misses[begin:])))
        if reach >= len(at):
            return len(at)
        reach *= 4
