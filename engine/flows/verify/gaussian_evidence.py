"""From a suspect model to evidence about each chip, by its Gaussians alone; `suspect_evidence` has what asks for
renders and pictures, and for all that reads them.

Of the copy layer there is one reading for all copies of an asset, blind to the chips of each.
"""

from dataclasses import replace

import numpy as np

from engine.flows.records.opened_record import OpenedRecord, owner_displacements
from engine.flows.verify.config import CONFIG
from engine.model import Float32, GaussianModel, Int32
from engine.numerics.gaussians import surface_mass
from engine.numerics.similarity import mirror_model
from engine.registration.registration_search import Registration
from engine.watermark.claim import Derivation
from engine.watermark.copy_layer import CopyLayer, grain_without_owner, without_owner
from engine.watermark.grain_evidence import gather_grain_evidence
from engine.watermark.model_evidence import Evidence, Residual, compare_colors, gather_residual

_CONFIG = CONFIG.evidence


def derivation_of_model(reference: GaussianModel, suspect: GaussianModel, registration: Registration) -> Derivation:
    """What the matched Gaussians say; where every one was taken for a mixture, what these were made of."""
    rows = np.flatnonzero(registration.matches >= 0)
    if not registration.found:
        return Derivation(False, 0.0, 0)
    matched, recognised = registration.matches[rows], len(rows)
    seen = matched
    if not recognised:
        seen, recognised = registration.mixtures.reference_rows, int(registration.mixtures.explained().sum())
    low, high = np.quantile(reference.means[seen].astype(np.float64), [0.01, 0.99], axis=0)
    exactness = None
    if len(rows) and not registration.deformed:
        part = slice(None, None, max(1, len(rows) // _CONFIG.sample))
        placed = registration.similarity.apply(suspect.means[rows[part]].astype(np.float64))
        gaps = np.linalg.norm(placed - reference.means[matched[part]], axis=1)
        sizes = np.exp(reference.log_scales[matched[part]].mean(axis=1, dtype=np.float64))
        exactness = float(np.median(gaps / sizes))
    share = registration.derived_fraction
    where = (float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2]))
    return Derivation(share >= _CONFIG.derived_least, share, recognised, exactness, where)


def read_gaussians(suspect: GaussianModel, opened: OpenedRecord, registration: Registration) -> Evidence:
    """Displacements of the suspect's own colours from those of the Gaussians they are matched to (Eq 10), and where the
    record has a grain, of its centres and sizes.
    """
    return read_layers(suspect, opened, registration)[0]


def read_layers(
    suspect: GaussianModel, opened: OpenedRecord, registration: Registration
) -> tuple[Evidence, Evidence | None]:
    """Of the layer that carries the claim, as `read_gaussians`; and of the copy layer, where the record has one."""
    weights = duplicate_weights(suspect, registration.matches)
    compared = compare_tint(suspect, opened, registration, weights)
    tint = read_tint(opened, compared)
    grain = read_grain(suspect, opened, registration, weights) if opened.grain.there else None
    return tint if grain is None else tint.then(grain), copy_of_gaussians(opened, compared, grain)


def read_tint(opened: OpenedRecord, compared: Residual) -> Evidence:
    """What the suspect's colours say, in the cells of this record; `compared` as `compare_tint` gives it."""
    tint = gather_residual(opened.layout, compared)
    return replace(tint, signal=opened.strength * tint.signal)


def compare_tint(
    suspect: GaussianModel, opened: OpenedRecord, registration: Registration, weights: Float32
) -> Residual:
    """How far the suspect's colours lie from the reference's: copies with carriers of one width share it. `weights`
    (M,) are those of `duplicate_weights`."""
    seen = suspect if opened.layout.width == 3 else registration.place(suspect)  # DC does not depend on the direction
    reference, colors = (model.sh.reshape(len(model), -1) for model in (opened.reference, seen))
    width = min(opened.layout.width, colors.shape[1])
    mixtures = registration.mixtures
    mixtures = replace(mixtures, quality=mixtures.quality * weights)
    return compare_colors(reference[:, :width], colors[:, :width], mixtures)


def duplicate_weights(suspect: GaussianModel, matches: Int32) -> Float32:
    """(M,) weight of each Gaussian of the suspect among those that `matches` (M,) take for one of the reference:
    opacity times surface, against the heaviest. Otherwise near twins that hardly show would outvote what does."""
    weights = np.ones(len(suspect), np.float32)
    rows = np.flatnonzero(matches >= 0)
    rows = rows[np.bincount(matches[rows])[matches[rows]] > 1]
    if len(rows):
        mass, target = surface_mass(suspect.take(rows)), matches[rows]
        heaviest = np.zeros(int(target.max()) + 1)
        np.maximum.at(heaviest, target, mass)
        share = mass / np.maximum(heaviest[target], np.finfo(np.float64).tiny)
        weights[rows] = np.where(share >= _CONFIG.like_mass, 1.0, share)
    return weights


def read_grain(suspect: GaussianModel, opened: OpenedRecord, registration: Registration, weights: Float32) -> Evidence:
    """What the suspect's centres and sizes say, for all copies of an asset; `weights` as for `compare_tint`."""
    seen = mirror_model(suspect) if registration.mirrored else suspect
    pairs = registration.matches, registration.match_quality * weights
    return gather_grain_evidence(opened.grain, opened.reference, seen, registration.similarity, *pairs)


def copy_of_gaussians(opened: OpenedRecord, compared: Residual, grain: Evidence | None) -> Evidence | None:
    """Of a registered model, from its differences of colors and the evidence of its grain; None where the record has
    no copy layer."""
    if opened.copies is None:
        return None
    tint, rough = owner_displacements(opened)
    said = gather_residual(opened.copies.layout, without_owner(compared, tint.astype(np.float64)))
    if grain is None or rough is None or not opened.copies.grain.there:
        return said
    return said.then(_weighed(grain_without_owner(grain, rough), opened, opened.copies))


def _weighed(grain: Evidence, opened: OpenedRecord, copies: CopyLayer) -> Evidence:
    """Evidence of the owner's grain as that of the copies', which is of another size."""
    own, owners = copies.grain, opened.grain  # in one proportion, whichever of the two there is
    times = own.center / owners.center if owners.center > 0 else own.scale / owners.scale
    linear = None if grain.linear is None else times * grain.linear
    return replace(grain, weights=times * grain.weights, signal=times * grain.signal, linear=linear)
