"""Hierarchical vector quantisation of the colours (DESIGN 4.4; paper: "semantic codebook", multi-stage).

Stage 0 is spatial-semantic: the code vector of a cell is the weighted mean SH of its members. Stages 1..S are
residual codebooks learnt with EMA k-means (decay 0.8) on a sample and assigned once by one BLAS product a chunk.
A Gaussian's colour is the sum of one code vector per stage; what is left over is its own residual.
"""

from dataclasses import dataclass

import numpy as np

from engine.compress.cells import cell_features, split_cells
from engine.kernels.jit import parallel_kernel, share_of
from engine.model import Bool, Float32, Float64, GaussianModel, Int32

Matrix = Float32 | Float64


@dataclass(frozen=True)
class HvqConfig:
    """Knobs of the quantiser."""

    cells: int = 32768  # code vectors of stage 0; a power of two, at most one for `min_members` Gaussians
    residual_codes: tuple[int, ...] = ()  # code vectors of each residual stage
    min_members: int = 2  # fewest Gaussians a cell should have on average
    decay: float = 0.8  # EMA decay lambda_d of the residual codebooks (paper: 0.8)
    # Weight of the high-frequency part of the error (Eq 7; paper's appendix: 0.1). No profile uses it: it buys nothing
    # (docs/RESULTS.md, ablation).
    lambda_freq: float = 0.0
    rounds: int = 12  # EMA rounds over the sample
    sample: int = 32768  # Gaussians that a residual codebook learns from
    seed: int = 0  # of the sample and the first codes


@dataclass(frozen=True, eq=False)
class Stage:
    """One stage: codebook (M, 3K) float32 and the code of each Gaussian, labels (N,) int32."""

    codebook: Float32
    labels: Int32

    def decode(self) -> Float32:
        """(N, 3K) the code vector of each Gaussian."""
        return self.codebook[self.labels]


