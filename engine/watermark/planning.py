"""The planner: how far each code vector may be displaced, and how many bits the scene then carries (DESIGN 4.5).

A code vector is displaced along carriers: the SVD basis (paper Eq 6) of the **unmarked** codebook only: an extractor
that keeps the mark's own U, V finds that mark in anything. It spans the DC block: `.splat` drops the SH rest, SPZ and
compressed PLY store it in 4 to 8 bits, bakes and truncation remove it, so energy put there is paid for in decibels and
lost as evidence. The paper takes all coefficients, and so does `whole`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.compress.hvq import Stage
from engine.compress.impact import Impact, uncertainty
from engine.errors import CapacityError
from engine.model import SH_C0, Float32, Float64, Int32
from engine.watermark.config import CONFIG
from engine.watermark.grain import ATTRIBUTES
from engine.watermark.layout import Layout

_CONFIG = CONFIG.planning


@dataclass(frozen=True)
class PlanConfig:
    """Knobs of the planner."""

    # Stages of the quantiser that carry the mark. One is best on real scenes: residual codes turn out coherent over
    # walls and fog, cost most of the PSNR budget there and outweigh everything else as evidence.
    stages: int = 1
    residual_share: float = 0.08  # with more stages: share of the mark's image energy in the residual ones, 0 to 1
    # Displacement grows with this power of a patch's texture (0: not at all). SSIM forgives texture.
    texture_exponent: float = 0.5
    balance_rounds: int = 12  # rounds that even out the mark's energy over the key views
    # A DC value that a larger share of the Gaussians, and far more than the values around it, have is not moved (see
    # `find_masses`); 1 moves all
    mass_share: float = 0.005
    # The second layer: how far a centre moves, in its Gaussian's own size, and a log scale; 0 leaves it out. Less where
    # that would show (see `layer_strengths`)
    grain_center: float = 0.05
    grain_scale: float = 0.02
    # Code vectors that the key makes of the public cells, two or more of these each; a power of two
    codes: int = 4096
    # Where copies differ: what share of the squared error is theirs. The rest is the owner's, alike in all
    # copies, and carries the claim; pictures need more of it
    copy_tint: float = 0.25
    copy_grain: float = 0.5
    # Amplitudes grow with this power of how badly a code vector's colour can be guessed from its surroundings
    surprise_exponent: float = 0.3


@dataclass(frozen=True, eq=False)
class Plan:
    """Layout with amplitudes, and chip energies (V, C): squared image displacement by view."""

    layout: Layout
    energies: Float64
    copies: Layout | None = None  # of what tells copies apart, where there is such a layer

    def times(self, factor: float) -> "Plan":
        """The plan at another strength."""
        copies = None if self.copies is None else scaled(self.copies, factor)
        return Plan(scaled(self.layout, factor), factor**2 * self.energies, copies)


def scaled(layout: Layout, factor: float) -> Layout:
    """A layout at another strength, with amplitudes as a record keeps them."""
    return replace(layout, amplitudes=(factor * layout.amplitudes).astype(np.float32).astype(np.float64))


def make_plan(
    stages: Sequence[Stage],
    impact: Impact,
    config: PlanConfig | None = None,
    emphasis: Float32 | Float64 | None = None,
    missed: Float64 | None = None,
    jitter: Callable[[int], Float64] | None = None,
    multiples: Float32 | None = None,
    *,
    whole: bool = False,
) -> Plan:
    """Carriers and relative amplitudes of every chip, from the unmarked model alone.

    Scaled to a median amplitude of `mark_scale`; `layer_strengths` finds the strength.

    Parameters
    ----------
    stages : sequence of Stage
        Quantiser of the unmarked model; at least stage 0.
    impact : Impact
        Over the key views.
    emphasis : (N,) float, optional
        Factor on the amplitude of each Gaussian's code vector, averaged over its members.
    missed : (M, 3, 3) float64, optional
        What the surroundings of each code vector of stage 0 leave unexplained of its colour, see `unexplained`.
    jitter : callable, optional
        From a number of chips to keyed factors on their amplitudes.
    multiples : (N,) float32, optional
        See `Layout`.
    whole : bool
        Carriers over all coefficients (the paper), not in DC alone. The mean square of every harmonic over all
        directions is that of DC, so energies are estimated alike.
    """
    config = config or PlanConfig()
    stages = stages[: config.stages]
    shown = impact.per_view if multiples is None else [view * multiples for view in impact.per_view]
    amplitudes, energies, directions = [], [], []
    for number, stage in enumerate(stages):
        count = len(stage.codebook)
        coverage = np.stack([np.bincount(stage.labels, view, count) for view in shown])  # (V, M)
        usage = coverage.sum(axis=0)
        # In the image a cell adds up over its members; a residual code's members are strangers to each other.
        reach = coverage if number == 0 else coverage * _incoherence(stage, impact, count)
        mask = visual_mask(stage, impact, usage, count, config)
        if emphasis is not None:
            members = np.maximum(np.bincount(stage.labels, minlength=count), 1)
            mask = mask * np.bincount(stage.labels, emphasis, count) / members
        if number == 0:
            mask = mask * _balance_views(reach * mask**2, config.balance_rounds)
        carriers = make_carriers(stage.codebook, usage, whole=whole)
        chip = mask[:, None] * carriers.amplitudes  # (M, R)
        if number == 0 and missed is not None:
            chip = chip * _surprise(missed, carriers, config.surprise_exponent)
        if jitter is not None:
            chip = chip * jitter(chip.size).reshape(chip.shape)
        energy = reach[:, :, None] * (SH_C0 * chip) ** 2  # (V, M, R)
        share = 1.0 - config.residual_share if number == 0 else config.residual_share / (len(stages) - 1)
        if len(stages) == 1:
            share = 1.0
        scale = share / max(float(energy.sum(axis=(1, 2)).mean()), 1e-300)
        amplitudes.append((np.sqrt(scale) * chip).reshape(-1))
        energies.append((scale * energy).reshape(len(energy), -1))
        directions.append(carriers.directions)
    flat = np.concatenate(amplitudes)
    scale = CONFIG.planning.mark_scale / max(float(np.median(flat)), 1e-300)
    layout = Layout(
        tuple(stage.labels for stage in stages),
        tuple(len(stage.codebook) for stage in stages),
        tuple(directions),
        (scale * flat).astype(np.float32).astype(np.float64),  # as the record keeps them
        multiples,
    )
    return Plan(layout, scale**2 * np.concatenate(energies, axis=1))


@dataclass(frozen=True, eq=False)
class Carriers:
    """Orthonormal directions (R, D), singular value order, and relative amplitudes (R,), norm 1; D is 3 in DC space, or
    3K of all coefficients."""

    directions: Float64
    amplitudes: Float64


def _surprise(missed: Float64, carriers: Carriers, exponent: float) -> Float64:
    """(M, R) factors on amplitudes: how badly the colour is guessed along each carrier, against what is usual; and
    less along carriers where colours hardly vary at all, see `PlanningConfig.hidden`."""
    directions = carriers.directions[:, :3]
    # Of a model in one colour nothing is missed, and rounding may make that less than nothing.
    off = np.sqrt(np.maximum(np.einsum("ri,mij,rj->mr", directions, missed, directions), 0.0))
    usual = np.maximum(np.median(off, axis=0), 1e-12)
    shown = carriers.amplitudes / usual
    most = np.minimum(1.0, _CONFIG.hidden * shown[0] / shown)
    return np.asarray(np.clip(off / usual, *_CONFIG.surprise) ** exponent * most)


def _incoherence(stage: Stage, impact: Impact, count: int) -> Float64:
    """(M,) sum of w^2 over sum of w: what is left of the image energy when members do not add up in one place."""
    squared = np.bincount(stage.labels, impact.squared, count)
    total = np.bincount(stage.labels, impact.coverage, count)
    return np.asarray(squared / np.maximum(total, 1e-12))


def visual_mask(stage: Stage, impact: Impact, usage: Float64, count: int, config: PlanConfig) -> Float64:
    """(M,) beta: textured patches hide more, and so do patches the views are uncertain about (rarely seen)."""
    texture = np.bincount(stage.labels, impact.busy, count) / np.maximum(usage, 1e-9)
    seen = usage > 0.01 * np.median(usage[usage > 0]) if (usage > 0).any() else usage > 0
    if not seen.any():
        return np.ones(count)
    texture = np.clip(texture / max(float(np.median(texture[seen])), 1e-12), 1e-3, 1e3) ** config.texture_exponent
    u = uncertainty(np.bincount(stage.labels, impact.squared, count).astype(np.float64))
    doubt = (u / np.median(u[seen])) ** 0.125
    return np.where(seen, np.clip(texture, 0.75, 1.5) * np.clip(doubt, 0.8, 1.25), 1.0)


def _balance_views(energy: Float64, rounds: int) -> Float64:
    """(M,) factors that bring the views' total energies together.

    The worst view limits the strength everywhere; a view with little energy reads badly from one image. Each
    code vector's factor is the mean of one multiplier per view, weighted by where the code vector is seen.
    """
    views = len(energy)
    share = energy / np.maximum(energy.sum(axis=0), 1e-300)  # (V, M)
    multiplier = np.ones(views)
    factor = np.ones(energy.shape[1])
    for _ in range(rounds):
        factor = np.clip(multiplier @ share, 0.35, 3.0)
        factor[energy.sum(axis=0) <= 0] = 1.0
        totals = energy @ factor
        multiplier *= (totals.mean() / np.maximum(totals, 1e-300)) ** 0.7
        multiplier = np.clip(multiplier, 1e-3, 1e3)
    return np.sqrt(factor)


def predict_z(energies: Float64, bit_of: Int32, bits: int) -> Float64:
    """(V, B) z of each bit, read from one picture of each key view through the reference channel.

    It is sqrt(E / sigma^2), saturating at the root of the number of chips the view shows (the statistic's own cap).

    Parameters
    ----------
    energies : (V, C)
        Of `Plan`, for a picture of `reference_pixels`.
    bit_of : (C,) int
    """
    out = np.empty((len(energies), bits))
    for v, energy in enumerate(energies):
        total = np.bincount(bit_of, energy, bits)
        squares = np.bincount(bit_of, energy**2, bits)
        signal = total / _CONFIG.reference_noise**2
        effective = total**2 / np.maximum(squares, 1e-300)  # chips that matter
        out[v] = np.sqrt(1.0 / (1.0 / np.maximum(signal, 1e-12) + 1.0 / np.maximum(effective, 1e-12)))
    return out


def predict_claim(energies: Float64, rehearsed: float = 0.0) -> float:
    """z of a claim from one own render of `reference_pixels`, at JPEG 10: the usual one of several that show the asset
    well; `energies` as of `predict_z`; `rehearsed`: that z, where it was read."""
    if rehearsed:
        return rehearsed
    return _CONFIG.claimed_render * float(predict_z(energies, np.zeros(energies.shape[1], dtype=np.int32), 1).mean())


def capacity_bits(energies: Float64, chips: int) -> int:
    """Bits the scene's pictures carry: the median one (see `predict_z`) must give every bit `bit_z`."""
    signal = energies.sum(axis=1) / _CONFIG.reference_noise**2
    effective = energies.sum(axis=1) ** 2 / np.maximum((energies**2).sum(axis=1), 1e-300)
    z_squared = 1.0 / (1.0 / np.maximum(signal, 1e-12) + 1.0 / np.maximum(effective, 1e-12))
    return int(min(float(np.median(z_squared)) / _CONFIG.bit_z**2, chips / _CONFIG.chips_per_bit))


def grain_capacity(gaussians: int) -> int:
    """Bits that the grain of so many Gaussians carries in a model."""
    return ATTRIBUTES * gaussians // _CONFIG.grain_chips_per_bit


def check_capacity(wanted: int, capacity: int) -> None:
    """Refuse a message the scene cannot carry (CapacityError names both numbers)."""
    if wanted > capacity:
        raise CapacityError(
            f"this scene carries {capacity} bits at this fidelity, {wanted} were requested; "
            "request fewer bits or a lower PSNR",
            wanted=wanted,
            capacity=capacity,
        )


LUMA = np.array([0.299, 0.587, 0.114]) / np.linalg.norm([0.299, 0.587, 0.114])
"""Direction of luma (BT.601) in RGB: what JPEG keeps best."""


CARRIERS = 3
"""Directions R: all that DC space has, and as many of a wider one."""


def make_carriers(
    codebook: Float32, usage: Float64, chroma_floor: float = CONFIG.planning.chroma_floor, *, whole: bool = False
) -> Carriers:
    """Right singular vectors of the usage-weighted codebook's DC block.

    The colours are taken as they show (0.5 + C0 c, uncentred), so the first direction has one sign throughout and lies
    near luma; signs are fixed (largest component positive) so that every machine gives the same signs.

    Parameters
    ----------
    codebook : (M, 3K) float32
        Unmarked code vectors.
    usage : (M,) float64
        How much of the images each code vector covers.
    chroma_floor : float
        See `PlanningConfig.chroma_floor`.
    whole : bool
        Of all coefficients, as the paper has it, instead of the DC block: the first CARRIERS singular vectors.
    """
    shown = SH_C0 * codebook[:, : codebook.shape[1] if whole else 3].astype(np.float64)
    shown[:, :3] += 0.5
    gram = (shown * (usage / max(usage.sum(), 1e-300))[:, None]).T @ shown  # V of the SVD, by its Gram matrix
    _, vectors = np.linalg.eigh(gram)
    directions = vectors[:, ::-1].T[:CARRIERS]
    signs = np.sign(directions[np.arange(CARRIERS), np.abs(directions).argmax(axis=1)])
    directions = directions * signs[:, None]
    amplitudes = np.maximum(np.abs(directions[:, :3] @ LUMA), chroma_floor)
    return Carriers(directions, amplitudes / np.linalg.norm(amplitudes))
