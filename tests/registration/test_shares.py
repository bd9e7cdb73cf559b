"""The share of the asset that is called derived, after what other programs do to it."""

from __future__ import annotations

from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from engine.formats import read_model, write_model
from engine.model import ATTRIBUTES, GaussianModel
from engine.registration.matching import clipped_at
from engine.registration.registration_search import RegistrationConfig, register
from tests.parameters import few
from tests.registration.outside_tools import along_a_curve, moved_elsewhere, resaved
from tests.registration.registration_cases import TRAIN, marked, near, noised, scene, shuffled, train

RIGID = RegistrationConfig(deformed=False)
MOVES = {
    "tiny": (0.03, (10.0, 100.0, 3.0), (0.0, 0.0, 0.0)),
    "large": (12.0, (0.0, 0.0, 0.0), (40.0, 0.0, -9.0)),
    "turned": (1.7, (20.0, 30.0, 40.0), (1.0, 2.0, 3.0)),
}


@cache
def plant() -> GaussianModel:
    """A tenth of a real scene, sorted along a curve as its file was packed."""
    model = read_model(TRAIN.parent / "plant.splat").model
    model = model.take(np.arange(0, len(model), 10))
    return model.take(along_a_curve(model.means))


@pytest.mark.parametrize(
    ("format", "move"),
    few(
        [("splat", "tiny"), ("spz", "large"), ("sog", "turned"), ("compressed.ply", "turned")],
        product(["splat", "spz", "sog", "compressed.ply"], MOVES),
    ),
)
def test_a_whole_copy_is_the_whole_asset(tmp_path: Path, format: str, move: str) -> None:
    for model in (plant(), train()):
        suspect = resaved(moved_elsewhere(marked(model), *MOVES[move]), format, tmp_path)
        got = register(model, suspect, config=RIGID)
        assert got.found
        # of a thousand wide-spread Gaussians, a chunk of 256 spans the scene: its positions are coarse
        assert got.derived_fraction > (0.98 if model is plant() or format != "compressed.ply" else 0.92)


@pytest.mark.parametrize("format", ["spz", "compressed.ply"])
@pytest.mark.parametrize("share", [0.5, 0.1])
def test_a_piece_is_its_share(tmp_path: Path, format: str, share: float) -> None:
    model = plant()
    part = marked(model).take(near(model, share))
    suspect = resaved(moved_elsewhere(part, *MOVES["tiny"]), format, tmp_path)
    assert register(model, suspect, config=RIGID).derived_fraction == pytest.approx(share, abs=0.02)


def test_half_an_order_is_not_half_a_copy() -> None:
    """Sorted again along a curve after noise too small to see, most neighbours in number have changed places."""
    model = plant()
    rng = np.random.default_rng(0)
    kept = np.arange(len(model))
    swapped = np.flatnonzero(rng.random(len(model) // 2) < 0.45) * 2
    kept[swapped], kept[swapped + 1] = swapped + 1, swapped
    got = register(model, moved_elsewhere(marked(model).take(kept), *MOVES["turned"]), config=RIGID)
    assert got.hypotheses_tried == 1
    assert got.derived_fraction > 0.98
    assert (got.matches == kept).mean() > 0.98


def test_pairs_out_of_order_do_not_blur_those_in_order() -> None:
    """Half of a slightly noisy copy thrown about: errors measured on all pairs would let wrong ones pass."""
    model = plant()
    rng = np.random.default_rng(0)
    kept = np.arange(len(model))
    rows = np.flatnonzero(rng.random(len(model)) < 0.49)
    kept[rows] = rng.permutation(rows)
    got = register(model, moved_elsewhere(noised(marked(model), 0.02).take(kept), *MOVES["turned"]), config=RIGID)
    assert got.hypotheses_tried == 1
    assert (got.matches == kept).mean() > 0.9997


def test_strangers_in_an_order_are_not_matched() -> None:
    """A third replaced by another scene's Gaussians, at their places in the file."""
    model, other = scene(0), scene(1)
    rows = np.random.default_rng(0).random(len(model)) < 1 / 3
    names = ATTRIBUTES
    suspect = GaussianModel(
        *(
            np.where(rows.reshape(-1, *[1] * (getattr(model, n).ndim - 1)), getattr(other, n), getattr(model, n))
            for n in names
        )
    )
    got = register(model, suspect, config=RIGID)
    assert got.derived_fraction == pytest.approx(2 / 3, abs=0.02)
    assert (got.matches[rows] >= 0).mean() < 0.01


def test_sizes_that_a_format_clips_are_one_size() -> None:
    model = scene(0, 12_000)
    order = shuffled(model)
    clip = float(np.quantile(model.log_scales, 0.4))
    cut = marked(model).with_(log_scales=np.maximum(model.log_scales, clip))
    for suspect in (cut, cut.take(order)):
        got = register(model, moved_elsewhere(suspect, 0.5, (10.0, 20.0, 30.0), (0.0, 0.0, 0.0)), config=RIGID)
        assert got.derived_fraction > 0.99
    fit = got.similarity
    assert clipped_at(model, moved_elsewhere(cut, 0.5, (10.0, 20.0, 30.0), (0.0, 0.0, 0.0)), fit) == pytest.approx(
        clip, abs=0.01
    )
    assert clipped_at(model, marked(model).take(order[:6000]), fit) == -np.inf


def test_noise_keeps_the_share() -> None:
    model = scene(0)
    order = shuffled(model, 0.5)
    got = register(model, moved_elsewhere(noised(marked(model), 0.05).take(order), *MOVES["turned"]), config=RIGID)
    assert got.derived_fraction == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("move", [*list(MOVES)[:-1], pytest.param("turned", marks=pytest.mark.long)])
def test_another_scene_is_no_part(tmp_path: Path, move: str) -> None:
    """Each pair of scenes is searched for bent pieces too under one of the moves, for a similarity under all."""
    pairs = ((plant(), scene(1)), (train(), plant()), (scene(0), train()))
    for number, (model, other) in enumerate(pairs):
        suspect = resaved(moved_elsewhere(other, *MOVES[move]), "spz", tmp_path)
        got = register(model, suspect, config=RegistrationConfig() if move == list(MOVES)[number] else RIGID)
        assert not got.found
        assert got.derived_fraction == 0


def test_a_file_sorted_again_after_every_center_moved_a_little_keeps_no_order(tmp_path: Path) -> None:
    """Nearly all rows stand a place or two from where they stood: each is found, and not its neighbor."""
    whole = read_model(TRAIN.parent / "plant.splat").model

    def packed(model: GaussianModel) -> GaussianModel:
        write_model(model, tmp_path / "a.compressed.ply")
        return read_model(tmp_path / "a.compressed.ply").model

    reference = packed(whole)
    rng = np.random.default_rng(4)
    gaps = 0.003 * np.exp(reference.log_scales) * rng.normal(size=(len(reference), 3))
    suspect = packed(reference.with_(means=(reference.means + gaps).astype(np.float32)))
    found = register(reference, suspect)
    off = np.linalg.norm(reference.means[found.matches] - suspect.means, axis=1)
    assert np.median(off / np.exp(reference.log_scales[found.matches].mean(axis=1))) < 0.2
