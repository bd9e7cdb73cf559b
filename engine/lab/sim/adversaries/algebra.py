"""What copies of one asset give away in their differences, to a thief who has read the program and has no key.

- *Finite alphabets.* Where every copy moves a value by one step of its own, up or down, the differences of two copies
  take four values: the steps follow from them, and from the steps, value by value, the original.
- *Cells.* Where the original's colors are bytes, what is left of a color modulo one byte is the displacement of its
  cell: Gaussians with one remainder are one cell. Cell i of one copy and cell j of another share Gaussians, whose
  difference is A_i - B_j: many more equations than unknowns.

Nothing is assumed about the steps. Where differences take many values, the mean of the copies is all there is.
"""

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np

from engine.errors import InputError
from engine.lab.sim.adversaries.collusion import same_shape
from engine.lab.sim.attack import Attacks
from engine.model import SH_C0, Bool, Float64, GaussianModel, Int32
from engine.numerics.similarity import quaternion_to_rotation
from engine.watermark.grain import units

ATTACKS: Attacks[GaussianModel] = Attacks("model")

ALPHABET = 0.02  # half width of one value of a finite alphabet, of the largest
FINITE = 0.7  # share of the differences that must lie at its values
CLEAR = 3.0  # a sign is read where the other one misses by so many times as much
LINK, GRID = 5e-4, 1e-4  # remainders closer than LINK, bytes, belong to one cell; they are rounded to GRID before
CELL = 8  # Gaussians a cell at least, on average: remainders of colors that are no bytes lie alone
OPEN = ("mean", "first", "random")

Settle = Callable[[Float64], Float64]
"""Values (k, N, 3) of all copies to (N, 3), where nothing tells the original."""


@ATTACKS.add("solve several copies of one asset for the original", "rule for what stays open", "mean", OPEN)
def algebra(
    model: GaussianModel, strength: str, rng: np.random.Generator, *, others: Sequence[GaussianModel] = ()
) -> GaussianModel:
    """The original of sizes and centers from steps of few strengths, of colors from cells; see the module.

    What stays open becomes the "mean" of the copies, or is that of the "first" or a "random" copy.

    The `others` have the same
    Gaussians in the same order. InputError where the rule is unknown, no other is given or they differ in shape.
    """
    if strength not in OPEN:
        raise InputError(f"what stays open goes by one of {', '.join(OPEN)}, got {strength!r}")
    copies = same_shape(model, others)

    def stack(name: str) -> Float64:
        return np.stack([getattr(copy, name) for copy in copies]).astype(np.float64)

    def settle(values: Float64) -> Float64:
        if strength == "mean":
            return np.asarray(values.mean(axis=0))
        if strength == "first":
            return np.asarray(values[0].copy())
        return np.asarray(np.take_along_axis(values, rng.integers(len(values), size=(1, *values.shape[1:])), 0)[0])

    log_scales, steps = solve_steps(stack("log_scales"), settle)
    axes, size = quaternion_to_rotation(model.quats), units(log_scales.astype(np.float32))
    places = stack("means")
    middle = places.mean(axis=0)
    along = np.einsum("nij,kni->knj", axes, places - middle) / size  # (k, N, 3)
    moved = solve_steps(along, settle, steps)[0]
    colors = stack("sh")
    sh = settle(colors)
    sh[:, 0] = solve_cells(colors[:, :, 0], sh[:, 0])
    return model.with_(
        log_scales=log_scales.astype(np.float32),
        means=(middle + np.einsum("nij,nj->ni", axes, moved * size)).astype(np.float32),
        opacity_logits=settle(stack("opacity_logits")).astype(np.float32),
        sh=sh.astype(np.float32),
    )


def solve_steps(values: Float64, settle: Settle, like: Float64 | None = None) -> tuple[Float64, Float64 | None]:
    """The original (N, 3) of values (k, N, 3) that every copy moved by its own step, and the steps (k,).

    Two copies leave open which has the larger step: that of `like`, the steps of another attribute; without it, the
    original has the smaller spread. None for the steps, and all settled, where differences have no finite alphabet.
    """
    rivals = _steps(values)
    if not rivals:
        return settle(values), None
    tries = [(_decide(values, steps, settle), steps) for steps in rivals]
    if like is not None:
        return max(tries, key=lambda each: float(each[1] @ like))
    return min(tries, key=lambda each: float(each[0].var(axis=0).sum()))


