"""Every kind of step, read from TOML and carried out once on a marked scene: what it is there for has happened."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.verify.search import verify_model
from engine.flows.views.camera_rig import UP, measure_extent
from engine.lab.sim.edits.objects import model_box
from engine.lab.sim.scenario import KINDS, read_scenario
from engine.lab.sim.scenario.sources import load_world
from engine.lab.sim.scenario.state import Outcome, World
from engine.model import GaussianModel
from tests.scenes import sparse_plant

TRAIN = Path(__file__).parents[3] / "data" / "train_1000.ply"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("steps")
    (path / "plant.splat").write_bytes(sparse_plant(every=8))
    return path


@pytest.fixture(scope="module")
def world(folder: Path) -> World:
    """A marked plant, in its own place."""
    text = '[[objects]]\nmodel = "plant.splat"\nbits = 16\nprofile = "fast"\n'
    (folder / "world.toml").write_text(text)
    return load_world(read_scenario(folder / "world.toml").parts, 0, lambda stage, part: None)[0]


def play(folder: Path, world: World, steps: str) -> Outcome:
    """One step after the other; the last one's outcome."""
    path = folder / "steps.toml"
    path.write_text(f'[[objects]]\nmodel = "plant.splat"\nbits = 0\n{steps}')
    outcome = Outcome(world)
    for named in read_scenario(path).steps:
        outcome = named.step.run(outcome.world, np.random.default_rng(0), lambda part: None)
    return outcome


def step(word: str, more: str = "") -> str:
    return f'[[steps]]\ndo = "{word}"\n{more}\n'


def middle(model: GaussianModel) -> np.ndarray:
    return measure_extent(model).center


def height(model: GaussianModel) -> float:
    return float(np.ptp(np.quantile(model.means @ UP, [0.05, 0.95])))


def lowest(model: GaussianModel) -> float:
    return float(np.quantile(model.means @ UP, 0.02))


HALF = "select = { box = [-9, -9, -9, 0, 9, 9] }"
Check = Callable[[GaussianModel, Outcome], bool]

CASES: dict[str, tuple[str, Check]] = {
    "attack": (step("attack", 'name = "crop"\nstrength = 0.5'), lambda m, o: 0 < len(o.world.flat()) < 0.8 * len(m)),
    "pictures": (
        step("pictures", "size = [80, 64]\nviews = 2"),
        lambda m, o: [p.shape for p in o.pictures] == [(64, 80, 3)] * 2,
    ),
    "move": (
        step("move", f"shift = [1, 0, 0]\n{HALF}"),
        lambda m, o: 0.2 < (o.world.flat().means != m.means)[:, 0].mean() < 0.8,
    ),
    "rotate": (step("rotate", "degrees = 90"), lambda m, o: not np.allclose(o.world.flat().means, m.means, atol=0.1)),
    "scale": (
        step("scale", "factor = 2"),
        lambda m, o: bool(np.isclose(height(o.world.flat()), 2 * height(m), rtol=0.01)),
    ),
    "recolor": (
        step("recolor", "gain = [2, 1, 1]"),
        lambda m, o: (
            np.allclose(o.world.flat().sh[:, 1:, 0], 2 * m.sh[:, 1:, 0])
            and not np.allclose(o.world.flat().sh[:, 0, 0], m.sh[:, 0, 0])
        ),
    ),
    "duplicate": (step("duplicate", f"shift = [3, 0, 0]\n{HALF}"), lambda m, o: len(o.world.flat()) > 1.2 * len(m)),
    "delete": (step("delete", f"inpaint = false\n{HALF}"), lambda m, o: 0 < len(o.world.flat()) < 0.8 * len(m)),
    "drop": (
        step("drop", "height = 0.5\nseconds = 0.4\nresolution = 6"),
        lambda m, o: lowest(o.world.flat()) < lowest(m) - 0.2 * measure_extent(m).radius,
    ),
    "press": (
        step("press", "share = 0.6\nseconds = 0.3\nresolution = 6"),
        lambda m, o: height(o.world.flat()) < 0.9 * height(m),
    ),
    "add": (
        step("add", f'model = "{TRAIN}"\nname = "train"\nat = [3, 0, 0]'),
        lambda m, o: len(o.world.flat()) == len(m) + 1000,
    ),
    "remove": (
        step("add", f'model = "{TRAIN}"\nname = "train"') + step("remove", 'name = "plant"'),
        lambda m, o: list(o.world.objects) == ["train"],
    ),
    "float16": (step("float16"), lambda m, o: 1e-5 < np.abs(o.world.flat().means - m.means).max() < 1e-2),
    "retrain": (
        step("retrain", "views = 4\nsteps = 3\npoints = 200\nsize = 48"),
        lambda m, o: len(o.world.flat()) == 200,
    ),
    "fine_tune": (step("fine_tune", "epochs = 1\nsize = 48"), lambda m, o: not np.array_equal(o.world.flat().sh, m.sh)),
}
"""A scenario for each kind of step, and what must be so afterwards; the rest have tests of their own below."""

