"""What was edited in a suspect, when nobody tells: a map that parts the edits from the mark.

The record says which displacement the mark makes (C'_k - C_k of every code vector). What a suspect shows
beyond that, coherently over neighbouring Gaussians, is an edit; what does not lie where it was is moved, copied
or foreign; what is missing was removed. The map is for people. It looks at the chips, so it must not choose the
evidence of a claim (DESIGN 4.9); claims are made by `verify_model` and `verify_pieces`, which do not.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from engine.flows.records.opened_record import OpenedRecord
from engine.lab.sim.edits.edit_regions import EditedRegion, describe, doubt, group
from engine.lab.sim.edits.pieces import Pieces, register_pieces
from engine.model import Bool, Float64, GaussianModel, Int64
from engine.numerics.umeyama import Similarity
from engine.registration.matching import DC_CLIP
from engine.watermark.layout import MARK_SCALE
from engine.watermark.model_evidence import remove_affine_color
from engine.watermark.spreading import signed_amplitudes

__all__ = ["Change", "EditMap", "map_edits"]

NEIGHBORS = 12  # neighbours over which a displacement must be coherent; the patch of a single code vector holds more
NORMAL = 1.4826  # standard deviation of a normal law over its median absolute deviation
CHANCE = 1e-6  # rate at which noise alone passes for a coherent displacement, per Gaussian, if normal and independent
ROUNDS = 3  # times tint and mark are fitted in turn; they hardly have anything in common
MOST_LEFT = 1.5  # largest factor of the mark that is believed
BORDER = 0.25  # share of a Gaussian's neighbours in a patch from which it lies next to it

FINEST = 0.1 * MARK_SCALE
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

    # (M,) `Change` of every suspect Gaussian; recoloured ones that were moved too count as moved
    kinds: npt.NDArray[np.int8]
    recolored: Bool  # (M,) displaced in colour by more than the mark, moved or not
    removed: Bool  # (N,) reference Gaussians that are not in the suspect
    displacement: Float64  # (M, 3) DC displacement that the mark does not explain, SH units; 0 where not matched
    mark_left: float  # how much of the mark the untouched Gaussians show: 1 all of it, 0 none
    regions: tuple[EditedRegion, ...]  # connected patches of changes, largest first
    pieces: Pieces

    @property
    def found(self) -> bool:
        """Whether the suspect holds a piece of the asset at all; all of it is foreign otherwise."""
        return bool(self.pieces.placements)


def map_edits(suspect: GaussianModel, opened: OpenedRecord, *, least: float = MARK_SCALE, seed: int = 0) -> EditMap:
    """Find what was edited in a suspect since the asset was marked.

    A global change of tint or exposure is no edit; nor is a similarity of the whole. `least` is the smallest colour
    displacement of interest, DC units (0.02 by default, the mark's own size and 1.4 steps of an 8-bit colour): a
    smaller edit is not told from what compression does.
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
    signed = signed_amplitudes(opened.layout.amplitudes * opened.strength, opened.spreading, opened.message)
    return opened.layout.displace(signed)[:, :3].astype(np.float64)


def _beyond(reference: Float64, shown: Float64, mark: Float64, trust: Float64) -> tuple[float, Float64]:
    """How much of the mark is left, and what neither it nor a global change of colour explains, (n, 3).

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
    """(n, 3) channels that a format without colours beyond 0 and 1 has clipped, there and here alike."""
    edge = DC_CLIP - MARK_SCALE
    clipped = np.abs(np.abs(shown) - DC_CLIP) < MARK_SCALE
    return np.asarray(clipped & (np.abs(expected) > edge) & (expected * shown > 0))


def _noise(beyond: Float64) -> Float64:
    """(3,) robust standard deviation of what nothing explains, channel by channel."""
    return np.maximum(NORMAL * np.median(np.abs(beyond), axis=0), FINEST)


def _completed(
    coherent: Bool, near: Int64, means: Float64, old: Float64, now: Float64, mark: Float64, beyond: Float64, left: float
) -> Bool:
    """(n,) the coherent Gaussians and those next to them that the same change of colour explains.

    A Gaussian that had about the colour it was painted in is displaced little or another way than the rest.
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
    """(n,) whether a Gaussian's displacement is shared by its neighbours, beyond noise and `least`.

    And those neighbours, (n, k), itself the first.
    """
    from scipy.spatial import cKDTree
    from scipy.special import chdtri

    noise = _noise(beyond)
    k = min(NEIGHBORS + 1, len(means))  # a Gaussian is its own nearest neighbour
    _, near = cKDTree(means).query(means, k=k, workers=1)
    near = near.reshape(-1, k)  # (n, k)
    weight = np.maximum(trust, 1e-3)[near]
    # The middle one of the neighbours' displacements: half of them must agree, and no outlier drags it.
    common = np.median(beyond[near], axis=1)  # (n, k, 3) -> (n, 3)
    # The variance of a median of k normal values is pi / 2 times that of their mean.
    count = weight.sum(axis=1) * (2.0 / np.pi)
    evidence = count * np.square(common / noise).sum(axis=1)
    size = np.linalg.norm(common, axis=1)
    coherent = (evidence > float(chdtri(3, CHANCE))) & (size >= least)
    # On a region's edge the Gaussian's own displacement decides on which side it lies.
    own = (beyond * common).sum(axis=1) / np.maximum(size, 1e-12)
    return np.asarray(coherent & (own > 0.5 * size)), near.astype(np.int64)
