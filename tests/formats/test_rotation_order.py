"""Reading a file hints at quaternions in another order if flat Gaussians lie across their surface, else not."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from engine.cli.app import app, run
from engine.formats import encode_model, read_model
from engine.model import GaussianModel
from engine.numerics.similarity import transform_model
from engine.scenes.rotation_order import order_hint
from engine.scenes.scene_files import read_scene
from engine.watermark.keys import OwnerKey
from tests.formats.models import random_model


def surface(n: int = 4000, seed: int = 0) -> GaussianModel:
    """Flat Gaussians in a dome, turned from the z axis to its normal."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal[:, 2] = np.abs(normal[:, 2])
    quats = np.stack([1 + normal[:, 2], -normal[:, 1], normal[:, 0], np.zeros(n)], axis=1)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    arrays = {"means": normal, "quats": quats, "log_scales": np.tile(np.log([0.02, 0.02, 0.002]), (n, 1))}
    return random_model(0, n).with_(**{name: array.astype(np.float32) for name, array in arrays.items()})


@pytest.mark.parametrize("order", [[1, 2, 3, 0], [3, 0, 1, 2]])
def test_another_order_is_told(order: list[int], tmp_path: Path) -> None:
    model = surface()
    wrong = model.with_(quats=np.ascontiguousarray(model.quats[:, order]))
    (tmp_path / "a.ply").write_bytes(encode_model(wrong, "ply"))
    loaded = read_scene(tmp_path / "a.ply")
    assert [each.code for each in loaded.noticed] == ["rotations_reordered"]
    assert loaded.repairs == ()
    for command in (["inspect"], ["convert", str(tmp_path / "b.ply")]):
        shown = CliRunner().invoke(app, [command[0], str(tmp_path / "a.ply"), *command[1:]]).output
        assert "rotations look stored" in shown


def test_another_order_is_told_by_embedding(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = surface()
    source, marked, key, record = (str(tmp_path / name) for name in ("a.ply", "b.ply", "owner.key", "a.record"))
    Path(source).write_bytes(encode_model(model.with_(quats=np.roll(model.quats, 1, axis=1)), "ply"))
    OwnerKey.generate().write(Path(key))
    assert run(["embed", source, marked, "--key", key, "--record", record, "--profile", "fast"]) == 0
    assert "rotations look stored" in capsys.readouterr().err


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_scene_that_was_turned_by_half_is_in_order(axis: int) -> None:
    signs = -np.ones(3)
    signs[axis] = 1
    turned = transform_model(surface(), 1.0, np.diag(signs), np.zeros(3))
    assert np.abs(turned.quats).argmax(axis=1).mean() > 0.5  # not w
    assert order_hint(turned) == ()


@pytest.mark.parametrize("seed", range(5))
def test_what_knows_no_surface_is_in_order(seed: int) -> None:
    model = random_model(0, 3000, seed)
    quats = np.roll(surface(3000, seed).quats, seed, axis=1)
    assert order_hint(model.with_(quats=np.ascontiguousarray(quats))) == ()
    few = surface(60)
    assert order_hint(few.with_(quats=np.ascontiguousarray(np.roll(few.quats, 1, axis=1)))) == ()


@pytest.mark.parametrize("scene", ["plant.splat", "train_1000.ply"])
def test_real_scenes_are_in_order_and_told_in_another(scene: str) -> None:
    model = read_model(Path(__file__).parents[1] / "data" / scene).model
    assert order_hint(model) == ()
    told = [order_hint(model.with_(quats=np.ascontiguousarray(np.roll(model.quats, by, axis=1)))) for by in (1, -1)]
    assert [len(hints) for hints in told] == ([1, 1] if len(model) > 1000 else [1, 0])  # too few are flat
