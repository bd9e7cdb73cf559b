"""Screening: which of many assets does a suspect come from? Ranks, seconds and bytes by number of assets.

The scenes are registered among generated strangers (`engine.lab.evaluate.strangers`), and suspects made from them are
held against all: whole, cut, thinned, merged, mirrored, put into a stranger; and pictures over any background, at any
roll.
"""

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from engine.catalogue.catalogue import Catalogue, Likeness, screen_model, screen_pictures
from engine.catalogue.entry import Entry
from engine.formats import read_model
from engine.lab.evaluate.bench.foreign import posted_pictures
from engine.lab.evaluate.strangers import RELATIVES, entry_of, make_stranger, stranger_entries
from engine.lab.evaluate.study import Row
from engine.lab.sim.attacks import model_attack
from engine.lab.sim.model_placement import join
from engine.model import GaussianModel
from engine.numerics.similarity import mirror_model
from engine.registration.sketch import SuspectIndex

PICTURES, PIECES = 20, 5
"""Of each scene."""
INSERTED = 0.5
"""Radius of a piece put into a stranger, in the stranger's."""


def measure_screening(scenes: Sequence[str], seed: int, assets: int) -> list[Row]:
    """A row for each suspect, after one for the index itself."""
    models = {Path(scene).name: read_model(Path(scene)).model for scene in scenes}
    entries: dict[str, Entry] = {name: entry_of(model) for name, model in models.items()}
    for stranger in range(-(-max(0, assets - len(models)) // RELATIVES)):
        for kin, entry in enumerate(stranger_entries(stranger)):
            if len(entries) < max(assets, len(models)):
                entries[f"stranger {stranger}.{kin}"] = entry
    started = time.perf_counter()
    built = Catalogue.build(list(entries), entries.__getitem__)
    building = time.perf_counter() - started
    with tempfile.TemporaryDirectory() as folder:
        built.save(Path(folder))
        size = sum(file.stat().st_size for file in Path(folder).iterdir())
        started = time.perf_counter()
        catalogue = Catalogue.load(Path(folder))
        opening = time.perf_counter() - started
        rows: list[Row] = [
            {
                "suspect": "the index",
                "assets": len(entries),
                "build seconds": building,
                "open seconds": opening,
                "bytes an asset": size / len(entries),
                "entry bytes": float(np.median([len(entry.to_bytes()) for entry in entries.values()])),
            }
        ]
        for name, model in models.items():
            rng = np.random.default_rng(seed)
            for kind, suspect in _models(model, rng):
                rows.append(_ranked(name, kind, partial(_ask, catalogue, suspect)))
            for number, picture in enumerate(posted_pictures(model, PICTURES, rng)):
                row = _ranked(name, "picture", partial(screen_pictures, catalogue, [picture]))
                rows.append({**row, "number": number})
    return rows


def _ranked(name: str, kind: str, ask: Callable[[], list[Likeness]]) -> Row:
    """Rank (0 is first, None not at all) of the right asset."""
    started = time.perf_counter()
    found = ask()
    seconds = time.perf_counter() - started
    ranks = [number for number, each in enumerate(found) if each.name == name]
    votes = found[ranks[0]].votes if ranks else 0.0
    other = max((each.votes for each in found if each.name != name), default=0.0)
    return {
        "suspect": kind,
        "scene": name,
        "rank": ranks[0] if ranks else None,
        "first": ranks[:1] == [0],
        "votes": votes,
        "best other": other,
        "seconds": seconds,
    }


def _ask(catalogue: Catalogue, model: GaussianModel) -> list[Likeness]:
    return screen_model(catalogue, SuspectIndex(model))


def _models(model: GaussianModel, rng: np.random.Generator) -> Iterator[tuple[str, GaussianModel]]:
    yield "whole", model
    yield "mirrored", mirror_model(model)
    for _ in range(PIECES):
        yield "a tenth, cut out", _piece(model, 0.1, rng)
    yield "a tenth, thinned", model.take(np.sort(rng.permutation(len(model))[: len(model) // 10]))
    for share in (0.5, 0.25, 0.1, 0.05):
        yield f"merged to {share}", model_attack("merge").apply(model, share, rng=int(rng.integers(1000)))
    yield "voxels merged to 0.25", model_attack("lod").apply(model, 0.25, rng=int(rng.integers(1000)))
    yield "a quarter, merged to 0.25", model_attack("merge").apply(_piece(model, 0.25, rng), 0.25)
    yield "noise of 0.1", model_attack("noise_all").apply(model, 0.1, rng=int(rng.integers(1000)))
    for number in range(3):
        yield "a tenth, in a stranger", _inserted(_piece(model, 0.1, rng), make_stranger(1_000_000 + number), rng)


def _piece(model: GaussianModel, share: float, rng: np.random.Generator) -> GaussianModel:
    """The Gaussians nearest to a visible one."""
    center = model.means[rng.choice(np.flatnonzero(model.opacities > 0.3))]
    near = np.argsort(np.linalg.norm(model.means - center, axis=1), kind="stable")
    return model.take(np.sort(near[: max(64, int(share * len(model)))]))


def _inserted(piece: GaussianModel, host: GaussianModel, rng: np.random.Generator) -> GaussianModel:
    middle = np.median(piece.means, axis=0)
    size = np.float32(INSERTED / np.quantile(np.linalg.norm(piece.means - middle, axis=1), 0.9))
    means = (piece.means - middle) * size + rng.normal(size=3).astype(np.float32)
    return join(host, piece.with_(means=means, log_scales=piece.log_scales + np.log(size), sh=piece.sh[:, :1]))
