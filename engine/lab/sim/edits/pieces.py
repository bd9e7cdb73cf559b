"""Suspects registered piece by piece: parts of the asset were moved, or a file holds many objects."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from engine.errors import InputError
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.decision import Reading, VerifyConfig, judge
from engine.flows.verify.gaussian_evidence import derivation_of_model, read_gaussians
from engine.flows.verify.search import count_tries
from engine.lab.sim.edits.objects import FlatScene
from engine.model import Float32, Float64, GaussianModel, Int32, Int64
from engine.numerics.umeyama import Similarity
from engine.registration.config import CONFIG
from engine.registration.looks_index import ReferenceIndex
from engine.registration.pieces import RIGID
from engine.registration.pieces import register_pieces as register_each
from engine.registration.registration_search import Registration, register
from engine.watermark.claim import Claim


@dataclass(frozen=True, eq=False)
class Pieces:
    """Which reference Gaussian each suspect Gaussian is, over all pieces."""

    registration: Registration  # of the first piece, the one that most of the asset is in
    matches: Int32  # (M,) reference Gaussian of each suspect Gaussian, -1 where there is none
    quality: Float32  # (M,) trust in each match, 0 to 1
    piece: Int32  # (M,) number of the piece a suspect Gaussian lies in, -1 where it was not matched
    # of each piece: x_reference = scale * R @ x_suspect + t. Empty if nothing was found
    placements: tuple[Similarity, ...]
    mirrored: tuple[bool, ...]  # whether that holds of the piece's mirror image (`mirror_model`)


def register_pieces(
    reference: GaussianModel, suspect: GaussianModel, *, most: int = CONFIG.pieces.most, seed: int = 0
) -> Pieces:
    """At most so many pieces of the asset in one suspect, see `registration.pieces`."""
    each = register_each(reference, suspect, most=most, seed=seed)
    matches, quality = np.full(len(suspect), -1, np.int32), np.zeros(len(suspect), np.float32)
    piece = np.full(len(suspect), -1, np.int32)
    found = [one for one in each if one.found]
    for number, one in enumerate(found):
        rows = np.flatnonzero(one.matches >= 0)
        matches[rows], quality[rows], piece[rows] = one.matches[rows], one.match_quality[rows], number
    placed = tuple(one.similarity for one in found), tuple(one.mirrored for one in found)
    return Pieces(each[0], matches, quality, piece, *placed)


def verify_pieces(suspect: GaussianModel, opened: OpenedRecord, *, pieces: Pieces | None = None) -> Claim:
    """Does this model carry the record's mark, parts of it having been moved? One claim from all pieces.

    It is one of one try: how the suspect was taken apart was settled without the chips. Pieces of this suspect and the
    record's reference may be registered already.
    """
    config = VerifyConfig()
    pieces = pieces or register_pieces(opened.reference, suspect, seed=config.seed)
    share = len(np.unique(pieces.matches[pieces.matches >= 0])) / len(opened.reference)
    whole = replace(pieces.registration, matches=pieces.matches, match_quality=pieces.quality, derived_fraction=share)
    notes = (f"read from {len(pieces.placements)} pieces",) if len(pieces.placements) > 1 else ()
    evidence, derivation = read_gaussians(suspect, opened, whole), derivation_of_model(opened.reference, suspect, whole)
    return judge(Reading("model", evidence, whole, notes, derivation=derivation), opened, config)


@dataclass(frozen=True, eq=False)
class ObjectFinding:
    """One record, looked for in a file: found or not, marked or not, and where."""

    record: str
    instance: int  # 0 for the first place at which the record's asset was found, then 1, ...
    claim: Claim
    rows: Int64  # (n,) Gaussians of the file that are the asset's; empty if nothing of it was found
    file_share: float  # n over the file's Gaussians
    asset_share: float  # share of the asset's Gaussians found
    placement: Similarity | None  # x_file = scale * R @ x_asset + t
    mirrored: bool  # whether that holds of the file's mirror image (`mirror_model`)
    low: Float64 | None  # (3,) corners of the box of the 1 % to 99 % quantiles of the matched centers
    high: Float64 | None
    # with a known scene: its objects that hold those Gaussians, and their shares of them, largest first
    objects: tuple[tuple[str, float], ...]


def verify_objects(
    suspect: GaussianModel | FlatScene, records: Mapping[str, OpenedRecord], *, instances: int = 1
) -> list[ObjectFinding]:
    """Look for every record in a file that may hold many objects, moved, turned and scaled each in its own way.

    An asset is looked for `instances` times; a search that finds nothing ends the record's list. The findings come in
    the order of the records, one for each at least, and every claim counts len(records) * instances tries. A FlatScene
    adds which of its objects the finds lie in; the search is the same.
    """
    config = VerifyConfig()
    model = suspect.model if isinstance(suspect, FlatScene) else suspect
    if not len(model):
        raise InputError("the suspect model is empty")
    if not records:
        raise InputError("no record was given")
    if instances < 1:
        raise InputError(f"an asset is looked for at least once, got instances {instances}")
    tries = count_tries(len(records), ("model",), config, places=instances)
    findings = []
    for name, opened in records.items():
        index = ReferenceIndex(opened.reference)
        left = np.arange(len(model), dtype=np.int64)
        for instance in range(instances):
            # What earlier instances matched is set aside by geometry and unmarked looks alone: no chip enters.
            part = model.take(left) if instance else model
            found = register(index, part, seed=config.seed, config=RIGID)
            if instance and not found.found:
                break
            derivation = derivation_of_model(opened.reference, part, found)
            evidence = read_gaussians(part, opened, found)
            claim = judge(Reading("model", evidence, found, derivation=derivation), opened, config, tries)
            rows = left[found.matches >= 0]
            objects = _shares(suspect.owner[rows], suspect.names) if isinstance(suspect, FlatScene) else ()
            placement, low, high = None, None, None
            if len(rows):
                placement = found.similarity.inverse()
                low, high = np.quantile(model.means[rows].astype(np.float64), [0.01, 0.99], axis=0)
            shares = len(rows) / len(model), found.derived_fraction
            findings.append(
                ObjectFinding(name, instance, claim, rows, *shares, placement, found.mirrored, low, high, objects)
            )
            left = left[found.matches < 0]
            if not found.found or len(left) < CONFIG.least_rest:
                break
    return findings


def _shares(owner: Int32, names: tuple[str, ...]) -> tuple[tuple[str, float], ...]:
    counts = np.bincount(owner, minlength=len(names))
    order = np.argsort(-counts, kind="stable")
    return tuple((names[k], float(counts[k] / counts.sum())) for k in order if counts[k])
