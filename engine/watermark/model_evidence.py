"""From a registered suspect model to one displacement estimate per chip (DESIGN 4.8, paper Eq 10 and 11)."""

from dataclasses import dataclass, replace

import numpy as np

from engine.model import Bool, Float32, Float64, Int32, Int64
from engine.registration.mixtures import Mixtures
from engine.watermark.code_shares import CodeShares, combined
from engine.watermark.config import CONFIG
from engine.watermark.layout import Layout

_CONFIG = CONFIG.evidence


@dataclass(frozen=True, eq=False)
class Evidence:
    """What one suspect says about each chip; made without looking at any chip (DESIGN 4.9)."""

    y: Float64  # (C,) estimated displacement of each code vector along each carrier
    weights: Float64  # (C,) non-negative weights: expected displacement over variance, less where |y| stands out
    signal: Float64  # (C,) size of y to expect if the mark is there, in the units of y
    # (C,) the weights of what was measured on Gaussians before they fall with |y|: a thief who pushes a chip far makes
    # it say nothing; None of pictures
    linear: Float64 | None = None
    # (N, 3) each: what every picture says of the Gaussians' colours, from which another copy's cells can be read
    pulled: tuple[Float32, ...] = ()
    # (M, D) of each stage, of a model: how far each code vector as a whole seems to be displaced (Eq 10's c' - c)
    differences: tuple[Float64, ...] = ()

    @property
    def evidence(self) -> Float64:
        """(C,) w y: what each chip's sign is multiplied with."""
        return self.weights * self.y

    def part(self, chips: slice) -> tuple[Float64, Float64, Float64]:
        """y, weights and signal of some of the chips."""
        return self.y[chips], self.weights[chips], self.signal[chips]

    def behind(self, chips: int) -> "Evidence":
        """The evidence without the first so many chips."""
        return Evidence(*self.part(slice(chips, None)))

    def sized(self, sizes: Float32 | None) -> "Evidence":
        """The evidence of chips of these sizes (C,): each counts, and is expected, by as much more or less.

        Sizes come from streams of their own, so nothing here knows a sign.
        """
        if sizes is None:
            return self
        linear = None if self.linear is None else self.linear * sizes
        return replace(self, weights=self.weights * sizes, signal=self.signal * sizes, linear=linear)

    def unsaturated(self) -> "Evidence | None":
        """The same, each chip counted by what it says however far it was pushed; None where there is no such
        reading."""
        return None if self.linear is None else replace(self, weights=self.linear)

    def plus(self, other: "Evidence") -> "Evidence":
        """Both together, the other on the first of these chips: what each says of a chip is added, so that every secret
        sign still enters once.
        """
        first = np.zeros((2, len(self.y)))
        first[:, : len(other.y)] = other.evidence, other.weights * other.signal
        signal = self.weights * self.signal + first[1]
        return Evidence(self.evidence + first[0], np.ones(len(self.y)), signal, pulled=self.pulled + other.pulled)

    def then(self, other: "Evidence") -> "Evidence":
        """Evidence on more chips: these, the other's behind."""
        y, weights = np.concatenate([self.y, other.y]), np.concatenate([self.weights, other.weights])
        signal = np.concatenate([self.signal, other.signal])
        linear = None
        if self.linear is not None and other.linear is not None:
            linear = np.concatenate([self.linear, other.linear])
        return Evidence(y, weights, signal, linear, differences=self.differences)


