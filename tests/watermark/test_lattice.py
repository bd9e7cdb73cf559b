"""Lattices: found in the values alone, and marked values stay on them, on average where they were wanted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.formats import read_model, write_model
from engine.lab.sim.model_placement import join
from engine.model import GaussianModel
from engine.watermark.lattice import FREE, Even, Lattices, Table, find_lattices
from tests.watermark.test_grain import blobs

KEY = bytes(range(32))
TRAIN = Path(__file__).parents[1] / "data" / "train_1000.ply"


@pytest.fixture(scope="module")
def free() -> GaussianModel:
    return blobs(3_000)


def through(model: GaussianModel, kind: str, folder: Path) -> GaussianModel:
    """The model as a format keeps it, and then as a float PLY says it again."""
    for name in (f"a.{kind}", "b.ply"):
        write_model(model, folder / name)
        model = read_model(folder / name).model
    return model


def kinds(lattices: Lattices) -> dict[str, set[str]]:
    def kind(lattice: Table | Even | None) -> str:
        if isinstance(lattice, Even):
            return "chunks" if lattice.spacing.ndim else "logarithms" if lattice.logarithmic else "steps"
        return "none" if lattice is None else "table"

    return {name: {kind(each) for each in columns} for name, columns in lattices.columns.items()}


FOUND = {
    "splat": {"dc": {"steps"}},
    "spz": {"means": {"steps"}, "log_scales": {"steps"}, "dc": {"steps"}},
    "sog": {"means": {"logarithms"}, "log_scales": {"table"}, "dc": {"table"}},
    "compressed.ply": {"means": {"chunks"}, "log_scales": {"chunks"}, "dc": {"chunks"}},
}


@pytest.mark.parametrize("kind", FOUND)
@pytest.mark.parametrize("small", [False, True])
def test_each_format_leaves_its_lattice(kind: str, small: bool, free: GaussianModel, tmp_path: Path) -> None:
    model = read_model(TRAIN).model if small else free
    assert kinds(find_lattices(through(model, kind, tmp_path))) == FOUND[kind]


@pytest.mark.parametrize("how", ["box", "half", "merged"])
@pytest.mark.parametrize("kind", ["sog", "compressed.ply"])
def test_cropped_and_merged_files_keep_theirs(kind: str, how: str, free: GaussianModel, tmp_path: Path) -> None:
    whole = through(free, kind, tmp_path)
    rows = np.flatnonzero(whole.means[:, 0] < np.median(whole.means[:, 0]))
    if how == "half":
        rows = np.flatnonzero(np.random.default_rng(0).random(len(whole)) < 0.5)
    original = whole.take(rows)
    if how == "merged":  # the second file's own grids begin at no multiple of 256 rows
        larger = free.with_(means=np.float32(1.37) * free.means + np.float32(0.3))
        original = join(whole.take(np.arange(len(whole) - 100)), through(larger, kind, tmp_path))
    lattices = find_lattices(original)
    assert set(lattices.columns) == {"means", "log_scales", "dc"}
    marked = lattices.onto(original, wanted(original, 1.0), KEY)
    for name, columns in lattices.columns.items():
        before, after = (each.sh[:, 0] if name == "dc" else getattr(each, name) for each in (original, marked))
        for k, lattice in enumerate(columns):
            assert lattice is not None
            changed = before[:, k] != after[:, k]
            assert changed.mean() > 0.2
            for places in (lattice.places(after[:, k]), lattice.places(before[:, k])):
                assert np.abs(places - np.rint(places))[changed].max() < 0.15


def test_floats_have_none(free: GaussianModel) -> None:
    assert not find_lattices(free).there
    assert not find_lattices(read_model(TRAIN).model).there
    for seed in range(20):
        rng = np.random.default_rng(seed)
        means = rng.normal(0, 10.0 ** rng.uniform(-3, 3), free.means.shape).astype(np.float32)
        assert not find_lattices(free.with_(means=means)).there
    assert FREE.onto(free, free.with_(means=means), KEY).means is means


def wanted(model: GaussianModel, size: float, seed: int = 0) -> GaussianModel:
    """Every marked value moved by about so many of its column's typical steps."""
    rng, found = np.random.default_rng(seed), find_lattices(model)
    moves = {name: size * found.step(name) * rng.uniform(0.3, 1.0, (len(model), 3)) for name in found.columns}
    sh = model.sh.copy()
    sh[:, 0] += moves.get("dc", np.float32(0))
    return model.with_(
        means=(model.means + moves.get("means", 0)).astype(np.float32),
        log_scales=(model.log_scales + moves.get("log_scales", 0)).astype(np.float32),
        sh=sh.astype(np.float32),
    )