OWN = {
    "collide",
    "insert",
    "moment",
    "scan",
    "level",
    "collude",
    "map_edits",
    "known_edits",
    "undo",
    "read_pieces",
    "inventory",
}


def test_every_kind_of_step_is_tried() -> None:
    assert set(CASES) | OWN == set(KINDS)
    here = Path(__file__).read_text() + (Path(__file__).parent / "test_kinds.py").read_text()
    for word in OWN:
        assert f'step("{word}"' in here, word


@pytest.mark.parametrize("word", CASES)
def test_the_step_does_what_it_is_for(word: str, folder: Path, world: World) -> None:
    steps, happened = CASES[word]
    assert f'do = "{word}"' in steps
    assert happened(world.flat(), play(folder, world, steps))


def test_bodies_collide_and_neither_passes_through(folder: Path, world: World) -> None:
    shift = 3.0 * measure_extent(world.flat()).radius
    two = world.put("other", moved(world.flat(), shift))
    rest, thrown = (
        play(folder, two, step("collide", f"speed = {speed}\nseconds = 0.6\nresolution = 6\nframes = 36"))
        for speed in (0, 3)
    )
    gaps = [apart(frame) / shift for frame in thrown.frames]
    assert apart(rest.world.flat()) / shift == pytest.approx(1.0, abs=0.1)
    assert len(gaps) == 36
    assert min(gaps) < 0.85  # they have flown at each other
    assert min(gaps) > 0.1  # in that time they would have gone twice as far as they were apart
    with pytest.raises(InputError, match="two objects"):
        play(folder, world, step("collide"))


def apart(both: GaussianModel) -> float:
    """Along x, from the first half of the Gaussians to the second."""
    half = len(both) // 2
    return float(np.median(both.means[half:, 0]) - np.median(both.means[:half, 0]))


def moved(model: GaussianModel, along: float) -> GaussianModel:
    return model.with_(means=model.means + np.array([along, 0, 0], np.float32))


def test_a_ball_holds_up_what_falls_and_strain_is_shown(folder: Path, world: World) -> None:
    falls = "seconds = 0.5\nresolution = 6\nframes = 2\nheight = 1.5\n"
    free = play(folder, world, step("drop", falls))
    held = play(folder, world, step("drop", f"{falls}ball = [0, 1.6, 0, 0.7]\nstrain = true"))
    assert middle(held.world.flat()) @ UP > middle(free.world.flat()) @ UP + 0.05
    assert len(held.frames[-1]) > len(held.world.flat())  # the ball is in the picture, not in the world
    assert held.frames[-1].sh.shape[1] == 1
    assert "energy" in held.notes[0]


def test_copies_are_inserted_where_there_is_room(folder: Path, world: World) -> None:
    three = play(folder, world, step("insert", 'of = "plant"\ncount = 3\nsize = 0.25\nspread = 3')).world
    assert list(three.objects) == ["plant", "copy 1", "copy 2", "copy 3"]
    assert three.objects["plant"] is world.objects["plant"]
    boxes = [model_box(model) for model in three.objects.values()]
    for k, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[:k]:
            assert ((low > other_high - 1e-3) | (high < other_low + 1e-3)).any()
    with pytest.raises(InputError, match="no room within"):
        play(folder, world, step("insert", 'of = "plant"\nspread = 0'))


