"""Where the mark is: the parts of a real scene that carry it, those that lost it, those that are not there."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from engine.flows.regions.region_search import RegionReport, describe, locate_mark
from engine.flows.verify.gaussian_evidence import read_gaussians
from engine.flows.verify.search import Suspect, Verification, verify
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.model import ATTRIBUTES, GaussianModel
from engine.numerics.similarity import mirror_model, transform_model
from engine.present.region_maps import COLORS, add_legend, draw_report
from engine.raster import render
from engine.registration.registration_search import Registration
from engine.watermark.keys import OwnerKey
from engine.watermark.model_evidence import Evidence
from engine.watermark.regions import RegionConfig, State
from engine.watermark.spreading import grain_key, spread


def located(scene: MarkedScene, model: GaussianModel) -> tuple[RegionReport, Verification]:
    found = verify(Suspect(model), scene.opened)
    return locate_mark(Suspect(model), scene.opened, found), found


def left_half(scene: MarkedScene) -> np.ndarray:
    x = scene.opened.reference.means[:, 0]
    return np.asarray(x < np.median(x))


def half_original(scene: MarkedScene) -> GaussianModel:
    left = left_half(scene)
    return scene.marked.with_(
        **{
            name: np.where(left.reshape(-1, *[1] * (ours.ndim - 1)), ours, theirs)
            for name in ATTRIBUTES
            for ours, theirs in [(getattr(scene.marked, name), getattr(scene.original, name))]
        }
    )


def test_half_taken_from_the_original_is_altered_the_other_marked(scene: MarkedScene) -> None:
    report, _ = located(scene, half_original(scene))
    (piece,) = report.pieces
    regions, left = piece.regions, left_half(scene)
    share = np.bincount(regions.partition.of_gaussians, left) / np.bincount(regions.partition.of_gaussians)
    assert (share == 1).sum() > 50
    assert (share == 0).sum() > 50
    assert (regions.state[share == 1] == State.MARKED).all()
    assert (regions.state[share == 0] == State.ALTERED).mean() > 0.98  # 1 % may be called marked
    said = report.summary()
    assert said["marked"] + said["altered"] + said["unclear"] == regions.tested == regions.partition.count
    assert said["unclear"] < 5
    assert report.claimed


def test_pieces_are_named_by_their_rows_and_have_their_own_transforms(scene: MarkedScene) -> None:
    """The left half where it was, something foreign, and a part of the right half, mirrored and moved."""
    left, reference = left_half(scene), scene.opened.reference
    half = np.flatnonzero(left).astype(np.int32)
    foreign = scene.marked.take(np.arange(50)).with_(means=np.full((50, 3), 9.0, np.float32))
    moved = mirror_model(scene.marked.take(np.flatnonzero(~left)[::8]))
    parts = scene.marked.take(half), foreign, transform_model(moved, 0.8, np.eye(3), np.array([-3.0, 0, 0]))
    suspect = foreign.with_(**{name: np.concatenate([getattr(m, name) for m in parts]) for name in ATTRIBUTES})
    matches = np.full(len(suspect), -1, np.int32)
    matches[: len(half)] = half
    quality = (matches >= 0).astype(np.float32)
    home = Registration(1.0, np.eye(3), np.zeros(3), matches, quality, len(half) / len(reference), True, 1)
    found = verify(Suspect(scene.marked), scene.opened)
    assert found.reading is not None
    evidence = read_gaussians(suspect, scene.opened, home)
    found = replace(found, reading=replace(found.reading, registration=home, evidence=evidence))
    report = locate_mark(Suspect(suspect), scene.opened, found)

    assert [piece.registration.mirrored for piece in report.pieces if piece.registration] == [False, True]
    assert report.pieces[1].registration is not None
    assert report.pieces[1].registration.scale == pytest.approx(1.25, rel=1e-3)
    piece, region, state = report.of_suspect
    ends = np.cumsum([0, *map(len, parts)])
    theirs = [piece[ends[k] : ends[k + 1]] for k in range(3)]
    assert (theirs[0] == 0).all()
    assert (theirs[1] == -1).all()
    assert (theirs[2] == 1).mean() > 0.97
    assert (state[piece >= 0] == State.MARKED).mean() > 0.97
    assert (report.states[left] == State.MARKED).mean() > 0.97
    np.testing.assert_array_equal(region >= 0, piece >= 0)
    tries = found.claim.tries * 2
    for one in report.pieces:
        assert one.log10_false_claim == pytest.approx(np.log10(tries) - one.z**2 / 2 / np.log(10))
    told = json.loads(json.dumps(describe(report, scene.opened)))
    assert {one["transform"]["mirrored"] for one in told["found"]} == {False, True}
    marked = [each for each in told["found"][0]["regions"] if each["state"] == "marked"]
    inside = scene.opened.reference.means
    assert all((inside.min(axis=0) <= each["center"]).all() for each in marked)
    assert all(each["z"] == round(each["z"], 1) for each in marked), "more digits would tell signs"


def test_an_unmarked_model_and_wrong_keys_discover_nothing(scene: MarkedScene) -> None:
    report, _ = located(scene, scene.original)
    assert report.summary()["marked"] == 0
    assert not report.claimed
    found = verify(Suspect(scene.marked), scene.opened)
    for seed in range(5):
        key, context = OwnerKey(bytes(range(seed, seed + 32))), scene.opened.header.chip_context()
        spreading = spread(key, context, scene.opened.layout.codes, 3, len(scene.opened.message))
        wrong = replace(scene.opened, spreading=spreading, grain_key=grain_key(key, context))
        assert locate_mark(Suspect(scene.marked), wrong, found).summary()["marked"] == 0


def test_a_picture_shows_one_side(scene: MarkedScene) -> None:
    camera = make_rig(scene.marked, 1, 480, 360, jitter=np.random.default_rng(3).random((1, 4)))[0]
    suspect = Suspect(None, [np.clip(render(scene.marked, camera), 0, 1)], [camera])
    found = verify(suspect, scene.opened)
    report = locate_mark(suspect, scene.opened, found)
    (piece,) = report.pieces
    assert piece.registration is None
    assert report.summary()["marked"] >= 8
    assert report.summary()["altered"] == 0
    assert 0.05 < report.summary()["share"]["unseen"] < 0.95
    sheet = np.asarray(draw_report(report, suspect, scene.opened, found))
    assert orange(sheet) > 0.05
    loose = locate_mark(suspect, scene.opened, found, RegionConfig(most=4))
    assert loose.pieces[0].regions.partition.count <= 4


def orange(picture: np.ndarray) -> float:
    colors = picture.astype(np.int64)
    return float((colors[..., 0] > 2 * colors[..., 2] + 20).mean())


def test_the_map_is_orange_where_the_mark_is_and_says_when_nothing_is_claimed(scene: MarkedScene) -> None:
    report, found = located(scene, half_original(scene))
    sheet = draw_report(report, Suspect(half_original(scene)), scene.opened, found)
    colors = np.asarray(sheet).astype(np.int64)
    assert 0.02 < orange(colors) < 0.5
    assert (colors[..., 2] > 2 * colors[..., 0] + 20).mean() > 0.02
    assert COLORS.keys() == set(State)
    plain = Image.new("RGB", (480, 10))
    assert add_legend(plain, replace(report, claimed=False)).height > add_legend(plain, report).height


@pytest.mark.parametrize("width", [40, 200, 480, 900])
def test_the_legend_is_whole_under_narrow_pictures(scene: MarkedScene, width: int) -> None:
    report, _ = located(scene, scene.marked)
    sheet = np.asarray(add_legend(Image.new("RGB", (width, 30)), report))
    assert (sheet[30:, -4:] == 255).all(), "text runs into the border"
    assert (sheet[30:] < 128).any()


def test_nothing_found_is_an_empty_report(scene: MarkedScene) -> None:
    nothing = Evidence(*np.zeros((3, scene.opened.layout.chips)))
    found = verify(Suspect(scene.marked), scene.opened)
    assert found.reading is not None
    report = locate_mark(
        Suspect(scene.marked), scene.opened, replace(found, reading=replace(found.reading, evidence=nothing))
    )
    assert report.pieces == ()
    assert report.summary()["share"]["unseen"] == 1.0
    assert not report.states.any()
    assert not report.claimed
