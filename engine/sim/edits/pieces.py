"""A suspect in which parts of the asset were moved, each in its own way: registered piece by piece."""

from dataclasses import dataclass, replace

import numpy as np

from engine.errors import InputError
from engine.model import Float32, GaussianModel, Int32
from engine.numerics.umeyama import Similarity
from engine.pipeline.judging import VerifyConfig, judge
from engine.pipeline.reading import read_gaussians
from engine.pipeline.sealing import OpenedRecord
from engine.registration.index import ReferenceIndex
from engine.registration.registering import Registration, RegistrationConfig, register
from engine.watermark.claim import Claim

__all__ = ["Pieces", "check_route", "register_pieces", "verify_pieces"]

LEAST_PIECE = 64
"""Gaussians below which no further piece is looked for, or believed: embedding asks for as many."""

RIGID = RegistrationConfig(deformed=False)
"""Each piece moved by a similarity: a field of maps would take several pieces for one bent thing."""

MOST_PIECES = 8
"""Pieces looked for where the caller does not say."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Which reference Gaussian each suspect Gaussian is, over all pieces."""

    registration: Registration  # of the first piece, the one that most of the asset is in
    matches: Int32  # (M,) reference Gaussian of each suspect Gaussian, -1 where there is none
    quality: Float32  # (M,) trust in each match, 0 to 1
    piece: Int32  # (M,) number of the piece a suspect Gaussian lies in, -1 where it was not matched
    # of each piece: x_reference = scale * R @ x_suspect + t. Empty if nothing was found
    placements: tuple[Similarity, ...]


def register_pieces(
    reference: GaussianModel, suspect: GaussianModel, *, most: int = MOST_PIECES, seed: int = 0
) -> Pieces:
    """Register what the registration before left over, until nothing more is found.

    A piece may be a part of the asset that was moved, or a copy of a part that is still in place. No chip
    enters. At most `most` pieces are looked for.
    """
    if most < 1:
        raise InputError(f"at least one piece is looked for, got {most}")
    index = ReferenceIndex(reference)
    first = register(index, suspect, seed=seed, config=RIGID)
    matches, quality = first.matches.copy(), first.match_quality.copy()
    piece = np.where(matches >= 0, 0, -1).astype(np.int32)
    placements = [first.similarity] if first.found else []
    while placements and len(placements) < most:
        left = np.flatnonzero(piece < 0)
        if len(left) < LEAST_PIECE:
            break
        found = register(index, suspect.take(left), seed=seed, config=RIGID)
        hit = np.flatnonzero(found.matches >= 0)
        if not found.found or len(hit) < LEAST_PIECE:
            break
        rows = left[hit]
        matches[rows], quality[rows] = found.matches[hit], found.match_quality[hit]
        piece[rows] = len(placements)
        placements.append(found.similarity)
    return Pieces(first, matches, quality, piece, tuple(placements))


def verify_pieces(
    suspect: GaussianModel, opened: OpenedRecord, config: VerifyConfig | None = None, *, pieces: Pieces | None = None
) -> Claim:
    """Does this model carry the record's mark, parts of it having been moved? One claim from all pieces.

    It is one of one try: how the suspect was taken apart was settled without the chips. The route must be "auto" or
    "model"; pieces of this suspect and the record's reference may be registered already.
    """
    config = config or VerifyConfig()
    check_route(config, "model; pieces are")
    pieces = pieces or register_pieces(opened.reference, suspect, seed=config.seed)
    matched = pieces.matches >= 0
    seen = np.zeros(len(opened.reference), np.bool_)
    seen[pieces.matches[matched]] = True
    whole = replace(
        pieces.registration, matches=pieces.matches, match_quality=pieces.quality, derived_fraction=float(seen.mean())
    )
    notes = (f"read from {len(pieces.placements)} pieces",) if len(pieces.placements) > 1 else ()
    return judge(read_gaussians(suspect, opened, whole), opened, "model", 1, config, whole, notes)


def check_route(config: VerifyConfig, what: str) -> None:
    """InputError unless the configuration lets matched Gaussians be read."""
    if config.route not in ("auto", "model"):
        raise InputError(f"route {config.route!r} sees the whole {what} read by 'model'")
