"""What was edited in a suspect, without a track of its edits: a map that separates the edits from the mark.

The record says which displacement the mark makes (C'_k - C_k of every code vector). What a suspect shows
beyond that, coherently over neighboring Gaussians, is an edit; what does not lie where it was is moved, copied
or foreign; what is missing was removed. Connected patches of changes are described for people. The map looks at the
chips, so it must not choose the evidence of a claim (DESIGN 4.9); claims are made by `verify_model` and
`verify_pieces`, which do not.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from engine.flows.embed.copy_mark import whole_displacements
from engine.flows.records.opened_record import OpenedRecord
from engine.lab.sim.edits.edit import Recoloring
from engine.lab.sim.edits.pieces import Pieces, register_pieces
from engine.model import SH_C0, Bool, Float64, GaussianModel, Int64
from engine.numerics.umeyama import Similarity
from engine.registration.matching import DC_CLIP
from engine.watermark.config import CONFIG
from engine.watermark.model_evidence import remove_affine_color

LINKS = 8  # neighbors by which Gaussians of a patch hang together
REACH = 4.0  # links longer than this many median links join nothing


@dataclass(frozen=True, eq=False)
class EditedRegion:
    """A patch of one kind of change."""

    kind: str  # "recolored", "moved", "copied", "foreign" or "removed"
    rows: Int64  # (n,) Gaussians of the suspect; of the reference where removed
    center: Float64  # (3,) median of the centers, in the suspect's frame
    radius: float  # 90 % quantile of the distance from it, units of the suspect
    # new color = gain * old color + tint, robustly fitted; None where nothing was matched
    recoloring: Recoloring | None
    mark_left: float  # how much of the mark the patch still shows (1 all, 0 none); NaN where nothing was matched
    mark_error: float  # standard error of that
    motion: Similarity | None  # of moved and copied patches: x_now = scale * R @ x_before + t, in the suspect's frame

    def summary(self) -> str:
        """One line for a person."""
        at = ", ".join(f"{v:.3g}" for v in self.center)
        text = f"{len(self.rows)} Gaussians within {self.radius:.3g} of ({at}) {self.kind}"
        if self.motion is not None:
            turn = np.degrees(np.arccos(np.clip((np.trace(self.motion.R) - 1.0) / 2.0, -1.0, 1.0)))
            text += f" by scale {self.motion.scale:.3g} and {turn:.3g} degrees"
        if self.kind == "recolored" and self.recoloring is not None:
            gain, tint = (", ".join(f"{v:.2f}" for v in x) for x in (self.recoloring.gain, self.recoloring.tint))
            text += f": gain ({gain}), tint ({tint})"
        if np.isfinite(self.mark_left):
            text += f"; mark left {self.mark_left:.2f} +- {self.mark_error:.2f}"
        return text


def group(means: Float64, rows: Int64, least: int) -> list[Int64]:
    """Patches of at least `least` rows that hang together in space, largest first."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(rows) < max(least, 2):
        return []
    points = means[rows]
    k = min(LINKS + 1, len(rows))
    distance, near = cKDTree(points).query(points, k=k, workers=1)
    limit = REACH * float(np.median(distance[:, -1]))
    i, j = np.repeat(np.arange(len(rows)), k), near.reshape(-1)
    close = distance.reshape(-1) <= limit
    links = coo_matrix((np.ones(int(close.sum())), (i[close], j[close])), shape=(len(rows), len(rows)))
    _, label = connected_components(links, directed=False)
    sizes = np.bincount(label)
    order = [c for c in np.argsort(-sizes, kind="stable") if sizes[c] >= least]
    return [rows[label == c] for c in order]


