"""Which reference Gaussian each suspect Gaussian is, once the similarity between the two models is known.

Position alone does not tell: noise of a tenth of the spread takes a Gaussian past thousands of others. So the
match is made in position, size, opacity, base colour and rotation together, each measured in its own expected
error, and these errors are learnt from the matches. No secret of the mark enters.
"""

# mypy: allow-untyped-defs

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.kernels.jit import parallel_kernel, share_of
from engine.model import Float32, Float64, GaussianModel, Int32
from engine.numerics.chi_square import chi_square_beyond
from engine.numerics.nearest import Neighbors, WhitenedGrid
from engine.numerics.similarity import quaternion_product, rotation_to_quaternion
from engine.numerics.umeyama import Similarity
from engine.registration.config import CONFIG

LOGIT_CLIP, FLATNESS_CLIP = CONFIG.looks.logit_clip, CONFIG.looks.flatness_clip
DC_CLIP = 1.772
"""DC of the colours 0 and 1: trade formats with 8-bit colours hold no more."""
HARD = 6
"""Position and size come first in a joint vector; opacity and colour, which owners retouch, follow."""


@dataclass(frozen=True, eq=False)
class Deviations:
    """Expected error (standard deviation) of each attribute of a matched Gaussian, and the colour change.

    Parameters
    ----------
    position : (3,) float64
        Along the reference's axes, scene units.
    size : (3,) float64
        Of the sorted log scales.
    opacity : float
        Of the logit.
    color : (3,) float64
        Of the DC coefficients, after gain and offset.
    rotation : float
        About one axis, radians; infinity if rotations tell nothing.
    gain, offset : (3,) float64
        Reference DC = gain * suspect DC + offset: a global change of tint or exposure.
    smallest : float
        Log scale, in the reference's frame, below which sizes do not differ: a format clips there. Minus infinity
        where none does.
    """

    position: Float64
    size: Float64
    opacity: float
    color: Float64
    rotation: float
    gain: Float64
    offset: Float64
    smallest: float = -np.inf

    @property
    def sigmas(self) -> Float32:
        """(10,) the errors in the order of `joint_vectors`."""
        return np.concatenate([self.position, self.size, [self.opacity], self.color]).astype(np.float32)

    @property
    def noisy(self) -> bool:
        """Whether sizes are off by more than any trade format's rounding, so that noise was added to all."""
        return bool(self.size.max() > 0.08)

    def much_above(self, other: "Deviations", factor: float) -> bool:
        """Whether some error is more than `factor` times that of `other`."""
        mine = np.append(self.sigmas, self.rotation)
        theirs = np.append(other.sigmas, other.rotation)
        tint = np.abs(self.gain - other.gain) + np.abs(self.offset - other.offset)
        return bool((mine > factor * theirs).any() or (tint > factor * other.color).any())


def floor_deviations(extent: float) -> Deviations:
    """What re-export through lossy formats and a mark cost at most; nothing is measured finer than this.

    Steps of the trade formats: positions 16 to 24 bits of the extent, log scales 1/16, opacity and colour 8
    bits, quaternions 8 to 10 bits. A mark moves DC by 0.01 to 0.05.
    """
    return Deviations(
        np.full(3, 2e-4 * extent), np.full(3, 0.05), 0.15, np.full(3, 0.05), 0.03, np.ones(3), np.zeros(3)
    )


@parallel_kernel
def _joint(means, log_scales, logits, sh, turn, shift, log_scale, gain, offset, smallest, inverse, out, call):
    for i in share_of(len(means), call):
        for a in range(3):
            x = shift[a]
            for b in range(3):
                x += turn[a, b] * means[i, b]
            out[i, a] = x * inverse[a]
            dc = min(max(sh[i, 0, a], -DC_CLIP), DC_CLIP)
            out[i, 7 + a] = (gain[a] * dc + offset[a]) * inverse[7 + a]
        s0, s1, s2 = log_scales[i, 0], log_scales[i, 1], log_scales[i, 2]
        top = max(s0, max(s1, s2))
        bottom = min(s0, min(s1, s2))
        middle = s0 + s1 + s2 - top - bottom
        least = max(top - FLATNESS_CLIP + log_scale, smallest)
        out[i, 3] = max(bottom + log_scale, least) * inverse[3]
        out[i, 4] = max(middle + log_scale, least) * inverse[4]
        out[i, 5] = max(top + log_scale, least) * inverse[5]
        out[i, 6] = min(max(logits[i], -LOGIT_CLIP), LOGIT_CLIP) * inverse[6]


