"""What a suspect says of the copy layer: one reading for all copies of an asset, blind to the chips of each.

The owner's layer is known to the reader, and taken off first: signs of one layer are fair whatever the other's are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.flows.embed.copy_mark import owner_displacements
from engine.flows.records.opened_record import OpenedRecord
from engine.watermark.copy_layer import CopyLayer, grain_without_owner, without_owner
from engine.watermark.image_evidence import gather_again
from engine.watermark.model_evidence import Evidence, Residual, gather_residual

__all__ = ["copy_of_gaussians", "copy_of_pictures"]


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


def copy_of_pictures(opened: OpenedRecord, said: Evidence) -> Evidence | None:
    """Of pictures, from what they say of the owner's layer; None where the record has no copy layer."""
    if opened.copies is None:
        return None
    tint = gather_again(opened.copies.layout, said.pulled)
    return tint.then(said.behind(opened.layout.chips)) if opened.copies.grain.there else tint
