from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.errors import FormatError
from engine.formats import read_model
from engine.lab.sim.attacks import model_attack
from engine.lab.sim.model_placement import foreign_scene
from engine.model import GaussianModel
from engine.numerics.similarity import mirror_model
from engine.registration.config import CONFIG
from engine.registration.sketch import Sketch, SuspectIndex, make_sketch
from tests.registration.outside_tools import merged_to
from tests.registration.registration_cases import marked, moved, near
from tests.registration.registration_cases import scene as clusters

DATA = Path(__file__).parents[1] / "data"


@pytest.fixture(scope="module")
def sketch(plant: GaussianModel) -> Sketch:
    return Sketch.from_bytes(make_sketch(plant).to_bytes())


@pytest.mark.parametrize(
    ("name", "strength", "least"),
    [
        ("similarity", 10.0, 400),
        ("shuffle", 1.0, 400),
        ("crop", 0.1, 100),
        ("crop", 0.02, 15),
        ("prune_random", 0.9, 100),
        ("prune_opacity", 0.5, 400),
        ("clone", 0.5, 300),
        ("noise_all", 0.1, 200),
        ("convert", "spz", 400),
        ("convert", "sog", 400),
        ("convert", "compressed.ply", 400),
        ("merge_into", 3.0, 400),
    ],
)
def test_derivatives_resemble_their_source(
    plant: GaussianModel, sketch: Sketch, name: str, strength: float | str, least: int
) -> None:
    suspect = model_attack(name).apply(plant, strength, rng=4)
    resemblance = SuspectIndex(suspect).resemblance(sketch)
    assert resemblance >= least
    assert least > 2 * CONFIG.sketch.alike  # far from the threshold


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("share", [0.5, 0.25, 0.1])
def test_merged_models_resemble_their_source(share: float, mirrored: bool) -> None:
    """Pair after pair of neighbours merged: at a tenth hardly a Gaussian is left as it was."""
    for model in (clusters(0), clusters(3)):
        suspect = moved(merged_to(marked(model), share))
        index = SuspectIndex(mirror_model(suspect) if mirrored else suspect)
        assert index.resemblance(make_sketch(model)) > 2 * CONFIG.sketch.alike
        assert index.resemblance(make_sketch(clusters(5))) < CONFIG.sketch.alike


def test_what_lies_about_tells_where_no_gaussian_is_left(plant: GaussianModel) -> None:
    """As trained anew: every Gaussian replaced by two others, elsewhere within it, of other sizes and opacities."""
    rng = np.random.default_rng(0)
    rows = np.tile(np.arange(0, len(plant), 4), 2)
    part = plant.take(rows)
    anew = part.with_(
        means=part.means + np.exp(part.log_scales) * rng.normal(size=part.means.shape),
        log_scales=part.log_scales + rng.normal(-0.2, 0.4, part.log_scales.shape),
        quats=rng.permutation(part.quats),
        opacity_logits=part.opacity_logits + rng.normal(0, 1, len(part)),
    )
    index = SuspectIndex(moved(anew))
    whole = make_sketch(plant)
    assert index._votes(whole) < CONFIG.sketch.alike
    assert index.resemblance(whole) > 2 * CONFIG.sketch.alike


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_a_mirrored_model_resembles_its_source(plant: GaussianModel, sketch: Sketch, share: float) -> None:
    suspect = moved(mirror_model(plant).take(near(plant, share)))
    assert SuspectIndex(suspect)._votes(sketch) > 10 * CONFIG.sketch.alike


def test_a_piece_of_a_merged_model_resembles_its_source(plant: GaussianModel, sketch: Sketch) -> None:
    merged = merged_to(plant.take(np.arange(0, len(plant), 3)), 0.25)
    piece = moved(merged.take(near(merged, 0.4)))
    assert SuspectIndex(piece).resemblance(sketch) >= CONFIG.sketch.alike