@pytest.mark.parametrize("kind", FOUND)
def test_marked_values_stay_on_it(kind: str, free: GaussianModel, tmp_path: Path) -> None:
    original = through(free, kind, tmp_path)
    lattices = find_lattices(original)
    marked = lattices.onto(original, wanted(original, 1.0), KEY)
    for name, columns in lattices.columns.items():
        before, after = (each.sh[:, 0] if name == "dc" else getattr(each, name) for each in (original, marked))
        for k, lattice in enumerate(columns):
            assert lattice is not None
            assert (before[:, k] != after[:, k]).mean() > 0.2
            places = lattice.places(after[:, k])
            assert np.abs(places - np.rint(places)).max() < 0.1
            if isinstance(lattice, Table):
                assert set(after[:, k].tolist()) <= set(before[:, k].tolist())
            same = np.isin(np.rint(places), np.rint(lattice.places(before[:, k])))
            if kind != "compressed.ply":  # to the last bit where the original has a value there
                assert np.isin(after[same, k], before[:, k]).all()


def test_rounding_is_on_average_where_it_was_wanted(free: GaussianModel, tmp_path: Path) -> None:
    original = through(free, "spz", tmp_path)
    lattices, asked = find_lattices(original), wanted(original, 1.0)
    mean = np.mean([lattices.onto(original, asked, bytes([k]) * 32).means for k in range(64)], axis=0, dtype=np.float64)
    step = lattices.step("means")
    moved = np.abs(asked.means - original.means) > 0.3 * step
    gap = (mean - asked.means)[moved] / step
    assert abs(gap.mean()) < 0.005
    assert gap.std() < 0.08, "half a step over the root of 64"


def test_what_is_not_moved_and_moves_that_are_tiny_stay_bit_for_bit(free: GaussianModel, tmp_path: Path) -> None:
    original = through(free, "sog", tmp_path)
    lattices = find_lattices(original)
    same = lattices.onto(original, original, KEY)
    for name in ("means", "log_scales", "sh"):
        np.testing.assert_array_equal(getattr(same, name), getattr(original, name))
    few = lattices.onto(original, wanted(original, 0.1), KEY)
    assert (few.log_scales != original.log_scales).mean() < 0.05


def test_the_same_key_rounds_alike_and_another_does_not(free: GaussianModel, tmp_path: Path) -> None:
    original = through(free, "spz", tmp_path)
    lattices, asked = find_lattices(original), wanted(original, 0.8)
    one, again, other = (lattices.onto(original, asked, key).means for key in (KEY, KEY, bytes(32)))
    np.testing.assert_array_equal(one, again)
    assert (one != other).mean() > 0.2


@pytest.mark.parametrize("kind", ["spz", "sog", "compressed.ply"])
def test_the_ends_from_which_a_format_counts_stay(kind: str, free: GaussianModel, tmp_path: Path) -> None:
    original = through(free, kind, tmp_path)
    marked = find_lattices(original).onto(original, wanted(original, 1.0), KEY)
    rows = 256 if kind == "compressed.ply" else len(original)
    for least in (np.min, np.max):
        np.testing.assert_array_equal(least(marked.means[:rows], axis=0), least(original.means[:rows], axis=0))


def test_values_that_lie_only_roughly_on_even_steps_are_free() -> None:
    rng = np.random.default_rng(3)
    for off in (0.1, 0.12, 0.15, 0.2):
        steps = rng.choice(50_000, 8_000, replace=False) + rng.uniform(-off, off, 8_000)
        assert (
            find_lattices(blobs(8_000).with_(means=(0.01 * steps[:, None] * [1, 1, 1]).astype(np.float32))).step(
                "means"
            )
            == 0
        )


@pytest.mark.parametrize("kind", ["splat", "compressed.ply"])
def test_a_value_keeps_what_it_lies_beside_its_step(kind: str, free: GaussianModel, tmp_path: Path) -> None:
    steps = through(free, kind, tmp_path)
    lattice = find_lattices(steps).columns["dc"][0]
    assert isinstance(lattice, Even)
    sh = steps.sh.copy()
    sh[:, 0, 0] += (np.random.default_rng(5).uniform(-0.05, 0.05, len(sh)) * lattice.spacing).astype(np.float32)
    original = steps.with_(sh=sh)
    marked = find_lattices(original).onto(original, wanted(original, 1.0), KEY).sh[:, 0, 0]
    moved = marked != sh[:, 0, 0]
    assert moved.mean() > 0.3
    off = lattice.places(marked)[moved]
    assert np.abs(off - np.rint(off)).mean() == pytest.approx(0.025, rel=0.1)
    assert len(np.unique(marked)) > 0.98 * len(np.unique(sh[:, 0, 0]))  # where all lie on the steps, they repeat