def quantize(
    model: GaussianModel, weights: Float64, radius: float, config: HvqConfig | None = None, coarse: Bool | None = None
) -> tuple[Stage, ...]:
    """Learn all stages, stage 0 first.

    Parameters
    ----------
    weights : (N,) float64
        How much an error in each Gaussian's colour is seen: the inverse of its Laplace uncertainty, or W^freq.
    radius : float
        Of the scene, in scene units.
    coarse : (N, K) bool, optional
        Coefficients that stage 0 alone describes: the uncertain ones, which the paper quantises first.
    """
    config = config or HvqConfig()
    colors = model.sh.reshape(len(model), -1)  # (N, 3K)
    cells = min(config.cells, max(1, len(model) // config.min_members))
    labels = split_cells(cell_features(model, radius), weights, cells)
    stage = Stage(group_means(colors, labels, weights), labels)
    stages = [stage]
    residual = colors - stage.decode() if config.residual_codes else colors  # (N, 3K)
    if coarse is not None and config.residual_codes:
        residual = np.where(np.repeat(coarse, 3, axis=1), np.float32(0.0), residual)
    for number, codes in enumerate(config.residual_codes):
        stage = learn_residual_stage(residual, weights, codes, config, seed=config.seed + number)
        stages.append(stage)
        residual = residual - stage.decode()
    return tuple(stages)


def decode_stages(stages: tuple[Stage, ...]) -> Float32:
    """(N, K, 3) the colours the codebooks alone give: the sum of one code vector per stage."""
    total = sum((stage.decode() for stage in stages[1:]), stages[0].decode())
    return np.ascontiguousarray(total.reshape(len(total), -1, 3))


def group_means(values: Matrix, labels: Int32, weights: Float64, count: int | None = None) -> Float32:
    """(M, d) weighted mean of the rows of each label; rows of zero weight still define a mean of their own."""
    count = int(labels.max()) + 1 if count is None else count
    weights = weights + 1e-9 * float(weights.mean()) + 1e-300
    total = np.bincount(labels, weights, count)
    sums = np.zeros((count, values.shape[1]))
    add_up(np.ascontiguousarray(values), labels, weights, sums)
    return (sums / np.maximum(total, 1e-300)[:, None]).astype(np.float32)


@parallel_kernel
def add_up(values, labels, weights, sums, call):  # type: ignore[no-untyped-def]
    """Weighted sums (M, d) of the rows of each label. Each call has columns of its own: threads do not matter."""
    columns = share_of(values.shape[1], call)
    for i in range(len(values)):
        label, weight = labels[i], weights[i]
        for c in columns:
            sums[label, c] += weight * values[i, c]


def detail_metric(values: Float32, lambda_freq: float) -> Float32:
    """Coordinates in which squared distance is Eq 7: error plus lambda_freq times its detail (Haar) part.

    The Haar transform runs over the coefficients of each channel; being orthonormal it turns the extra term into
    a scale of sqrt(1 + lambda_freq) on the detail half. With one coefficient, or no weight, nothing is to be done.
    """
    n, width = values.shape
    coefficients = width // 3
    if coefficients == 1 or lambda_freq == 0.0:
        return values
    x = values.reshape(n, coefficients, 3)
    even = coefficients // 2 * 2
    left, right = x[:, 0:even:2], x[:, 1:even:2]
    approx = (left + right) * np.float32(np.sqrt(0.5))
    detail = (left - right) * np.float32(np.sqrt(0.5 * (1.0 + lambda_freq)))
    return np.concatenate([approx, detail, x[:, even:]], axis=1).reshape(n, width)


def learn_residual_stage(residual: Float32, weights: Float64, codes: int, config: HvqConfig, seed: int) -> Stage:
    """One residual codebook by EMA k-means on a sample, dead codes re-seeded, everything assigned once."""
    rng = np.random.default_rng(seed)
    n = len(residual)
    codes = max(1, min(codes, n // 4))
    space = detail_metric(residual, config.lambda_freq)
    index = rng.choice(n, min(config.sample, n), replace=False)
    x, w = space[index], (weights[index] + 1e-3 * float(weights.mean()) + 1e-300)
    book = x[rng.choice(len(x), codes, replace=False, p=_seed_odds(x, w))].copy()  # (M, 3K)
    count, total = np.ones(codes), book.astype(np.float64)
    w = w / w.mean() * (codes / len(x))  # an average code then collects a weight of 1 a round
    for round_ in range(config.rounds):
        nearest = assign(x, book)
        keep = config.decay if round_ else 0.0
        count = keep * count + (1 - keep) * np.bincount(nearest, w, codes)
        sums = np.stack([np.bincount(nearest, w * x[:, c], codes) for c in range(x.shape[1])], 1)
        total = keep * total + (1 - keep) * sums
        dead = count < 0.02
        if dead.any():  # re-seed where the error is largest, weighted as the error is
            fresh = rng.choice(len(x), int(dead.sum()), p=_seed_odds(x - book[nearest], w))
            count[dead], total[dead] = 1.0, x[fresh]
        book = (total / count[:, None]).astype(np.float32)
    labels = assign(space, book)
    return Stage(group_means(residual, labels, weights, codes), labels)


def _seed_odds(x: Float32, w: Float64) -> Float64:
    odds = w * ((x.astype(np.float64) ** 2).sum(axis=1) + 1e-12)
    return np.asarray(odds / odds.sum())


def assign(x: Float32, book: Float32, chunk: int = 4096) -> Int32:
    """(N,) nearest code of each row: argmin ||c||^2 / 2 - x.c, one BLAS product a chunk that stays in cache."""
    half = 0.5 * (book.astype(np.float32) ** 2).sum(axis=1)
    labels = np.empty(len(x), dtype=np.int32)
    transposed = np.ascontiguousarray(-book.T)
    for start in range(0, len(x), chunk):
        score = x[start : start + chunk] @ transposed
        score += half
        labels[start : start + chunk] = score.argmin(axis=1)
    return labels