def joint_vectors(
    model: GaussianModel, fit: Similarity, deviations: Deviations, center: Float64, *, suspect: bool = True
) -> Float32:
    """(n, 10) float32: position (about `center`, for the sake of float32), sorted log scales, opacity logit and DC,
    each over its expected error; `fit` takes the model into the reference's frame, the colour change applies to a
    `suspect` only."""
    gain, offset = (deviations.gain, deviations.offset) if suspect else (np.ones(3), np.zeros(3))
    vectors = np.empty((len(model), 10), np.float32)
    _joint(
        model.means,
        model.log_scales,
        model.opacity_logits,
        model.sh,
        fit.scale * fit.R,
        fit.t - center,
        np.log(fit.scale),
        gain,
        offset,
        deviations.smallest,
        1.0 / deviations.sigmas.astype(np.float64),
        vectors,
    )
    return vectors


def joint_pairs(
    reference: GaussianModel, suspect: GaussianModel, fit: Similarity, deviations: Deviations
) -> tuple[Float32, Float32]:
    """`joint_vectors` of Gaussians that are each other's partners, row for row."""
    origin = np.zeros(3)
    own = joint_vectors(reference, Similarity.identity(), deviations, origin, suspect=False)
    return own, joint_vectors(suspect, fit, deviations, origin)


def log_sizes(suspect: GaussianModel, fit: Similarity) -> Float64:
    """(M,) log of the largest scale, in the reference's frame."""
    return np.asarray(suspect.log_scales.max(axis=1).astype(np.float64) + np.log(fit.scale))


def clipped_at(reference: GaussianModel, suspect: GaussianModel, fit: Similarity) -> float:
    """Log scale in the reference's frame below which sizes were clipped, minus infinity where nothing is lost.

    SPZ holds no log scale below -10 and a scene made small has many: whatever clips them, the suspect's smallest is
    what is left of all that were smaller.
    """
    smallest = float(suspect.log_scales.min()) + float(np.log(fit.scale))
    below = float(np.logical_or.reduce((reference.log_scales < smallest).T).mean())
    return smallest if below > CONFIG.confirmation.clipped else -np.inf


def turned_quats(quats: Float32, fit: Similarity) -> Float32:
    """Quaternions in the reference's frame, float32."""
    if np.array_equal(fit.R, np.eye(3)):
        return quats
    turned: Float32 = quaternion_product(rotation_to_quaternion(fit.R), quats).astype(np.float32)
    return turned


