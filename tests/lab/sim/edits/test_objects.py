"""Scenes of many objects: the hierarchy against its slow twin, flattening, and whose record is where."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.errors import InputError
from engine.flows.records.opened_record import OpenedRecord
from engine.lab.sim.attacks import model_attack
from engine.lab.sim.edits.objects import FlatScene, Scene, Volume, model_box
from engine.lab.sim.edits.pieces import verify_objects
from engine.model import Float64, GaussianModel
from engine.numerics.umeyama import Similarity
from engine.watermark.claim import Verdict
from tests.lab.sim.edits.conftest import solid
from tests.reference import box_tree as slow

Objects = dict[str, tuple[GaussianModel, OpenedRecord]]


def boxes(count: int, order: str) -> tuple[Float64, Float64]:
    rng = np.random.default_rng(count)
    lows = rng.uniform(0, 10, (count, 3))
    if order == "sorted":
        lows = lows[np.argsort(lows[:, 0])]
    return lows, lows + rng.uniform(0, 1.5, (count, 3))


@pytest.mark.parametrize("order", ["random", "sorted"])
@pytest.mark.parametrize("count", [1, 2, 3, 300])
def test_the_hierarchy_answers_as_its_twin(count: int, order: str) -> None:
    lows, highs = boxes(count, order)
    volume = Volume.around(lows, highs, np.arange(count))
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(40):
        corner = rng.uniform(-1, 10, 3)
        wanted = slow.overlapping(lows, highs, corner, corner + 1)
        assert volume.overlapping(corner, corner + 1) == wanted
        direction = rng.standard_normal(3) * rng.integers(0, 2, 3) + [0, 0, 1e-3]
        met = volume.along_ray(corner, direction)
        entries = slow.along_ray(lows, highs, corner, direction)
        assert {item: distance for distance, item in met} == pytest.approx(entries)
        assert met == sorted(met)
        hits += len(wanted) + len(entries)
    assert hits > 0 or count < 300


def test_malformed_boxes_and_rays_are_refused() -> None:
    assert Scene().in_box([0] * 3, [1] * 3) == ()
    assert Scene().along_ray([0] * 3, [1] * 3) == ()
    scene = Scene().insert("ball", solid(1, 200))
    with pytest.raises(InputError, match="no box"):
        scene.in_box([1, 1, 1], [0, 2, 2])
    with pytest.raises(InputError, match="no ray"):
        scene.along_ray([0, 0, 0], [0, 0, 0])


def test_a_box_bounds_its_gaussians() -> None:
    turned = Rotation.from_euler("z", 45, degrees=True)
    quat = np.roll(turned.as_quat(), 1)
    one = GaussianModel(
        np.zeros((1, 3), np.float32),
        np.log(np.array([[1.0, 1e-3, 1e-3]], np.float32)),
        quat[None].astype(np.float32),
        np.zeros(1, np.float32),
        np.zeros((1, 1, 3), np.float32),
    )
    low, high = model_box(one)
    assert np.allclose(high, [3 / np.sqrt(2), 3 / np.sqrt(2), 3e-3], atol=5e-3)
    assert np.allclose(low, -high)


def test_a_scene_addresses_its_objects() -> None:
    ball = solid(1, 200)
    places = [Similarity(1.0, np.eye(3), np.array([5.0 * k, 0, 0])) for k in range(6)]
    scene = Scene().insert_all((f"ball {k}", ball, place) for k, place in enumerate(places))
    assert len(scene) == 6
    assert scene.in_box([10, 0, 0], [10, 0, 0]) == ("ball 2",)
    assert scene.in_box([9, -1, -1], [16, 1, 1]) == ("ball 2", "ball 3")
    along = scene.along_ray([-9, 0, 0], [1, 0, 0])
    assert [name for name, _ in along] == [f"ball {k}" for k in range(6)]
    assert along[0][1] == pytest.approx(9 + scene.get("ball 0").low[0])


def test_a_scene_refuses_what_it_cannot_hold() -> None:
    ball = solid(1, 200)
    scene = Scene().insert("ball", ball)
    with pytest.raises(InputError, match="already holds"):
        scene.insert("ball", ball)
    with pytest.raises(InputError, match="needs a name"):
        scene.insert("", ball)
    with pytest.raises(InputError, match="empty"):
        scene.insert("nothing", ball.take(np.arange(0)))
    with pytest.raises(InputError, match="mirrors"):
        scene.insert("mirror", ball, Similarity(1.0, np.diag([1.0, 1, -1]), np.zeros(3)))
    with pytest.raises(InputError, match="no object"):
        scene.get("bell")
    with pytest.raises(InputError, match="flattened"):
        Scene().flatten()


def test_flattening_keeps_every_object_apart() -> None:
    plain = solid(2, 150)
    plain = plain.with_(sh=plain.sh[:, :1])
    place = Similarity(2.0, Rotation.from_euler("x", 30, degrees=True).as_matrix(), np.array([1.0, 2, 3]))
    flat = Scene().insert("a", solid(1, 200)).insert("b", plain, place).flatten()
    assert flat.names == ("a", "b")
    assert flat.model.sh_degree == 1
    assert np.array_equal(flat.owner, np.repeat([0, 1], [200, 150]))
    assert np.allclose(flat.model.means[200:], place.apply(plain.means), atol=1e-5)
    assert not flat.model.sh[200:, 1:].any()


@pytest.fixture(scope="module")
def merged(objects: Objects) -> FlatScene:
    """Three marked objects, one of them twice, among a foreign one."""
    rng = np.random.default_rng(0)
    scene = Scene().insert("foreign", solid(77))
    for k, (name, (model, _)) in enumerate(objects.items()):
        turn = Rotation.random(random_state=k).as_matrix()
        scene = scene.insert(name, model, Similarity(float(rng.uniform(0.3, 3)), turn, rng.normal(0, 4, 3)))
    again = Similarity(0.6, Rotation.random(random_state=9).as_matrix(), np.array([9.0, 0, 0]))
    return scene.insert("ball again", objects["ball"][0], again).flatten()


def test_every_object_is_found_under_its_own_record(merged: FlatScene, objects: Objects) -> None:
    records = {name: opened for name, (_, opened) in objects.items()}
    found = verify_objects(merged, records, instances=2)
    assert [(f.record, f.instance) for f in found] == [("ball", 0), ("ball", 1), ("bell", 0), ("bowl", 0)]
    assert {f.objects[0][0] for f in found[:2]} == {"ball", "ball again"}
    for finding in found:
        assert finding.claim.verdict is Verdict.MARKED
        assert finding.claim.bit_accuracy == 1.0
        assert finding.claim.tries == 36
        assert finding.asset_share == 1.0
        name = finding.objects[0][0]
        rows = np.flatnonzero(merged.owner == merged.names.index(name))
        assert np.array_equal(finding.rows, rows)
        assert finding.low is not None
        assert finding.high is not None
        inside = ((merged.model.means[rows] >= finding.low) & (merged.model.means[rows] <= finding.high)).all(1)
        assert inside.mean() > 0.9
        assert finding.placement is not None
        own = records[finding.record].reference.means
        assert np.allclose(finding.placement.apply(own), merged.model.means[rows], atol=0.02)


def test_the_flat_file_alone_is_enough(merged: FlatScene, objects: Objects) -> None:
    foreign = model_attack("convert").apply(merged.model, "splat")
    foreign = model_attack("shuffle").apply(foreign)
    found = verify_objects(foreign, {name: opened for name, (_, opened) in objects.items()})
    assert [f.claim.verdict for f in found] == [Verdict.MARKED] * 3
    assert all(f.claim.bit_accuracy == 1.0 and f.objects == () for f in found)


def test_an_absent_or_unmarked_object_is_not_claimed(objects: Objects) -> None:
    model, opened = objects["ball"]
    others = Scene().insert("foreign", solid(77)).insert("bell", objects["bell"][0]).flatten()
    (absent,) = verify_objects(others, {"ball": opened})
    assert absent.claim.verdict is Verdict.INCONCLUSIVE
    assert (len(absent.rows), absent.placement) == (0, None)
    unmarked = Scene().insert("foreign", solid(77)).insert("ball", solid(11)).flatten()
    (plain,) = verify_objects(unmarked, {"ball": opened})
    assert plain.claim.verdict is not Verdict.MARKED
    assert plain.objects == (("ball", 1.0),)
    assert plain.claim.derived_fraction == 1.0
    with pytest.raises(InputError, match="no record"):
        verify_objects(model, {})
    with pytest.raises(InputError, match="instances"):
        verify_objects(model, {"ball": opened}, instances=0)
