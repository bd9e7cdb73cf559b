"""Exemplar-based completion of a grid of colours: every missing cell is told which known cell to copy.

Criminisi, Perez, Toyama, "Region filling and object removal by exemplar-based inpainting", IEEE TIP 2004: the
hole closes from its rim, and each patch on the rim is completed from the known patch that fits it best.
"""

import numpy as np

from engine.model import Bool, Float64, Int64

__all__ = ["complete_cells", "enclosed", "harmonic_fill", "smooth"]

SIDES = (7, 5, 3, 1)  # patch sides, cells; smaller ones serve where no larger known patch exists
MOST_SOURCES = 6000  # source patches compared with each patch of the rim; more are thinned out evenly
BREATH = 1e-6  # weight of the mean in Laplace's equation: keeps islands solvable without moving the others
FEWEST_SOURCES = 16  # known patches of a side below which a smaller side is taken
REUSE = 0.15  # cost of each earlier use of a source patch, in units of the median patch distance: spreads the sources


def complete_cells(colors: Float64, known: Bool, wanted: Bool) -> tuple[Int64, Bool]:
    """Row and column of the cell to copy into every wanted cell, (H, W, 2), and the cells completed, (H, W) bool.

    Colours (H, W, 3) are meaningful where known (H, W); no wanted cell is. All wanted cells are completed, unless
    nothing is known.
    """
    source = np.zeros((*wanted.shape, 2), np.int64)
    image, filled = np.where(known[..., None], colors, 0.0), known.copy()
    if not known.any():
        return source, np.zeros_like(wanted)
    side, middles, patches = _source_patches(image, known)
    half = side // 2
    used = np.zeros(len(middles))
    scale = max(float(np.median(np.var(patches, axis=0))), 1e-12)
    offsets = np.indices((side, side)).reshape(2, -1).T - half
    padded = ((half, half), (half, half))
    left = wanted & ~filled
    while left.any():
        # The rim cell with most known cells about it is the surest to complete.
        votes = _box_sum(filled, half)
        rim = np.where(left & (votes > 0), votes, -1)
        row, column = divmod(int(np.argmax(rim)), rim.shape[1])
        if rim[row, column] <= 0:  # wanted cells out of the reach of all known ones: nearest known cell
            row, column = _nearest_left(left, filled)
        window = np.pad(filled, padded)[row : row + side, column : column + side].reshape(-1)
        target = np.pad(image, (*padded, (0, 0)))[row : row + side, column : column + side]
        seen = np.flatnonzero(window)
        gap = patches[:, seen] - target.reshape(-1, 3)[seen]  # (n, seen, 3)
        cost = np.einsum("npc,npc->n", gap, gap) / max(len(seen), 1)
        best = int(np.argmin(cost + REUSE * scale * used))
        used[best] += 1
        cells = offsets + np.array([row, column])
        inside = ((cells >= 0) & (cells < wanted.shape)).all(axis=1)
        cells, origin = cells[inside], (offsets + middles[best])[inside]
        fresh = left[cells[:, 0], cells[:, 1]]
        cells, origin = cells[fresh], origin[fresh]
        source[cells[:, 0], cells[:, 1]] = origin
        image[cells[:, 0], cells[:, 1]] = image[origin[:, 0], origin[:, 1]]
        filled[cells[:, 0], cells[:, 1]] = True
        left[cells[:, 0], cells[:, 1]] = False
    return source, wanted & filled


def enclosed(known: Bool, cells: Bool, least: int = 6) -> Bool:
    """The given cells from which at least `least` of 8 directions lead to a known cell, (H, W) bool.

    What stood out beyond the rim of a surface is no hole in it.
    """
    from scipy.ndimage import binary_dilation

    met = np.zeros(known.shape, np.int64)
    for direction in (0, 1, 2, 3, 5, 6, 7, 8):  # of the 3 x 3 cells, all but the middle
        step = np.isin(np.arange(9), (4, direction)).reshape(3, 3)
        met += binary_dilation(known, step, iterations=-1)  # until nothing changes
    return np.asarray(cells & (met >= least))


