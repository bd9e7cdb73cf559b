"""The derivation that a registration, or the sight of the asset, stands for. Blind to all chips."""

import numpy as np

from engine.model import GaussianModel
from engine.registration.registration_search import Registration
from engine.watermark.derivation import NOT_FOUND, Derivation

__all__ = ["DERIVED_LEAST", "derivation_of_model", "derivation_of_pictures", "derivation_of_sight"]

DERIVED_LEAST = 0.02
"""Share of the reference to be found before a suspect is called derived from it."""
SAMPLE = 50_000
"""Matched Gaussians of which the exactness is measured."""


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
        part = slice(None, None, max(1, len(rows) // SAMPLE))
        placed = registration.similarity.apply(suspect.means[rows[part]].astype(np.float64))
        gaps = np.linalg.norm(placed - reference.means[matched[part]], axis=1)
        sizes = np.exp(reference.log_scales[matched[part]].mean(axis=1, dtype=np.float64))
        exactness = float(np.median(gaps / sizes))
    share = registration.derived_fraction
    where = (float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2]))
    return Derivation(share >= DERIVED_LEAST, share, recognised, exactness, where)


def derivation_of_sight(of_model: Derivation, recognised: bool) -> Derivation:
    """What renders of a suspect model say, beside its Gaussians: views recognised by themselves, or nothing."""
    if of_model.derived or not recognised:
        return of_model
    return Derivation(True, of_model.share or None, of_model.gaussians)


def derivation_of_pictures(shown: int, pictures: int, found: bool) -> Derivation:
    """What pictures say of which so many show the asset; `found`: their cameras were found, by recognising it.

    Where somebody gave the cameras, a picture of anything that is bright in the same places can be laid over a view.
    """
    return Derivation(shown > 0, views=(shown, pictures)) if found else NOT_FOUND
