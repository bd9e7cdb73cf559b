"""How a model was trained to be drawn, as files say it, and what follows from it.

Brush writes ``comment SplatRenderMode: mip`` (or ``2dgs``) into a PLY, Postshot ``comment antialiased 1``; SOG has a
member ``model`` in meta.json, SPZ a bit of its flags (nianticlabs/spz, README). Which wins, and how each is spelt on
the way out, is as in playcanvas/splat-transform (``test/splat-model.test.mjs``).
"""

import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from engine.formats.repairs import LOG_SCALE_RANGE
from engine.model import DISC_THICKNESS, GaussianModel

ANTIALIASED, DISCS = "antialiased", "2dgs"

_COMMENT = re.compile(r"\s*(?:splatrendermode:\s*(\w+)|antialiased\s+(\d+))\s*", re.IGNORECASE)
_SPELT = {"mip": ANTIALIASED, "2dgs": DISCS, "1": ANTIALIASED}
_BRUSH = {ANTIALIASED: "mip", DISCS: "2dgs"}


def mode_of_comments(comments: Iterable[str]) -> str | None:
    """The mode that the last comment to name one says, None for the usual one; an unknown one is the usual one."""
    found = [match for match in map(_COMMENT.fullmatch, comments) if match]
    return _SPELT.get((found[-1][1] or found[-1][2]).lower()) if found else None


def comment_of(model: GaussianModel) -> list[str]:
    """The comment that says how to draw a model, where that is not the usual way: no line, or one."""
    mode = mode_of(model)
    return [f"comment SplatRenderMode: {_BRUSH[mode]}"] if mode else []


def mode_of(model: GaussianModel) -> str | None:
    """How a model is to be drawn, None for the usual way."""
    if model.is_flat:
        return DISCS
    return ANTIALIASED if model.antialiased else None


def with_mode(model: GaussianModel, mode: object) -> GaussianModel:
    """The model with what its file says about drawing it; anything but the two modes changes nothing.

    Discs in a format of three scales get their third one back, which the format rounded: their plane is that of the
    first two axes. What is flat stays so whatever is said.
    """
    if mode == DISCS:
        third = model.log_scales[:, :2].min(axis=1) + np.float32(np.log(DISC_THICKNESS))
        scales = np.column_stack([model.log_scales[:, :2], np.maximum(third, np.float32(LOG_SCALE_RANGE[0]))])
        return replace(model, log_scales=scales)
    return replace(model, antialiased=True) if mode == ANTIALIASED and not model.is_flat else model