def harmonic_fill(values: Float64, known: Bool, wanted: Bool) -> Float64:
    """(H, W, C) values continued into the wanted cells by Laplace's equation, unknown cells insulating.

    Wanted cells that no known cell borders on, even through others, keep the mean of the known.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import spsolve

    out = np.where(known[..., None], values, 0.0)
    cells = np.argwhere(wanted)
    if not len(cells) or not known.any():
        return out
    number = np.full(wanted.shape, -1)
    number[tuple(cells.T)] = np.arange(len(cells))
    mean = values[known].mean(axis=0)
    diagonal, right = np.full(len(cells), BREATH), np.tile(BREATH * mean, (len(cells), 1))
    rows, columns = [], []
    for step in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        near = cells + step
        inside = ((near >= 0) & (near < wanted.shape)).all(axis=1)
        here, there = np.flatnonzero(inside), near[inside]
        fixed = known[tuple(there.T)]
        right[here[fixed]] += values[tuple(there[fixed].T)]
        diagonal[here[fixed]] += 1.0
        free = number[tuple(there.T)] >= 0
        diagonal[here[free]] += 1.0
        rows.append(here[free])
        columns.append(number[tuple(there[free].T)])
    i, j = np.concatenate([*rows, np.arange(len(cells))]), np.concatenate([*columns, np.arange(len(cells))])
    weights = np.concatenate([np.full(len(i) - len(cells), -1.0), diagonal])
    matrix = coo_matrix((weights, (i, j)), shape=(len(cells), len(cells))).tocsc()
    solved = np.stack([spsolve(matrix, right[:, c]) for c in range(right.shape[1])], axis=1)
    out[tuple(cells.T)] = solved
    return out


def smooth(values: Float64, known: Bool, sigma: float) -> Float64:
    """(H, W, C) Gaussian average of the known cells, sigma in cells; 0 where none is near."""
    from scipy.ndimage import gaussian_filter

    weight = gaussian_filter(known.astype(np.float64), sigma)
    total = gaussian_filter(np.where(known[..., None], values, 0.0), (sigma, sigma, 0.0))
    return np.asarray(np.where(weight[..., None] > 1e-6, total / np.maximum(weight, 1e-6)[..., None], 0.0))


def _source_patches(image: Float64, known: Bool) -> tuple[int, Int64, Float64]:
    """All patches of the largest side that are known throughout: side, (n, 2) middles and (n, side^2, 3) colours."""
    for side in SIDES:
        half = side // 2
        whole = _box_sum(known, half) == side * side
        at = np.argwhere(whole)
        if len(at) >= (FEWEST_SOURCES if side > 1 else 1):
            break
    at = at[:: -(-len(at) // MOST_SOURCES)]
    windows = np.lib.stride_tricks.sliding_window_view(image, (side, side), axis=(0, 1))  # (.., .., 3, s, s)
    patches = windows[at[:, 0] - half, at[:, 1] - half].transpose(0, 2, 3, 1).reshape(len(at), -1, 3)
    return side, at.astype(np.int64), np.ascontiguousarray(patches)


def _box_sum(mask: Bool, half: int) -> Int64:
    """(H, W) number of true cells in the square of side 2 half + 1 about each cell; none beyond the edge."""
    import cv2  # a heavy import that only filling holes pays for

    side = (2 * half + 1, 2 * half + 1)
    sums = cv2.boxFilter(mask.astype(np.uint8), cv2.CV_32S, side, normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(sums, dtype=np.int64)


def _nearest_left(left: Bool, filled: Bool) -> tuple[int, int]:
    from scipy.ndimage import distance_transform_edt

    distance = np.where(left, distance_transform_edt(~filled), np.inf)
    row, column = np.unravel_index(int(np.argmin(distance)), left.shape)
    return int(row), int(column)