def remove_affine_color(reference: Float64, residual: Float64, weights: Float64) -> Float64:
    """(n, 3) residual minus its best global affine function of the reference colour (gain, tint, exposure).

    The residual (n, 3) is the suspect's DC minus the reference's; weights (n,).
    """
    n = len(reference)
    if n < 16:
        return residual
    step = max(1, n // _CONFIG.affine_sample)
    design = np.concatenate([reference, np.ones((n, 1))], axis=1)
    x, r, base = design[::step], residual[::step], weights[::step]
    fit = np.zeros((4, 3))
    for _ in range(8):  # iteratively re-weighted least squares, Geman-McClure weights
        gap = np.linalg.norm(r - x @ fit, axis=1)
        scale = max(1.5 * float(np.median(gap)), CONFIG.planning.mark_scale)
        w = base / (1.0 + (gap / scale) ** 2) ** 2
        normal = (x * w[:, None]).T @ x + 1e-9 * w.sum() * np.eye(4)
        fit = np.linalg.solve(normal, (x * w[:, None]).T @ r)
    return np.asarray(residual - design @ fit)


@dataclass(frozen=True, eq=False)
class Residual:
    """How far the colours of suspect Gaussians lie from those they are matched to: copies of an asset share it."""

    values: Float64  # (n, D)
    trust: Float64  # (n,)
    # (E,) each: which of the n a share of which reference Gaussian is in, and that share
    rows: Int64
    reference_rows: Int32
    shares: Float64


def compare_colors(reference_dc: Float32, suspect_dc: Float32, mixtures: Mixtures) -> Residual:
    """Differences of colours, without what a global change of them explains.

    Parameters
    ----------
    reference_dc : (N, D) float32
        Colours of the unmarked reference: DC, or all coefficients where the layout's carriers span them; of these, as
        many as the suspect has.
    suspect_dc : (n, D) float32
        Those of the suspect, turned as the reference lies.
    mixtures : Mixtures
        Which reference Gaussians each suspect Gaussian is made of; of plain matches, of one.
    """
    trusted = mixtures.explained()
    parts = np.flatnonzero(trusted[mixtures.suspect_rows])
    target, shares = mixtures.reference_rows[parts], mixtures.shares[parts]
    trusted[:] = False
    trusted[mixtures.suspect_rows[parts]] = True
    rows = np.flatnonzero(trusted)
    of = (np.cumsum(trusted) - 1)[mixtures.suspect_rows[parts]]  # row among those read
    reference = combined(of, target, shares, reference_dc, len(rows))  # what it would be, unmarked
    residual = suspect_dc[rows].astype(np.float64) - reference
    trust = mixtures.quality[rows].astype(np.float64)
    residual[:, :3] = remove_affine_color(reference[:, :3], residual[:, :3], trust)
    size = np.linalg.norm(residual, axis=1)
    scale = max(2.0 * float(np.median(size)) if len(size) else 0.0, 2.0 * CONFIG.planning.mark_scale)
    return Residual(residual, trust / (1.0 + (size / scale) ** 2), of, target, shares)


def gather_residual(layout: Layout, found: Residual) -> Evidence:
    """Displacement of every code vector along every carrier, "inverse SVD" of Eq 10 with Eq 11's compensation."""
    residual, trust, count = found.values, found.trust, len(found.values)
    shares = found.shares
    if layout.multiples is not None:
        shares = shares * layout.multiples[found.reference_rows]
    stages = [
        CodeShares(found.rows, stage[found.reference_rows], shares, (count, codes))
        for stage, codes in zip(layout.labels, layout.codes, strict=True)
    ]
    means, left = _take_turns(stages, residual, trust)
    if len(found.rows) > count:
        # Plain matches err each by itself. Mixtures err in what they are made of, too, and those that share a patch err
        # together: what they have in common is no excuse for them.
        left = residual
    y, variance = [], []
    for mean, stage, direction in zip(means, stages, layout.directions, strict=True):
        along = direction[:, : residual.shape[1]].T
        y.append((mean @ along).reshape(-1))
        variance.append(stage.variance(left @ along, trust).reshape(-1))
    weighed = _weigh(np.concatenate(y), np.concatenate(variance), layout.amplitudes, len(layout.directions[0]))
    return replace(weighed, differences=tuple(means))


def _take_turns(stages: list[CodeShares], residual: Float64, trust: Float64) -> tuple[list[Float64], Float64]:
    """Displacements (codes, D) of each stage's code vectors, and what they leave of the residuals (n, D)."""
    means = [np.zeros((stage.codes, residual.shape[1])) for stage in stages]
    explained = [np.zeros_like(residual) for _ in stages]
    left = residual
    for _ in range(_CONFIG.passes if len(stages) > 1 else 1):  # Eq 11: each stage sees what the others leave over
        for s, stage in enumerate(stages):
            left = left + explained[s]
            means[s] = stage.means(left, trust)
            explained[s] = stage.explained(means[s], left, trust)
            left = left - explained[s]
    return means, left


def _weigh(y: Float64, variance: Float64, amplitudes: Float64, carriers: int) -> Evidence:
    seen = np.isfinite(variance)
    # Registration, quantization and cleaning of the model leave errors that the members share and that their own
    # spread does not show. How large means are shows it; and no mean is trusted beyond the mark's own size, so that
    # this layer drowns neither the other nor the other routes.
    variance = np.where(seen, variance, 1.0) + amplitudes**2 + _shared(y, seen, carriers) + 1e-12
    weights = np.where(seen, amplitudes / variance, 0.0)
    y = np.where(seen, y, 0.0)
    return Evidence(y, _saturated(y, weights, carriers), np.where(seen, amplitudes, 0.0), weights)


def _shared(y: Float64, seen: Bool, carriers: int) -> Float64:
    """(C,) robust variance of the means of each carrier, whatever it comes from."""
    pairs = zip(np.square(y).reshape(-1, carriers).T, seen.reshape(-1, carriers).T, strict=True)
    usual = [float(np.median(squares[use])) / 0.455 if use.any() else 0.0 for squares, use in pairs]
    return np.tile(usual, len(y) // carriers)


def _saturated(y: Float64, weights: Float64, carriers: int) -> Float64:
    """(C,) weights such that w y = limit tanh(w0 y / limit): they know the size of y, not its sign, so no chip."""
    shown = np.abs(weights * y).reshape(-1, carriers)  # (codes, R)
    limits = np.array([np.median(column[column > 0]) if column.any() else 1.0 for column in shown.T])
    ratio = np.maximum(shown / (_CONFIG.saturation * limits), 1e-9)  # tanh(u) / u is 1 there
    return np.asarray(weights * (np.tanh(ratio) / ratio).reshape(-1))