def describe(
    kind: str,
    rows: Int64,
    points: Float64,
    reference_dc: npt.NDArray[np.floating],
    suspect_dc: npt.NDArray[np.floating],
    mark: Float64,
    motion: Similarity | None,
) -> EditedRegion:
    """The description of a patch: rows (n,) at points (n, 3).

    DC before and now, and the mark's displacement, are (m, 3), of the matched ones; m may be 0.
    """
    center = np.median(points, axis=0)
    radius = float(np.quantile(np.linalg.norm(points - center, axis=1), 0.9))
    if not len(mark):
        return EditedRegion(kind, rows, center, radius, None, np.nan, np.nan, motion)
    old, new = reference_dc.astype(np.float64), suspect_dc.astype(np.float64)
    gain, offset = np.array([_line(old[:, c], new[:, c], mark[:, c]) for c in range(3)]).T  # (3,), (3,)
    rest = new - gain * old - offset
    weight = 1.0 / doubt(np.linalg.norm(rest, axis=1))
    energy = float(weight @ np.square(mark).sum(axis=1))
    left = float(weight @ (mark * rest).sum(axis=1) / max(energy, 1e-30))
    spread = float(weight @ np.square(rest - left * mark).sum(axis=1) / max(3.0 * weight.sum(), 1e-30))
    error = float(np.sqrt(spread / max(energy, 1e-30)))
    recoloring = Recoloring(gain, SH_C0 * offset - 0.5 * (gain - 1.0))
    return EditedRegion(kind, rows, center, radius, recoloring, left, error, motion)


def doubt(gap: Float64, finest: float = 1e-6) -> Float64:
    """One over the Geman-McClure weights of residuals (n,), on a scale of twice their median, `finest` at least."""
    return np.asarray((1.0 + (gap / max(2.0 * float(np.median(gap)), finest)) ** 2) ** 2)


def _line(old: Float64, new: Float64, mark: Float64) -> tuple[float, float]:
    """Robust gain and offset of new = gain * old + offset + share * mark (Geman-McClure weights)."""
    design = np.stack([old, np.ones_like(old), mark], axis=1)
    weight = np.ones(len(old))
    fit = np.array([1.0, float(np.median(new - old)), 1.0])
    for _ in range(10):
        weight = 1.0 / doubt(np.abs(new - design @ fit))
        normal = (design * weight[:, None]).T @ design + 1e-9 * len(old) * np.eye(3)
        fit = np.linalg.solve(normal, (design * weight[:, None]).T @ new)
    return float(fit[0]), float(fit[1])


NEIGHBORS = 12  # neighbors over which a displacement must be coherent; the patch of a single code vector holds more
NORMAL = 1.4826  # standard deviation of a normal law over its median absolute deviation
CHANCE = 1e-6  # rate at which noise alone passes for a coherent displacement, per Gaussian, if normal and independent
ROUNDS = 3  # times tint and mark are fitted in turn; they hardly have anything in common
MOST_LEFT = 1.5  # largest factor of the mark that is believed
BORDER = 0.25  # share of a Gaussian's neighbors in a patch from which it lies next to it

FINEST = 0.1 * CONFIG.planning.mark_scale
"""Deviation below which residuals are not believed, SH units: references are rounded, files more so."""

LEAST_REGION = 24  # Gaussians below which a patch of changes is no region


class Change(IntEnum):
    """What became of a Gaussian."""

    UNTOUCHED = 0
    RECOLORED = 1
    MOVED = 2
    COPIED = 3
    FOREIGN = 4


@dataclass(frozen=True, eq=False)
class EditMap:
    """Where a suspect differs from the record's reference by more than the mark."""

    # (M,) `Change` of every suspect Gaussian; recolored ones that were moved too count as moved
    kinds: npt.NDArray[np.int8]
    recolored: Bool  # (M,) displaced in color by more than the mark, moved or not
    removed: Bool  # (N,) reference Gaussians that are not in the suspect
    displacement: Float64  # (M, 3) DC displacement that the mark does not explain, SH units; 0 where not matched
    mark_left: float  # how much of the mark the untouched Gaussians show: 1 all of it, 0 none
    regions: tuple[EditedRegion, ...]  # connected patches of changes, largest first
    pieces: Pieces

    @property
    def found(self) -> bool:
        """Whether the suspect holds a piece of the asset at all; all of it is foreign otherwise."""
        return bool(self.pieces.placements)


