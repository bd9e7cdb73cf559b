"""Objects of every kind and source come in through the scenario, are marked as what they are, and are read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.flows.verify.search import verify_model
from engine.formats import read_model
from engine.lab.sim.scenario import read_scenario
from engine.lab.sim.scenario import sources as bringing
from engine.lab.sim.scenario.sources import load_world
from engine.lab.sim.scenario.state import World
from engine.model import SH_C0
from tests.formats.point_files import ply
from tests.lab.sim.scenario.test_steps import play, step
from tests.scenes import sparse_plant


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("kinds")
    (path / "plant.splat").write_bytes(sparse_plant(every=8))
    return path


def brought(folder: Path, text: str) -> tuple[World, tuple[str, ...]]:
    (folder / "kinds.toml").write_text(f"[[objects]]\n{text}")
    return load_world(read_scenario(folder / "kinds.toml").parts, 0, lambda stage, part: None)


@pytest.mark.parametrize(
    ("kind", "note"), [("discs", "2DGS"), ("codebook", "Compact3D"), ("clip", "4DGS"), ("generated", "random ball")]
)
def test_a_kind_is_made_marked_and_read(kind: str, note: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bringing, "GENERATED_STEPS", 120)
    text = f'name = "a"\nmodel = "plant.splat"\nkind = "{kind}"\nbits = 16\nprofile = "fast"\nshift = [2, 0, 0]\n'
    world, notes = brought(folder, text)
    assert note in notes[0]
    claim = verify_model(world.flat(), world.records["a"]).claim
    assert (claim.verdict.value, claim.matching_bits) == ("marked", 16)
    source = read_model(folder / "plant.splat").model
    shown = world.objects["a"]
    assert {
        "discs": shown.is_flat,
        "codebook": len(np.unique(shown.sh[:, 0], axis=0)) < 0.9 * len(source),
        "clip": "a" in world.clips and shown.sh.shape[1] == 1,
        "generated": len(shown) != len(source),
    }[kind]


def test_time_passes_for_a_clip_and_its_record_goes_along(folder: Path) -> None:
    text = 'name = "a"\nmodel = "plant.splat"\nkind = "clip"\nbits = 16\nprofile = "fast"\nshift = [2, 0, 0]\n'
    world, _ = brought(folder, text)
    later = play(folder, world, step("moment", "time = 0.9\nframes = 3"))
    assert len(later.frames) == 3
    assert len(later.world.objects["a"]) != len(world.objects["a"])  # something came or went
    found = verify_model(later.world.flat(), later.world.records["a"]).claim
    stale = verify_model(later.world.flat(), world.records["a"]).claim
    assert found.verdict.value == "marked"
    assert found.z > stale.z
    listed = play(folder, later.world, step("inventory"))
    assert listed.claims["a"].verdict.value == "marked"


def test_a_point_cloud_becomes_an_object(folder: Path) -> None:
    rng = np.random.default_rng(0)
    points = rng.random((4000, 3)) * [1.0, 1.0, 0.01]
    (folder / "wall.ply").write_bytes(ply(points, np.full((4000, 3), 200, np.uint8)))
    world, notes = brought(folder, 'name = "wall"\npoints = "wall.ply"\nbits = 0\n')
    assert "points" in notes[0]
    wall = world.objects["wall"]
    assert len(wall) > 1000
    assert np.ptp(wall.means[:, 2]) < 0.02
    np.testing.assert_allclose(0.5 + SH_C0 * wall.sh[:, 0], 200 / 255, atol=0.01)