class Matcher:
    """The reference laid out for matching at given deviations."""

    def __init__(self, reference: GaussianModel, deviations: Deviations) -> None:
        self.deviations = deviations
        self.center: Float64 = np.median(reference.means[:: max(1, len(reference) // 20000)], axis=0).astype(float)
        vectors = joint_vectors(reference, Similarity.identity(), deviations, self.center, suspect=False)
        weight = deviations.rotation**-2 if np.isfinite(deviations.rotation) else 0.0
        dims = vectors.shape[1] + (3 if weight > 0 else 0)
        self.limit2 = chi_square_beyond(dims, 1e-3)
        self.basis: Float32 | None = None
        hard, cap = HARD, 0.6 * self.limit2
        if deviations.noisy:
            # Every attribute counts in full, and the grid stands on the directions of greatest spread.
            sample = vectors[:: max(1, len(vectors) // 20_000)].astype(np.float64)
            _, turn = np.linalg.eigh(np.cov(sample.T))
            self.basis = np.ascontiguousarray(turn[:, ::-1].astype(np.float32))
            vectors = vectors @ self.basis
            hard, cap = vectors.shape[1], 0.0
        # Else colour and opacity may be retouched on single Gaussians: at most they use up 0.6 of the limit.
        self.grid = WhitenedGrid(vectors, reference.quats, quat_weight=weight, hard=hard, soft_cap=cap)

    def match(self, suspect: GaussianModel, fit: Similarity, deviations: Deviations | None = None) -> Neighbors:
        """The reference Gaussian of each suspect Gaussian under a similarity.

        The errors are those the matcher was made for; of `deviations` only the colour change is used.
        """
        use = self.deviations
        if deviations is not None:
            use = replace(use, gain=deviations.gain, offset=deviations.offset)
        vectors = joint_vectors(suspect, fit, use, self.center)
        if self.basis is not None:
            vectors = vectors @ self.basis
        # 3.2 standard deviations in five coordinates hold 99.3 % of the true partners.
        return self.grid.query(vectors, turned_quats(suspect.quats, fit), box=3.2, limit2=self.limit2)

    def quality(self, neighbors: Neighbors) -> Float32:
        """(M,) trust 0..1: the chance that the nearest is the right one, fading out towards the limit."""
        usual = chi_square_beyond(self.grid.points.shape[1] + (3 if self.grid.quat_weight > 0 else 0), 0.5)
        fade = (self.limit2 - neighbors.distance2) / (self.limit2 - usual)
        trust: Float32 = (neighbors.probability * np.clip(fade, 0.0, 1.0)).astype(np.float32)
        return trust

    def pair(
        self, suspect: GaussianModel, fit: Similarity, deviations: Deviations | None = None
    ) -> tuple[Int32, Float32]:
        """(M,) reference Gaussian of each suspect Gaussian, -1 where there is none, and the trust in it, 0 to 1."""
        neighbors = self.match(suspect, fit, deviations)
        quality = self.quality(neighbors)
        return np.where(quality > 0, neighbors.index, -1).astype(np.int32), quality


def estimate_deviations(
    reference: GaussianModel,
    suspect: GaussianModel,
    pairs: tuple[npt.NDArray[Any], npt.NDArray[Any]],
    fit: Similarity,
    floor: Deviations,
) -> Deviations:
    """Robust errors of matched pairs (reference and suspect index, most of them right), nothing below `floor`."""
    unit = Deviations(np.ones(3), np.ones(3), 1.0, np.ones(3), 1.0, np.ones(3), np.zeros(3), floor.smallest)
    ref, sus = reference.take(pairs[0]), suspect.take(pairs[1])
    a, b = (vectors.astype(np.float64) for vectors in joint_pairs(ref, sus, fit, unit))
    gain, offset = _tint(b[:, 7:], a[:, 7:])
    b[:, 7:] = gain * b[:, 7:] + offset
    sigma = np.maximum(1.4826 * np.median(np.abs(a - b), axis=0), floor.sigmas)
    dot = np.abs((ref.quats * turned_quats(sus.quats, fit)).sum(1)).clip(0, 1)
    angle = 2.0 * np.arccos(dot)
    rotation = max(float(np.median(angle)) / 1.538, floor.rotation)  # median length of a 3-D normal
    return Deviations(
        position=sigma[:3],
        size=sigma[3:6],
        opacity=float(sigma[6]),
        color=sigma[7:],
        rotation=rotation if rotation < 0.5 else np.inf,  # random rotations have a median angle of 2.3
        gain=gain,
        offset=offset,
        smallest=floor.smallest,
    )


def estimate_wide(
    reference: GaussianModel,
    suspect: GaussianModel,
    pairs: tuple[npt.NDArray[Any], npt.NDArray[Any]],
    fit: Similarity,
    floor: Deviations,
) -> Deviations:
    """As `estimate_deviations`, where the errors of position differ among the pairs: the larger ones count."""
    measured = estimate_deviations(reference, suspect, pairs, fit, floor)
    error = np.abs(fit.apply(suspect.means[pairs[1]]) - reference.means[pairs[0]])
    wide = np.quantile(error, 0.9, axis=0) / 1.645  # nine in ten of a normal error are smaller
    return replace(measured, position=np.maximum(measured.position, wide))


def _tint(suspect: Float64, reference: Float64) -> tuple[Float64, Float64]:
    """Robust gain and offset per channel; gain 1 and offset 0 where no change is evident."""
    gain, offset = np.ones(3), np.zeros(3)
    for c in range(3):
        x, y = suspect[:, c], reference[:, c]
        plain = 1.4826 * float(np.median(np.abs(y - x)))
        use = np.abs(x) < DC_CLIP - 0.01
        if use.sum() < 50 or np.std(x[use]) < 1e-3:
            continue
        weights = np.ones(len(x)) * use
        slope, level = 1.0, float(np.median(y - x))
        for _ in range(8):
            total = weights.sum()
            mx, my = weights @ x / total, weights @ y / total
            slope = float(weights @ ((x - mx) * (y - my)) / max(weights @ np.square(x - mx), 1e-12))
            level = float(my - slope * mx)
            error = np.abs(y - slope * x - level)
            cut = 4.685 * max(1.4826 * float(np.median(error)), 1e-3)
            weights = np.square(np.clip(1 - np.square(error / cut), 0, None)) * use
            if not weights.sum() > 0:
                break
        tinted = 1.4826 * float(np.median(np.abs(y - slope * x - level)))
        # A regression always fits a little better; a real change of tint fits much better.
        if 0.2 < slope < 5.0 and tinted < 0.7 * plain and plain > 0.01:
            gain[c], offset[c] = slope, level
    return gain, offset