def map_edits(
    suspect: GaussianModel, opened: OpenedRecord, *, least: float = CONFIG.planning.mark_scale, seed: int = 0
) -> EditMap:
    """Find what was edited in a suspect since the asset was marked.

    A global change of tint or exposure is no edit; nor is a similarity of the whole. `least` is the smallest color
    displacement of interest, DC units (0.02 by default, the mark's own size and 1.4 steps of an 8-bit color): a
    smaller edit cannot be distinguished from compression.
    """
    pieces = register_pieces(opened.reference, suspect, seed=seed)
    rows = np.flatnonzero(pieces.matches >= 0)
    removed = np.ones(len(opened.reference), np.bool_)
    removed[pieces.matches[rows]] = False
    kinds = _placing(pieces)
    displacement = np.zeros((len(suspect), 3))
    recolored = np.zeros(len(suspect), np.bool_)
    if not len(rows):
        return EditMap(kinds, recolored, removed, displacement, 0.0, (), pieces)
    target = pieces.matches[rows]  # (n,)
    reference = opened.reference.sh[target, 0].astype(np.float64)
    trust = pieces.quality[rows].astype(np.float64)
    shown = suspect.sh[rows, 0].astype(np.float64) - reference  # (n, 3)
    mark = _mark_of(opened)
    mark_left, beyond = _beyond(reference, shown, mark[target], trust)
    beyond[_saturated(reference + mark[target], suspect.sh[rows, 0])] = 0.0
    displacement[rows] = beyond
    now = reference + mark_left * mark[target] + beyond  # what the suspect shows, a global tint taken off
    means = suspect.means.astype(np.float64)
    coherent, near = _coherent(means[rows], beyond, trust, least)
    recolored[rows] = _completed(coherent, near, means[rows], reference, now, mark[target], beyond, mark_left)
    colors = np.zeros((len(suspect), 3))
    colors[rows] = now
    kinds[recolored & (kinds == Change.UNTOUCHED)] = Change.RECOLORED
    regions = []
    for kind in (Change.RECOLORED, Change.MOVED, Change.COPIED, Change.FOREIGN):
        for patch in group(means, np.flatnonzero(kinds == kind), LEAST_REGION):
            matched = patch[pieces.matches[patch] >= 0]
            old = pieces.matches[matched]
            looks = opened.reference.sh[old, 0], colors[matched], mark[old]
            motion = _moved_by(pieces, matched) if kind in (Change.MOVED, Change.COPIED) else None
            regions.append(describe(kind.name.lower(), patch, means[patch], *looks, motion))
    # Removed Gaussians are reported where they would be in the suspect.
    back = pieces.placements[0].inverse().apply(opened.reference.means)
    for patch in group(back, np.flatnonzero(removed), LEAST_REGION):
        nothing = np.empty((0, 3))
        regions.append(describe("removed", patch, back[patch], nothing, nothing, nothing, None))
    regions.sort(key=lambda region: -len(region.rows))
    return EditMap(kinds, recolored, removed, displacement, mark_left, tuple(regions), pieces)


def _placing(pieces: Pieces) -> npt.NDArray[np.int8]:
    """(M,) untouched, moved, copied or foreign, by where the matched Gaussians lie."""
    kinds = np.full(len(pieces.matches), Change.FOREIGN, np.int8)
    home, away = pieces.piece == 0, pieces.piece > 0
    kinds[home] = Change.UNTOUCHED
    kinds[away] = np.where(np.isin(pieces.matches[away], pieces.matches[home]), Change.COPIED, Change.MOVED)
    return kinds


def _moved_by(pieces: Pieces, rows: Int64) -> Similarity:
    """x_now = scale * R @ x_before + t in the suspect's frame, of the piece that most of the rows are in."""
    number = int(np.bincount(pieces.piece[rows]).argmax())
    home, piece = pieces.placements[0], pieces.placements[number].inverse()
    scale, R = piece.scale * home.scale, piece.R @ home.R
    return Similarity(scale, R, piece.scale * piece.R @ home.t + piece.t)


def _mark_of(opened: OpenedRecord) -> Float64:
    """(N, 3) DC displacement that the record's mark makes."""
    return whole_displacements(opened)[0][:, :3].astype(np.float64)


def _beyond(reference: Float64, shown: Float64, mark: Float64, trust: Float64) -> tuple[float, Float64]:
    """How much of the mark is left, and what neither it nor a global change of color explains, (n, 3).

    Tint and mark are fitted in turn: a tint fitted alone takes a part of the mark for its own.
    """
    mark_left, beyond = 1.0, shown
    for _ in range(ROUNDS):
        rest = remove_affine_color(reference, shown - mark_left * mark, trust)
        mark_left = _share(rest + mark_left * mark, mark, trust)
        beyond = remove_affine_color(reference, shown - mark_left * mark, trust)
    return mark_left, beyond


