"""Registration of models that were merged into fewer, larger Gaussians, as publishing tools do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.formats import read_model
from engine.lab.sim.attacks import model_attack
from engine.model import GaussianModel
from engine.numerics.similarity import transform_model
from engine.numerics.umeyama import Similarity
from engine.registration.looks_index import ReferenceIndex
from engine.registration.mixtures import Parts, Wholes, _by_axes, _evidence, register_merged
from engine.registration.registration_search import Registration, RegistrationConfig, register
from tests.registration.registration_cases import MOVES

SCENE = Path(__file__).parents[1] / "data" / "plant.splat"


@pytest.fixture(scope="module")
def index() -> ReferenceIndex:
    """A connected fifth of the plant."""
    return ReferenceIndex(model_attack("crop").apply(read_model(SCENE).model, 20_000 / 113_648, rng=1))


def merged(index: ReferenceIndex, share: float, name: str = "merge", reading: str | None = None) -> GaussianModel:
    return model_attack(name).apply(index.model, share, reading=reading)


def residual(index: ReferenceIndex, suspect: GaussianModel, got: Registration) -> np.ndarray:
    """(n,) how far each explained Gaussian's colour is from that of its mixture."""
    mixtures, m = got.mixtures, len(suspect)
    dc = index.model.sh[mixtures.reference_rows, 0].astype(np.float64)
    mean = np.stack([np.bincount(mixtures.suspect_rows, mixtures.shares * dc[:, c], m) for c in range(3)], axis=1)
    return np.asarray(np.linalg.norm(suspect.sh[:, 0] - mean, axis=1)[mixtures.explained(0.1)])


@pytest.mark.parametrize(
    ("name", "reading", "share"),
    [("merge", "as_code", 0.5), ("merge", "as_code", 0.1), ("merge", "literal", 0.25), ("lod", None, 0.1)],
)
def test_merged_models_are_mixtures(index: ReferenceIndex, name: str, reading: str | None, share: float) -> None:
    suspect = merged(index, share, name, reading)
    got = register(index, suspect)
    assert got.found
    assert got.mixed is not None
    assert not got.deformed
    assert got.derived_fraction > 0.85
    np.testing.assert_allclose(got.scale * got.R, np.eye(3), atol=5e-3)
    spread = float(np.linalg.norm(index.model.sh[:, 0].std(axis=0)))
    assert np.median(residual(index, suspect, got)) < 0.15 * spread


def test_pairs_are_found_nearly_all(index: ReferenceIndex) -> None:
    """At one half: the colour that the reference predicts is the suspect's own, but for a few."""
    suspect = merged(index, 0.5, reading="as_code")
    assert np.median(residual(index, suspect, register(index, suspect))) < 2e-3


@pytest.mark.parametrize(("share", "move"), [(0.5, "small"), (0.1, "large"), (0.05, "tiny"), (0.1, "z-up")])
def test_a_merged_model_is_found_wherever_it_was_moved(index: ReferenceIndex, share: float, move: str) -> None:
    scale, R, t = MOVES[move]
    got = register(index, transform_model(merged(index, share, reading="as_code"), scale, R, t))
    assert got.found
    assert got.mixed is not None
    np.testing.assert_allclose(got.scale * scale, 1.0, atol=5e-3)
    np.testing.assert_allclose(got.R @ R, np.eye(3), atol=1e-2)
    assert got.derived_fraction > 0.9


def test_axes_propose_the_similarity_up_to_their_directions(index: ReferenceIndex) -> None:
    """Four proper rotations, one of them right: with an uneven model, whatever eigenvectors come out."""
    model = index.model.take(np.arange(0, len(index.model), 20))
    for seed in range(6):
        R = Rotation.random(random_state=seed).as_matrix()
        fits = _by_axes(Parts.of(model), Parts.of(transform_model(model, 3.0, R, np.array([1.0, 2.0, 3.0]))))
        assert [np.linalg.det(fit.R) > 0 for fit in fits] == [True] * 4
        assert min(np.abs(fit.R @ R - np.eye(3)).max() for fit in fits) < 1e-3
        assert fits[0].scale == pytest.approx(1 / 3.0, rel=1e-4)


def test_where_the_place_is_known_the_looks_must_agree(index: ReferenceIndex) -> None:
    rng = np.random.default_rng(0)
    swapped = index.model.take(rng.permutation(len(index.model))).with_(means=index.model.means)
    assert register_merged(index, swapped, Similarity.identity(), [], rng) is None
    thin = merged(index, 0.25)
    assert register_merged(index, thin, Similarity.identity(), [], rng) is not None


def test_evidence_of_a_placement_does_not_depend_on_units(index: ReferenceIndex) -> None:
    model = index.model.take(np.arange(0, len(index.model), 20))
    parts = Parts.of(model)
    here = _evidence(Wholes(model), parts, Similarity.identity(), index.extent)
    small = transform_model(model, 0.01, np.eye(3), np.zeros(3))
    there = _evidence(Wholes(small), parts, Similarity(100.0, np.eye(3), np.zeros(3)), index.extent)
    assert here > 1.0
    assert there == pytest.approx(here, rel=1e-3)


@pytest.mark.parametrize("share", [0.25, 0.1])
def test_a_piece_of_a_merged_model_is_found_in_place(index: ReferenceIndex, share: float) -> None:
    piece = model_attack("crop").apply(merged(index, share, reading="as_code"), 0.25, rng=2)
    got = register(index, piece)
    assert got.found
    assert got.mixed is not None
    assert 0.1 < got.derived_fraction < 0.4
    np.testing.assert_allclose(got.scale * got.R, np.eye(3), atol=1e-2)


def test_one_to_one_suspects_are_not_mixed(index: ReferenceIndex) -> None:
    for name, strength in (("prune_random", 0.7), ("noise_all", 0.05), ("convert", "splat"), ("clone", 0.5)):
        got = register(index, model_attack(name).apply(index.model, strength))
        assert got.found
        assert got.mixed is None, name


def test_mixtures_are_not_looked_for_where_nobody_asks(index: ReferenceIndex) -> None:
    suspect = merged(index, 0.1, reading="as_code")
    assert register(index, suspect, config=RegistrationConfig(merged=False, deformed=False)).mixed is None


def test_strangers_are_no_mixtures(index: ReferenceIndex) -> None:
    """The scene's own places under the looks of others, and a merged stranger."""
    rng = np.random.default_rng(0)
    model = index.model
    swapped = model.take(rng.permutation(len(model))).with_(means=model.means)
    other = model_attack("crop").apply(read_model(SCENE).model, 20_000 / 113_648, rng=7)
    shifted = other.with_(means=other.means - other.means.mean(axis=0) + model.means.mean(axis=0))
    for stranger in (swapped, model_attack("merge").apply(shifted, 0.25, reading="as_code")):
        assert not register(index, stranger, config=RegistrationConfig(deformed=False)).found
