"""A real scene through every pair of formats: what the last file lost is what its notes say, Gaussian by Gaussian."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from engine.formats import FORMATS, encode_model, read_model
from engine.formats.file_writing import loss_note
from engine.model import SH_C0, Bool, Float32, GaussianModel

SCENE = Path(__file__).parents[1] / "data" / "train_1000.ply"

STEPS = {
    "splat": {"colors": 1 / 255 / SH_C0},
    "spz": {"colors": 1 / 255 / 0.15, "sizes": 1 / 16, "harmonics": 1 / 64},
    "compressed.ply": {"sizes": 1.0, "harmonics": 1 / 16},
}
"""Within its ranges a format rounds by half of these; the sizes of a compressed PLY by the extent of their chunk."""


@cache
def through(kind: str) -> GaussianModel:
    """The scene, with a few values that few formats hold, as it comes out of a file of this kind."""
    model = read_model(SCENE).model
    log_scales, sh = model.log_scales.copy(), model.sh.copy()
    log_scales[7] = -14.0
    sh[11:14, 0] = [4.0, -4.0, 1.5]
    sh[400:405, 5] = 4.5
    return read_model(encode_model(model.with_(log_scales=log_scales, sh=sh), kind)).model


def matched(before: GaussianModel, after: GaussianModel) -> GaussianModel:
    """The Gaussians of a file in the order that they had: some formats sort them."""
    rows = cKDTree(after.means).query(before.means)[1]
    assert len(np.unique(rows)) == len(before)
    return after.take(rows)


def attribute(model: GaussianModel, name: str) -> Float32:
    found = {"colors": model.sh[:, 0], "sizes": model.log_scales, "harmonics": model.sh[:, 1:]}[name]
    return found.reshape(len(model), -1)


@pytest.mark.parametrize("to", FORMATS)
@pytest.mark.parametrize("come", FORMATS)
def test_what_is_lost_is_told(come: str, to: str) -> None:
    before = through(come)
    after = matched(before, read_model(encode_model(before, to)).model)
    notes = loss_note(before, to)
    expected: dict[str, Bool] = {}
    for name, step in STEPS.get(to, {}).items():
        change = np.abs(attribute(after, name) - attribute(before, name)).max(axis=1, initial=0.0)
        expected[name] = change > step / 2 * 1.01
    size = np.exp(np.median(before.log_scales, axis=1))
    expected["centers"] = np.abs(after.means - before.means).max(axis=1) > size / 20 * 1.001
    expected = {name: lost for name, lost in expected.items() if lost.any()}
    told = {name: note for note in notes for name in ("colors", "sizes", "harmonics", "centers") if f" {name} " in note}
    harmonics_gone = to == "splat" and before.sh_degree > 0
    assert told.keys() - {"harmonics"} == expected.keys() - {"harmonics"}
    for name, lost in expected.items():
        count, row = re.match(r"([\d,]+) Gaussians? \(first in row (\d+)\)", told[name]).groups()  # type: ignore[union-attr]
        assert (int(count.replace(",", "")), int(row)) == (np.count_nonzero(lost), np.argmax(lost)), name
    assert len(notes) == len(expected) + harmonics_gone