def _share(shown: Float64, mark: Float64, trust: Float64) -> float:
    """Robust factor of the mark in what is shown, 0 to 1.5 (Geman-McClure weights, as for the evidence)."""
    factor, weight = 1.0, trust
    for _ in range(8):
        energy = float(weight @ np.square(mark).sum(axis=1))
        if not energy > 0:
            return 0.0
        factor = float(np.clip(weight @ (mark * shown).sum(axis=1) / energy, 0.0, MOST_LEFT))
        weight = trust / doubt(np.linalg.norm(shown - factor * mark, axis=1), FINEST)
    return factor


def _saturated(expected: Float64, shown: npt.NDArray[np.float32]) -> Bool:
    """(n, 3) channels that a format without colors beyond 0 and 1 has clipped, there and here alike."""
    edge = DC_CLIP - CONFIG.planning.mark_scale
    clipped = np.abs(np.abs(shown) - DC_CLIP) < CONFIG.planning.mark_scale
    return np.asarray(clipped & (np.abs(expected) > edge) & (expected * shown > 0))


def _noise(beyond: Float64) -> Float64:
    """(3,) robust standard deviation of what nothing explains, channel by channel."""
    return np.maximum(NORMAL * np.median(np.abs(beyond), axis=0), FINEST)


def _completed(
    coherent: Bool, near: Int64, means: Float64, old: Float64, now: Float64, mark: Float64, beyond: Float64, left: float
) -> Bool:
    """(n,) the coherent Gaussians and those next to them that the same change of color explains.

    A Gaussian that had about the color it was painted in is displaced little or another way than the rest.
    """
    done = coherent.copy()
    chance = float(np.square(3.0 * _noise(beyond)).sum())
    for patch in group(means, np.flatnonzero(coherent), LEAST_REGION):
        found = describe("recolored", patch, means[patch], old[patch], now[patch], mark[patch], None)
        assert found.recoloring is not None
        inside = np.zeros(len(coherent), np.bool_)
        inside[patch] = True
        next_to = np.flatnonzero(~coherent & (inside[near].mean(axis=1) >= BORDER))
        gain, offset = found.recoloring.gain, found.recoloring.offset
        predicted = (gain - 1.0) * old[next_to] + offset + (found.mark_left - left) * mark[next_to]
        misfit = np.square(beyond[next_to] - predicted).sum(axis=1)
        done[next_to[misfit < np.square(beyond[next_to]).sum(axis=1) - chance]] = True
    return done


def _coherent(means: Float64, beyond: Float64, trust: Float64, least: float) -> tuple[Bool, Int64]:
    """(n,) whether a Gaussian's displacement is shared by its neighbors, beyond noise and `least`.

    And those neighbors, (n, k), itself the first.
    """
    from scipy.spatial import cKDTree
    from scipy.special import chdtri

    noise = _noise(beyond)
    k = min(NEIGHBORS + 1, len(means))  # a Gaussian is its own nearest neighbor
    _, near = cKDTree(means).query(means, k=k, workers=1)
    near = near.reshape(-1, k)  # (n, k)
    weight = np.maximum(trust, 1e-3)[near]
    # The middle one of the neighbors' displacements: half of them must agree, and no outlier drags it.
    common = np.median(beyond[near], axis=1)  # (n, k, 3) -> (n, 3)
    # The variance of a median of k normal values is pi / 2 times that of their mean.
    count = weight.sum(axis=1) * (2.0 / np.pi)
    evidence = count * np.square(common / noise).sum(axis=1)
    size = np.linalg.norm(common, axis=1)
    coherent = (evidence > float(chdtri(3, CHANCE))) & (size >= least)
    # On a region's edge the Gaussian's own displacement decides on which side it lies.
    own = (beyond * common).sum(axis=1) / np.maximum(size, 1e-12)
    return np.asarray(coherent & (own > 0.5 * size)), near.astype(np.int64)