def test_copies_are_stacked_on_what_is_below(folder: Path, world: World) -> None:
    on_top = play(folder, world, step("insert", f'model = "{TRAIN}"\nsize = 0.2\nspread = 0\nstack = true')).world
    low, high = model_box(on_top.objects["plant"])
    base = model_box(on_top.objects["copy"])
    assert min(b @ UP for b in base) == pytest.approx(max(low @ UP, high @ UP), abs=1e-3)


def test_a_level_of_detail(folder: Path, world: World) -> None:
    outcome = play(folder, world, step("level", "share = 0.25"))
    assert len(outcome.world.flat()) == pytest.approx(0.25 * len(world.flat()), abs=1)
    assert outcome.cost is not None


def test_a_scan_replaces_the_model_by_what_was_seen(folder: Path, world: World) -> None:
    outcome = play(folder, world, step("scan", "stops = 4\nrings = 96\ncolumns = 720"))
    seen, extent = outcome.world.flat(), measure_extent(world.flat())
    assert len(seen) > 300
    assert np.linalg.norm(middle(seen) - extent.center) < 0.4 * extent.radius
    from scipy.spatial import cKDTree

    away = cKDTree(world.flat().means).query(seen.means)[0]
    assert np.median(away) < 0.05 * extent.radius
    assert outcome.cost is not None


def test_edits_are_known_and_undone(folder: Path, world: World) -> None:
    edits = step("recolor", f"gain = [0.3, 1, 1.5]\n{HALF}") + step("move", f"shift = [0.4, 0.2, 0]\n{HALF}")
    edited = play(folder, world, edits).world
    known = play(folder, edited, step("known_edits"))
    opened = world.records["plant"]
    assert known.claims["plant"].z > verify_model(edited.flat(), opened).claim.z + 1.0
    assert "2 edits known: recolor, move" in known.notes[0]
    back = play(folder, edited, step("undo", "edits = 2")).world
    for name in ("means", "sh", "quats"):
        np.testing.assert_array_equal(getattr(back.flat(), name), getattr(world.flat(), name))
    with pytest.raises(InputError, match="another step"):
        play(folder, edited, step("float16") + step("undo"))


def test_a_map_shows_the_edits_and_leaves_the_world(folder: Path, world: World) -> None:
    changed = step("recolor", "gain = [0.3, 1, 1.6]\nselect = { sphere = [0, 0.3, 0, 0.4] }")
    outcome = play(folder, world, changed + step("map_edits"))
    quiet = play(folder, world, step("map_edits"))
    assert any("recolored" in note for note in outcome.notes)
    assert quiet.notes[0] == "nothing was edited"
    assert outcome.shown is not None
    assert quiet.shown is not None
    orange = [colorful(shown) for shown in (outcome.shown, quiet.shown)]
    assert orange[0] > 0.01 > orange[1]


def colorful(model: GaussianModel) -> float:
    return float((np.ptp(model.sh[:, 0], axis=1) > 0.5).mean())


def test_moved_parts_are_read_piece_by_piece(folder: Path, world: World) -> None:
    apart = play(folder, world, step("move", f"shift = [3, 0, 0]\n{HALF}")).world
    outcome = play(folder, apart, step("read_pieces"))
    assert outcome.claims["plant"].verdict.value == "marked"
    assert any("pieces" in note for note in outcome.notes)


def test_an_inventory_says_whose_is_what(folder: Path, world: World) -> None:
    both = play(folder, world, step("add", f'model = "{TRAIN}"\nname = "train"\nat = [4, 0, 0]')).world
    outcome = play(folder, both, step("inventory"))
    assert outcome.claims["plant"].verdict.value == "marked"
    assert "100 % in plant" in outcome.notes[0]


def test_copies_of_colluders_are_named(folder: Path, world: World) -> None:
    outcome = play(folder, world, step("collude", "copies = 2"))
    assert sorted(outcome.world.records) == ["plant copy 1", "plant copy 2"]
    assert not np.array_equal(outcome.world.flat().sh, world.flat().sh)
