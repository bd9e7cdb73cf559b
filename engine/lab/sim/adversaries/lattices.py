"""One copy in floats of an original that was coarser: values of a codebook or lattice show behind the mark.

Where the original's sizes come from a few hundred values, a copy moved by one step either way has twice as many, in
pairs of about equal count. Once the sizes and their step are known, so is the step of the centers, whose ratio is in
the program; of eight places that a center may have come from, the original lattice of the format tells the right one.
"""

from collections.abc import Callable
from itertools import product

import numpy as np

from engine.errors import InputError
from engine.lab.sim.adversaries.algebra import cells_of_remainders
from engine.lab.sim.attack import Attacks
from engine.model import SH_C0, Bool, Float64, GaussianModel, Int64
from engine.numerics.similarity import quaternion_to_rotation
from engine.watermark.grain import units

ATTACKS: Attacks[GaussianModel] = Attacks("model")

PARTS = ("all", "geometry", "colors")
NOISE = 1e-6  # rounding of a log scale in floats
VALUES = 4096  # distinct log scales of a codebook behind a mark at most
EVEN = 5.0  # standard deviations by which the counts of a pair may differ
STEPS_SPZ = tuple(2.0**-bits for bits in range(8, 23))  # of a center, units: .spz, coarsest first
LEVELS_SOG = 65535  # steps of a center's signed logarithm in .sog
NEAR = 0.03  # of a step: a place nearer to a lattice point lies on it
SAMPLE = 2000
ENDS = 3  # Gaussians at either end of an axis among which the end of its lattice is looked for
ON_LATTICE = 0.8  # share of a sample that must lie on a lattice which is there
SIGNS = np.array(list(product((-1.0, 1.0), repeat=3)))  # (8, 3)


@ATTACKS.add("round values back to the codebook or lattice behind them", "what is rounded", "all", PARTS)
def lattice(model: GaussianModel, strength: str, rng: np.random.Generator) -> GaussianModel:
    """Sizes to the middles of their pairs, centers to the lattice of .spz or .sog, colors to bytes, cell by cell.

    An attribute behind which nothing is found stays as it is. InputError where `strength` is not one of the parts.
    """
    if strength not in PARTS:
        raise InputError(f"what is rounded must be one of {', '.join(PARTS)}, got {strength!r}")
    if strength != "colors":
        model = _geometry(model, rng)
    return model if strength == "geometry" else model.with_dc(_bytes(model.sh[:, 0].astype(np.float64)))


def _geometry(model: GaussianModel, rng: np.random.Generator) -> GaussianModel:
    from engine.flows.embed.profiles import profile

    found = pair_values(model.log_scales.astype(np.float64))
    if found is None:
        return model
    log_scales, step = found
    sized = model.with_(log_scales=log_scales.astype(np.float32))
    plan = profile("balanced").plan
    ratio = plan.grain_center / plan.grain_scale if plan.grain_scale else 0.0
    moves = SIGNS[:, None] * (ratio * step * units(sized.log_scales))  # (8, N, 3) along the own axes
    places = model.means + np.einsum("nij,snj->sni", quaternion_to_rotation(model.quats), moves)  # (8, N, 3)
    return sized.with_(means=_on_lattice(places, rng).astype(np.float32))