def test_a_retouched_and_moved_model_resembles_its_source(plant: GaussianModel, sketch: Sketch) -> None:
    moved = model_attack("similarity").apply(plant, 3.0, rng=1)
    tinted = moved.with_dc(0.9 * moved.sh[:, 0] + np.float32([0.1, 0.0, -0.1]))
    assert SuspectIndex(tinted).resemblance(sketch) > 10 * CONFIG.sketch.alike


def test_foreign_models_do_not(plant: GaussianModel, sketch: Sketch) -> None:
    foreign = foreign_scene(plant, len(plant), np.random.default_rng(0))
    train = read_model(DATA / "train_1000.ply").model
    assert SuspectIndex(foreign).resemblance(sketch) < CONFIG.sketch.alike
    assert SuspectIndex(train).resemblance(sketch) < CONFIG.sketch.alike
    assert SuspectIndex(plant).resemblance(make_sketch(train)) < CONFIG.sketch.alike
    assert SuspectIndex(plant).resemblance(make_sketch(foreign)) < CONFIG.sketch.alike


def test_agreement_counts_and_not_looks_alone(plant: GaussianModel, sketch: Sketch) -> None:
    """The same Gaussians, thrown about: every look is found, no two agree."""
    rng = np.random.default_rng(0)
    scattered = plant.with_(means=rng.permutation(plant.means), quats=rng.permutation(plant.quats))
    assert SuspectIndex(scattered).resemblance(sketch) < 4 * CONFIG.sketch.alike


def test_a_sketch_is_small_and_reads_back(sketch: Sketch) -> None:
    data = sketch.to_bytes()
    assert len(sketch) == CONFIG.sketch.points
    assert 0 < len(sketch.coarse) <= CONFIG.sketch.places
    assert len(data) <= 76_000
    assert Sketch.from_bytes(data).to_bytes() == data
    for bad in (b"", data[:-1], data + b"\0", b"X" + data[1:], data + data[-56:] * CONFIG.sketch.places):
        with pytest.raises(FormatError, match="no sketch"):
            Sketch.from_bytes(bad)


def test_a_sketch_of_the_first_version_opens(plant: GaussianModel, sketch: Sketch) -> None:
    data = sketch.to_bytes()
    first = b"M3DGSSK1" + data[8 : 12 + 30 * len(sketch)]
    opened = Sketch.from_bytes(first)
    np.testing.assert_array_equal(opened.looks, sketch.looks)
    assert len(opened.coarse) == 0
    assert SuspectIndex(plant).resemblance(opened) > 10 * CONFIG.sketch.alike
    with pytest.raises(FormatError, match="no sketch"):  # places came with the second
        Sketch.from_bytes(b"M3DGSSK1" + data[8:])


@pytest.mark.parametrize("count", [1, 2, 70])
def test_tiny_models_are_compared_too(plant: GaussianModel, count: int) -> None:
    tiny = plant.take(np.arange(count))
    sketch = make_sketch(tiny)
    assert len(sketch) <= count
    assert 0 <= SuspectIndex(tiny).resemblance(sketch) < count


@pytest.mark.long
def test_thousands_of_one_look_cost_no_more_than_a_few(plant: GaussianModel, sketch: Sketch) -> None:
    one = plant.take(np.zeros(30_000, np.int64)).with_(means=plant.means[:30_000])
    crowd = SuspectIndex(one)
    assert len(crowd._rows) == CONFIG.sketch.crowd
    assert crowd.resemblance(sketch) < CONFIG.sketch.alike
    # Discs of one size and opacity, as made from point clouds: colours tell them apart well enough.
    flat = plant.with_(
        log_scales=np.full_like(plant.log_scales, -4.0), opacity_logits=np.full(len(plant), 2.0, np.float32)
    )
    moved = model_attack("similarity").apply(flat, 3.0, rng=1)
    assert SuspectIndex(moved).resemblance(make_sketch(flat)) > 2 * CONFIG.sketch.alike
