"""Both layers of a mark in one evidence, and each by itself.

A suspect with one copy's geometry and another's colors would hide the second copy's tint under the first one's grain.
So three hypotheses are tested and counted: both layers together, the tint alone, the grain alone. Pictures are read in
two ways (`image_evidence.PictureEvidence`); all three are tested in each.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from engine.watermark.messages import Signs
from engine.watermark.model_evidence import Evidence
from engine.watermark.statistics import weighted_evidence

LAYERS = ("both", "tint", "grain")
"""Questions that an evidence can answer."""


@dataclass(frozen=True)
class Layered:
    """Z of each question, and of which one |Z| is largest."""

    z: Mapping[str, float]  # without the grain where there is none
    strongest: str

    @property
    def best(self) -> float:
        """Z of the strongest, with its sign."""
        return self.z[self.strongest]


def layered_z(evidence: Evidence, signs: Signs, tint: int, *, either_way: bool = False) -> Layered:
    """Z of each question that an evidence answers, as `statistics.claim_z` gives it.

    ValueError unless there are C signs.

    Copies of one asset have a reference in common, not signs, cells or amplitudes: each is read and tested by itself.
    When n of them are averaged each keeps 1 / n of its displacement, and its sisters' are noise to it: Z falls as
    1 / sqrt(n). Rules that pick what few copies have turn Z round.

    Parameters
    ----------
    signs : (C,) +-1
        Chip times bit of the registered message.
    tint : int
        How many of the chips are the tint's; the grain's follow.
    either_way : bool
        Whether a Z below zero speaks as loudly as one above.
    """
    c = weighted_evidence(evidence.y, evidence.weights)
    if len(signs) != len(c):
        raise ValueError(f"a mark has {len(signs)} signs, the evidence {len(c)} chips")
    terms = c * signs
    parts = layer_parts(len(c), tint).items()
    sums = {name: (float(terms[part].sum()), float(c[part] @ c[part])) for name, part in parts}
    total = sum(t for t, _ in sums.values()), sum(n for _, n in sums.values())
    z = {name: t / math.sqrt(n) if n > 0 else 0.0 for name, (t, n) in ({"both": total} | sums).items()}
    return Layered(z, max(z, key=lambda name: abs(z[name]) if either_way else z[name]))


def layer_parts(chips: int, tint: int) -> dict[str, slice]:
    """Where the chips of each layer lie, by its name, without the grain where there is none."""
    return {"tint": slice(0, tint)} | ({"grain": slice(tint, None)} if chips > tint else {})


def only(evidence: Evidence, layer: str, tint: int) -> Evidence:
    """The evidence with the other layer's weights at zero."""
    if layer == "both":
        return evidence
    keep = np.arange(len(evidence.y)) < tint
    weights = np.where(keep if layer == "tint" else ~keep, evidence.weights, 0.0)
    return Evidence(evidence.y, weights, np.where(weights > 0, evidence.signal, 0.0), pulled=evidence.pulled)