def _steps(values: Float64) -> list[Float64]:
    """Steps (k,) of the copies, each possible set of them; none where differences take many values."""
    count = len(values)
    pairs = list(combinations(range(count), 2))
    ends = [_alphabet(np.abs(values[i] - values[j]).reshape(-1)) for i, j in pairs]
    if any(end is None for end in ends):
        return []
    low, high = np.array([end for end in ends if end is not None]).T
    if count == 2:
        larger, smaller = (high[0] + low[0]) / 2.0, (high[0] - low[0]) / 2.0
        return [np.array([larger, smaller]), np.array([smaller, larger])]
    sums = np.zeros((len(pairs), count))
    for row, pair in enumerate(pairs):
        sums[row, list(pair)] = 1.0
    return [np.linalg.lstsq(sums, high, rcond=None)[0]]


def _alphabet(apart: Float64) -> tuple[float, float] | None:
    """Difference and sum of two steps, from the distances (M,) of two copies; None where they take many values."""
    apart = apart[:: max(1, len(apart) // 200_000)]
    top = float(np.quantile(apart, 0.95))
    far = apart > 0.5 * top
    if top <= 0.0 or far.all():
        return None
    high, low = float(np.median(apart[far])), float(np.median(apart[~far]))
    near = np.minimum(np.abs(apart - high), np.abs(apart - low)) < ALPHABET * high
    return (low, high) if near.mean() >= FINITE else None


def _decide(values: Float64, steps: Float64, settle: Settle) -> Float64:
    """Each original by the sign of the first copy's step that explains all copies; settled where none or both do."""
    by_copy = steps[:, None, None]
    originals, missed = [], []
    for sign in (1.0, -1.0):
        start = values[0] - sign * steps[0]
        signs = np.sign(values - start)
        missed.append(np.abs(np.abs(values - start) - by_copy).max(axis=0))
        originals.append((values - signs * by_copy).mean(axis=0))
    limit = ALPHABET * float(steps.max())
    up: Bool = (missed[0] < limit) & (missed[1] > CLEAR * missed[0])
    down: Bool = (missed[1] < limit) & (missed[0] > CLEAR * missed[1])
    return np.asarray(np.where(up, originals[0], np.where(down, originals[1], settle(values))))


def solve_cells(colors: Float64, start: Float64) -> Float64:
    """The original's DC (N, 3) from the copies' (k, N, 3); `start` where cells do not show, or in pieces too small."""
    codes = (colors * SH_C0 + 0.5) * 255.0
    found = [cells_of_remainders(code - np.floor(code)) for code in codes]
    labels = [label for label in found if label is not None]
    if len(labels) < len(found) or len(found) < 2:
        return start
    moves = _moves(codes, labels)
    original = np.mean([code - move[label] for code, move, label in zip(codes, moves, labels, strict=True)], axis=0)
    return np.asarray((np.round(original) / 255.0 - 0.5) / SH_C0)


def cells_of_remainders(remainders: Float64) -> Int32 | None:
    """(N,) cell of each Gaussian, by remainders (N, 3) in [0, 1) that are those of its cell; None where none share."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    ticks = np.round(remainders / GRID).astype(np.int64) % round(1.0 / GRID)
    points, back = np.unique(ticks, axis=0, return_inverse=True)
    pairs = cKDTree(points * GRID, boxsize=1.0).query_pairs(LINK, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
    count, labels = connected_components(graph, directed=False)
    return np.asarray(labels[back.reshape(-1)], dtype=np.int32) if count * CELL <= len(remainders) else None


def _moves(codes: Float64, labels: Sequence[Int32]) -> list[Float64]:
    """How far (cells, 3) each copy's cells were moved, bytes, from A_i - B_j = D_ij over the Gaussians they share."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.sparse.linalg import lsqr

    counts = [int(label.max()) + 1 for label in labels]
    offsets = np.cumsum([0, *counts])
    total = int(offsets[-1])
    left, right, apart = [], [], []
    for number in range(1, len(labels)):
        edges, back = np.unique(labels[0] * np.int64(total) + labels[number], return_inverse=True)
        size = np.bincount(back.reshape(-1))
        left.append(edges // total)
        right.append(edges % total + offsets[number])
        difference = codes[0] - codes[number]
        apart.append(np.stack([np.bincount(back.reshape(-1), column) / size for column in difference.T], axis=1))
    a, b, wanted = np.concatenate(left), np.concatenate(right), np.concatenate(apart)
    rows = np.arange(len(a))
    one = np.ones(len(a))
    system = coo_matrix((np.r_[one, -one], (np.r_[rows, rows], np.r_[a, b])), shape=(len(a), total)).tocsr()
    moves = np.stack([lsqr(system, column, atol=1e-7, btol=1e-7)[0] for column in wanted.T], axis=1)
    piece = connected_components(coo_matrix((one, (a, b)), shape=(total, total)), directed=False)[1]
    # One constant a piece stays open: its part below a byte is in the remainders, and marks have a mean near zero.
    left_over = np.empty((total, 3))
    weight = np.empty(total)
    for offset, count, label, code in zip(offsets, counts, labels, codes, strict=False):
        rest = np.exp(2j * np.pi * (code - moves[label + offset]))
        turn = np.stack([np.bincount(label, c.real, count) + 1j * np.bincount(label, c.imag, count) for c in rest.T], 1)
        left_over[offset : offset + count] = np.angle(turn) / (2.0 * np.pi)
        weight[offset : offset + count] = np.bincount(label, minlength=count)
    for channel in range(3):
        turn = np.exp(2j * np.pi * left_over[:, channel]) * weight
        pieces = int(piece.max()) + 1
        shift = np.angle(np.bincount(piece, turn.real, pieces) + 1j * np.bincount(piece, turn.imag, pieces))
        shift /= 2.0 * np.pi
        mean = np.bincount(piece, weight * moves[:, channel], pieces) / np.bincount(piece, weight, pieces)
        moves[:, channel] += (shift - np.round(mean + shift))[piece]
    return np.split(moves, offsets[1:-1])


@ATTACKS.add(
    "put copies together, and push at random what they agree on",
    "push, in steps of the copies' differences",
    10.0,
    (1.0, 2.0, 4.0, 5.5, 10.0, 16.0, 24.0),
    "[0, inf)",
)
def push(
    model: GaussianModel, strength: float, rng: np.random.Generator, *, others: Sequence[GaussianModel] = ()
) -> GaussianModel:
    """Centers along their own axes and sizes: where copies differ the middle, where they agree up or down by `strength`
    steps, by a coin. A step is the root mean square of what one copy adds. Colors are solved for by their cells, as in
    `algebra`; opacities, and colors where no cells show, become their mean.

    Two values agree when they lie closer than half a step. The `others` have the same Gaussians in the same order;
    InputError where none is given or they differ in shape.
    """
    copies = same_shape(model, others)

    def pushed(values: Float64) -> Float64:
        spread = np.ptp(values, axis=0)
        step = np.sqrt(values.var(axis=0, ddof=1).mean())
        coin = rng.choice([-1.0, 1.0], values.shape[1:])
        middle = (values.min(axis=0) + values.max(axis=0)) / 2.0
        return np.asarray(middle + np.where(spread < 0.5 * step, strength * step, 0.0) * coin)

    def stack(name: str) -> Float64:
        return np.stack([getattr(copy, name) for copy in copies]).astype(np.float64)

    axes, size, places = quaternion_to_rotation(model.quats), units(model.log_scales), stack("means")
    middle = places.mean(axis=0)
    moved = pushed(np.einsum("nij,kni->knj", axes, places - middle) / size)
    colors = stack("sh")
    sh = colors.mean(axis=0)
    sh[:, 0] = solve_cells(colors[:, :, 0], sh[:, 0])
    return model.with_(
        means=(middle + np.einsum("nij,nj->ni", axes, moved * size)).astype(np.float32),
        log_scales=pushed(stack("log_scales")).astype(np.float32),
        opacity_logits=stack("opacity_logits").mean(axis=0).astype(np.float32),
        sh=sh.astype(np.float32),
    )
