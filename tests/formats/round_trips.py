"""Scenes through every pair of formats: what the second file lost, by the values and by its notes.

    python -m tests.formats.round_trips train_1000.ply plant.splat --most 4000

measures scenes (of larger ones, so many Gaussians evenly through the file) and prints what each format loses at most.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from engine.formats import FORMATS, encode_model, read_model
from engine.formats.file_writing import loss_note
from engine.model import SH_C0, Float32, Float64, GaussianModel

KINDS = (*FORMATS, *(("usdc",) if importlib.util.find_spec("pxr") else ()))
"""The other forms of OpenUSD hold the same values."""
STEPS = {
    "splat": {"colors": 1 / 255 / SH_C0},
    "spz": {"colors": 1 / 255 / 0.15, "sizes": 1 / 16, "harmonics": 1 / 64},
    "compressed.ply": {"sizes": 1.0, "harmonics": 1 / 16},
}
"""Within its ranges a format rounds by half of these; the sizes of a compressed PLY by the extent of their chunk."""
_EDGE = 1.02
"""Values so near to what goes without a note are on either side of it."""
OPACITY = {"splat": 1 / 510, "spz": 1 / 510, "sog": 1 / 510, "compressed.ply": 1 / 510}
TURN = {"splat": 0.9, "spz": 0.25, "sog": 1.4, "compressed.ply": 0.25}
"""Degrees by which orientations may be off; of the others, what float32 leaves."""


@dataclass(frozen=True)
class Trip:
    """What writing a model lost, and whether its notes say so."""

    losses: int  # kinds of them
    notes: int
    faults: tuple[str, ...]  # what is lost and not told, told and not lost, or told with other rows
    opacity: float  # largest difference
    turn: float  # degrees


def round_trip(before: GaussianModel, to: str) -> Trip:
    """Write a model and read it back."""
    after = read_model(encode_model(before, to)).model
    losses = int(before.carried is not None and after.carried is None)  # comments, properties that no Gaussian has
    after = _matched(before, after)
    beyond: dict[str, Float32] = {}  # 1 where a value is off by as much as goes without a note
    for name, step in STEPS.get(to, {}).items():
        change = np.abs(_attribute(after, name) - _attribute(before, name)).max(axis=1, initial=0.0)
        beyond[name] = change / (step / 2)
    size = np.exp(np.median(before.log_scales, axis=1))
    beyond["centers"] = np.abs(after.means - before.means).max(axis=1) / (size / 20)
    notes = loss_note(before, to)
    told = {}
    for note, name in itertools.product(notes, beyond):
        if found := re.match(rf"([\d,]+) Gaussians? \(first in row (\d+)\).* {name} ", note):
            told[name] = (int(found[1].replace(",", "")), int(found[2]))
    faults = []
    for name, share in beyond.items():
        count, row = told.get(name, (0, 0))
        sure, maybe = np.count_nonzero(share > _EDGE), share > 1 / _EDGE
        if not sure <= count <= np.count_nonzero(maybe) or (count and not maybe[row]):
            faults.append(f"{name} of {sure} Gaussians lost, of {count} told (from row {row})")
    losses += sum(bool((share > _EDGE).any()) for share in beyond.values())
    if to == "splat" and before.sh_degree:
        losses += 1
        faults += [] if any("no spherical harmonics" in note for note in notes) else ["degree lost and not told"]
    opacity = float(np.abs(after.opacities - before.opacities).max())
    return Trip(losses, len(notes), tuple(faults), opacity, _turn(before, after))


def _matched(before: GaussianModel, after: GaussianModel) -> GaussianModel:
    """The Gaussians of a file in the order that they had: some formats sort them."""
    rows = cKDTree(after.means).query(before.means)[1]
    assert len(np.unique(rows)) == len(before)
    return after.take(rows)


def _attribute(model: GaussianModel, name: str) -> Float32:
    found = {"colors": model.sh[:, 0], "sizes": model.log_scales, "harmonics": model.sh[:, 1:]}[name]
    return found.reshape(len(model), -1)


def _turn(before: GaussianModel, after: GaussianModel) -> float:
    a, b = (_unit(model.quats) for model in (before, after))
    b *= np.where((a * b).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
    return float(np.degrees(4 * np.arcsin(np.minimum(np.linalg.norm(a - b, axis=1) / 2, 1.0))).max())


def _unit(quats: Float32) -> Float64:
    exact = quats.astype(np.float64)
    return np.asarray(exact / np.linalg.norm(exact, axis=1, keepdims=True))


def _apart(model: GaussianModel, most: int) -> GaussianModel:
    """So many Gaussians at most, none so near another that a format could hold both at one place."""
    few = model.take(np.arange(0, len(model), -(-len(model) // most)))
    near = cKDTree(few.means).query(few.means, k=2)[0][:, 1]
    return few.take(np.flatnonzero(near > 2e-3 * np.median(near)))


def _trips(model: GaussianModel) -> Iterator[tuple[str, str, Trip]]:
    for come in KINDS:
        before = read_model(encode_model(model, come)).model
        for to in KINDS:
            yield come, to, round_trip(before, to)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--most", type=int, default=4000, help="Gaussians of a scene")
    options = parser.parse_args()
    faults = 0
    for path in options.scenes:
        whole = read_model(path).model
        model = _apart(whole, options.most)
        trips = list(_trips(model))
        lines = [f"{path.name}: {len(model):,} of {len(whole):,} Gaussians, {len(trips)} pairs"]
        lines.append(
            f"{sum(trip.notes for *_, trip in trips)} notes on {sum(trip.losses for *_, trip in trips)} losses"
        )
        for to in KINDS:
            mine = [trip for _, other, trip in trips if other == to]
            lines.append(f"  {to}: opacity {max(t.opacity for t in mine):.2g}, {max(t.turn for t in mine):.2g} degrees")
        wrong = [f"  {come} to {to}: {fault}" for come, to, trip in trips for fault in trip.faults]
        faults += len(wrong)
        sys.stdout.write("\n".join([*lines, *wrong, ""]))
        sys.stdout.flush()
    sys.exit(faults > 0)


if __name__ == "__main__":
    main()