def pair_values(values: Float64) -> tuple[Float64, float] | None:
    """Values (N, D) at the middle of their pairs, and the step from there; None where they come in no pairs."""
    order = np.argsort(values, axis=None, kind="stable")
    flat = values.reshape(-1)[order]
    group = np.cumsum(np.r_[0, np.diff(flat) > NOISE])
    counts = np.bincount(group)
    if not 2 <= len(counts) <= min(VALUES, len(flat) // 16):
        return None
    distinct = np.bincount(group, flat) / counts
    apart = distinct[None] - distinct[:, None]
    low, high = np.nonzero((apart > 4 * NOISE) & (apart < 0.5) & _even(counts))
    if not len(low):
        return None
    # The step is a distance that most values have to a partner; a codebook's own distances are those of few.
    gaps = apart[low, high]
    ranked = np.argsort(gaps)
    bins = np.cumsum(np.r_[0, np.diff(gaps[ranked]) > NOISE])
    score = np.bincount(bins, np.minimum(counts[low], counts[high])[ranked])
    enough = np.flatnonzero(2.0 * score >= ON_LATTICE * len(flat))
    if not len(enough):
        return None
    best = ranked[bins == enough[0]]  # on an even lattice, steps beyond the nearest value fit as well
    step = float(np.median(gaps[best])) / 2.0
    middle = distinct.copy()
    taken = np.zeros(len(distinct), dtype=bool)
    for a, b in sorted(zip(low[best].tolist(), high[best].tolist(), strict=True)):
        if not taken[a] and not taken[b]:
            middle[[a, b]] = (distinct[a] + distinct[b]) / 2.0
            taken[[a, b]] = True
    out = np.empty_like(flat)
    out[order] = middle[group]
    return out.reshape(values.shape), step


def _even(counts: Int64) -> Bool:
    """(M, M) whether two counts are halves of one, up to chance."""
    return np.asarray(np.abs(counts[:, None] - counts[None]) < EVEN * np.sqrt(counts[:, None] + counts[None]))


def _on_lattice(places: Float64, rng: np.random.Generator) -> Float64:
    """Of eight places (8, N, 3) each, the point (N, 3) of the lattice that one lies on; where none does, the middle.

    An axis without a lattice has no say, and keeps its coordinate of the place that the others chose.
    """
    shown = places[:, rng.permutation(places.shape[1])[:SAMPLE]]
    axes = [_axis(places[..., axis], shown[..., axis]) for axis in range(3)]
    snapped = places.copy()
    missed = np.zeros(places.shape[:2])  # (8, N)
    for number, axis in enumerate(axes):
        if axis is not None:
            index = axis[0](places[..., number])
            missed = np.maximum(missed, np.abs(index - np.round(index)))
            snapped[..., number] = axis[1](np.round(index))
    if not missed.any():
        return np.asarray(places.mean(axis=0))
    best, rows = missed.argmin(axis=0), np.arange(places.shape[1])
    snapped = snapped[best, rows]
    return np.asarray(np.where((missed[best, rows] < NEAR)[:, None], snapped, places.mean(axis=0)))


Axis = tuple[Callable[[Float64], Float64], Callable[[Float64], Float64]]
"""Coordinates to numbers of lattice points, and back."""


def _axis(places: Float64, shown: Float64) -> Axis | None:
    """The lattice of one axis, from eight places (8, N) each; None where most of those shown (8, n) lie on none."""

    def share(x: Float64) -> float:
        return float((np.abs(x - np.round(x)).min(axis=0) < NEAR).mean())

    even = next((power for power in STEPS_SPZ if share(shown / power) > ON_LATTICE), 0.0)
    if even:
        return lambda x: x / even, lambda n: n * even
    logs = np.sign(shown) * np.log1p(np.abs(shown))
    order = np.argsort(places.mean(axis=0))
    ends = [places[:, part].reshape(-1) for part in (order[:ENDS], order[-ENDS:])]
    best, low, size = 0.0, 0.0, 1.0
    for a, b in product(*(np.sign(end) * np.log1p(np.abs(end)) for end in ends)):
        step = (b - a) / LEVELS_SOG
        if step > 0.0 and (found := share((logs - a) / step)) > best:
            best, low, size = found, float(a), float(step)
    if best < ON_LATTICE:
        return None

    def back(n: Float64) -> Float64:
        log = low + n * size
        return np.asarray(np.sign(log) * np.expm1(np.abs(log)))

    return lambda x: (np.sign(x) * np.log1p(np.abs(x)) - low) / size, back


def _bytes(dc: Float64) -> Float64:
    """DC (N, 3) without the remainders modulo a byte that cells share; as it is where there are none."""
    codes = (dc * SH_C0 + 0.5) * 255.0
    if cells_of_remainders(codes - np.floor(codes)) is None:
        return dc
    return np.asarray((np.round(codes) / 255.0 - 0.5) / SH_C0)
