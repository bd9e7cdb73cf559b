"""A suspect that holds the reference several times, or in pieces each moved on its own: registered one after another.

What a registration left over is registered again, until nothing more is found or there are `most` pieces. As in
`registration_search` no secret enters: how a suspect is taken apart is settled before a chip is drawn.
"""

from dataclasses import replace

import numpy as np

from engine.errors import InputError
from engine.model import Bool, GaussianModel
from engine.registration.config import CONFIG
from engine.registration.looks_index import ReferenceIndex
from engine.registration.registration_search import Registration, RegistrationConfig, register

_CONFIG = CONFIG.pieces
RIGID = RegistrationConfig(merged=False, deformed=False)
"""Each piece moved by a similarity: a field of maps would take several pieces for one bent thing."""


def register_pieces(
    reference: GaussianModel | ReferenceIndex,
    suspect: GaussianModel,
    *,
    first: Registration | None = None,
    most: int = _CONFIG.most,
    seed: int = 0,
) -> tuple[Registration, ...]:
    """Every piece's own registration, all of them with matches (M,) over the whole suspect; no row is in two.

    A piece is a part of the reference, or a copy of a part that is elsewhere, too. At least one is given, not found
    where the suspect holds none.

    Parameters
    ----------
    first : Registration, optional
        What `register` found in this suspect. Where that is a deformation which rigid pieces explain about as well, it
        is they that stand.
    """
    if most < 1:
        raise InputError(f"at least one piece is looked for, got {most}")
    index = reference if isinstance(reference, ReferenceIndex) else ReferenceIndex(reference)
    if first is not None and first.deformed and most > 1:
        rigid = register_pieces(index, suspect, most=most, seed=seed)
        explained = sum(float(piece.match_quality.sum()) for piece in rigid)
        return rigid if len(rigid) > 1 and explained > _CONFIG.as_well * float(first.match_quality.sum()) else (first,)
    pieces = [register(index, suspect, seed=seed, config=RIGID) if first is None else first]
    left = ~_explained(pieces[0])
    for _ in range(1, most):
        rows = np.flatnonzero(left)
        if not pieces[0].found or len(rows) < max(CONFIG.least_rest, _CONFIG.left_over * len(suspect)):
            break
        part = register(index, suspect.take(rows), seed=seed, config=RIGID)
        hits = np.flatnonzero(part.matches >= 0)
        if not part.found or len(hits) < CONFIG.least_rest:
            break
        matches, quality = np.full(len(suspect), -1, np.int32), np.zeros(len(suspect), np.float32)
        matches[rows[hits]], quality[rows[hits]] = part.matches[hits], part.match_quality[hits]
        left[rows[hits]] = False
        piece = replace(part, matches=matches, match_quality=quality)
        same = next((k for k, before in enumerate(pieces) if _one(before, piece, suspect, index.extent)), None)
        if same is None:
            pieces.append(piece)
        else:
            pieces[same] = _joined(pieces[same], piece, len(index.model))
    return tuple(pieces)


def _explained(registration: Registration) -> Bool:
    """(M,) rows of the suspect that are something of the reference."""
    return np.asarray((registration.matches >= 0) | registration.mixtures.explained())


def _joined(piece: Registration, rest: Registration, count: int) -> Registration:
    """A piece, and what else lies where it lies; the reference has `count` Gaussians. Mixtures stay as they were."""
    if piece.mixed is not None:
        return piece
    matches = np.where(rest.matches >= 0, rest.matches, piece.matches)
    share = len(np.unique(matches[matches >= 0])) / count
    quality = np.maximum(piece.match_quality, rest.match_quality)
    return replace(piece, matches=matches, match_quality=quality, derived_fraction=share)


def _one(before: Registration, piece: Registration, suspect: GaussianModel, extent: float) -> bool:
    """Whether a piece lies where one before lies, so that it is a rest of that and no other."""
    if before.mirrored != piece.mirrored:
        return False
    some = suspect.take(np.flatnonzero(piece.matches >= 0))
    gap = np.linalg.norm(before.place(some).means - piece.place(some).means, axis=1)
    return float(np.median(gap)) < _CONFIG.same_place * extent
