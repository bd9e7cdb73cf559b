"""Screening: which of many assets does a suspect come from? Ranks, seconds and bytes by number of assets.

The scenes are registered among generated strangers (`engine.evaluate.strangers`), and suspects made from them are held
against all: whole, cut, thinned, merged, mirrored, put into a stranger; and pictures over any background, at any roll.
"""

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from engine.catalogue.catalogue import Catalogue
from engine.catalogue.entry import Entry
from engine.catalogue.screening import Likeness, screen_model, screen_pictures
from engine.evaluate.strangers import RELATIVES, entry_of, make_stranger, stranger_entries
from engine.evaluate.study import Row
from engine.formats import read_model
from engine.model import Float32, GaussianModel, look_at
from engine.numerics.similarity import mirror_model
from engine.pipeline.rigs import UP, direction, measure_extent
from engine.raster import render_depth
from engine.registration.sketch import SuspectIndex
from engine.sim.attacks import image_attack, model_attack
from engine.sim.model_placement import join

PICTURES, PIECES = 20, 5
"""Of each scene."""
SIZES = ((1280, 720), (960, 760), (540, 960))
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
                rows.append(_asked(name, kind, partial(_ask, catalogue, suspect)))
            for number, picture in enumerate(_pictures(model, rng)):
                told = _asked(name, "picture", partial(screen_pictures, catalogue, [picture]))
                rows.append({**told, "number": number})
    return rows


def _asked(name: str, kind: str, ask: Callable[[], list[Likeness]]) -> Row:
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


def _pictures(model: GaussianModel, rng: np.random.Generator) -> Iterator[Float32]:
    """JPEG 80 files of any view, roll and background, a quarter of them mirrored."""
    extent = measure_extent(model)
    flat = extent.axes[1] <= 0.2 * max(extent.axes[0], extent.axes[2])  # seen from the air, as it was captured
    for _ in range(PICTURES):
        width, height = SIZES[int(rng.integers(len(SIZES)))]
        lens = np.radians(rng.uniform(30.0, 75.0))
        toward = direction(
            rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(20.0, 75.0) if flat else rng.uniform(-5.0, 60.0))
        )
        distance = extent.radius / np.sin(0.5 * lens) / np.exp(rng.uniform(np.log(0.6), np.log(2.0)))
        target = extent.center + 0.2 * extent.radius * rng.normal(size=3)
        roll = rng.uniform(-np.pi, np.pi)
        up = UP * np.cos(roll) + np.cross(toward, UP) * np.sin(roll)
        focal = 0.5 * min(width, height) / np.tan(0.5 * lens)
        camera = look_at(target + distance * toward, target, up, focal, width, height)
        image, alpha, _ = render_depth(model, camera)
        behind = rng.uniform(0, 1, 3) * rng.uniform(0.3, 1.0, (height, 1, 1))
        picture = np.clip(image + (1.0 - alpha[..., None]) * behind, 0.0, 1.0).astype(np.float32)
        picture = picture[:, ::-1] if rng.random() < 0.25 else picture
        yield image_attack("jpeg").apply(np.ascontiguousarray(picture), 80)
