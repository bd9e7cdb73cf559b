"""Carrier directions: the SVD basis in which a code vector is displaced (paper Eq 6, DESIGN 4.5).

The basis comes from the **unmarked** codebook only: an extractor that keeps the mark's own U, V finds that mark in
anything. It spans the DC block: `.splat` drops the SH rest, SPZ and compressed PLY store it in 4 to 8 bits, bakes
and truncation remove it, so energy put there is paid for in decibels and lost as evidence. The paper takes all
coefficients, and so does `whole`.
"""

from dataclasses import dataclass

import numpy as np

from engine.model import SH_C0, Float32, Float64
from engine.watermark.config import CONFIG

LUMA = np.array([0.299, 0.587, 0.114]) / np.linalg.norm([0.299, 0.587, 0.114])
"""Direction of luma (BT.601) in RGB: what JPEG keeps best."""


CARRIERS = 3
"""Directions R: all that DC space has, and as many of a wider one."""


@dataclass(frozen=True, eq=False)
class Carriers:
    """Orthonormal directions (R, D), singular value order, and relative amplitudes (R,), norm 1; D is 3 in DC space, or
    3K of all coefficients."""

    directions: Float64
    amplitudes: Float64


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
