"""Verification after edits, with a track and without, and the map that parts edits from the mark."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.verify.search import verify_model
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.lab.sim.attacks import model_attack
from engine.lab.sim.edits.edit import (
    EditTrack,
    delete,
    duplicate,
    edited_record,
    move,
    recolor,
    recolor_towards,
    rotate,
    verify_edited,
)
from engine.lab.sim.edits.edit_map import Change, map_edits
from engine.lab.sim.edits.pieces import register_pieces, verify_pieces
from engine.lab.sim.edits.selection import select_sphere
from engine.model import Bool, GaussianModel
from engine.numerics.umeyama import Similarity
from engine.watermark.claim import Verdict


@pytest.fixture(scope="module")
def patch(scene: MarkedScene) -> Bool:
    chosen = select_sphere(scene.marked, [0.12, -0.13, 0.12], 0.15)
    assert 500 < chosen.sum() < 5000
    return chosen


def hits(found: Bool, truth: Bool) -> tuple[float, float]:
    """Precision and recall."""
    both = float((found & truth).sum())
    return both / max(found.sum(), 1), both / max(truth.sum(), 1)


def test_nothing_is_found_where_nothing_was_edited(scene: MarkedScene) -> None:
    seen = map_edits(scene.marked, scene.opened)
    assert (seen.kinds != Change.UNTOUCHED).mean() < 1e-3  # the grain moves a few too far to be matched for sure
    assert seen.removed.mean() < 1e-3
    assert seen.regions == ()
    assert seen.mark_left == pytest.approx(1.0, abs=0.01)
    none = map_edits(scene.original, scene.opened)
    assert none.mark_left == pytest.approx(0.0, abs=0.01)
    assert not none.kinds.any()


def test_a_recolored_patch_is_found_and_described(scene: MarkedScene, patch: Bool) -> None:
    suspect = recolor(scene.marked, patch, gain=(1.1, 0.9, 1.0), tint=(0.05, 0.0, -0.05)).model
    seen = map_edits(suspect, scene.opened)
    precision, recall = hits(seen.recolored, patch)
    assert precision > 0.99
    assert recall > 0.98
    region = seen.regions[0]
    assert region.kind == "recolored"
    assert region.recoloring is not None
    assert np.allclose(region.recoloring.gain, [1.1, 0.9, 1.0], atol=0.01)
    assert np.allclose(region.recoloring.tint, [0.05, 0, -0.05], atol=0.01)
    assert region.mark_left == pytest.approx(1.0, abs=0.1)
    assert "recolored" in region.summary()
    claim = verify_model(suspect, scene.opened).claim
    assert (claim.verdict, claim.bit_accuracy) == (Verdict.MARKED, 1.0)


def test_painting_is_seen_through_8_bit_colors_and_wears_the_mark(scene: MarkedScene, patch: Bool) -> None:
    painted = recolor_towards(scene.marked, patch, (0.8, 0.2, 0.2), 0.5).model
    suspect = model_attack("convert").apply(painted, "splat")
    seen = map_edits(suspect, scene.opened)
    matches = seen.pieces.matches  # the format may have another order
    truth = np.where(matches >= 0, patch[matches], False)
    precision, recall = hits(seen.recolored, truth)
    assert precision > 0.95
    assert recall > 0.95
    assert seen.regions[0].mark_left == pytest.approx(0.5, abs=0.1)
    claim = verify_pieces(suspect, scene.opened, pieces=seen.pieces)
    assert (claim.verdict, claim.bit_accuracy) == (Verdict.MARKED, 1.0)


def test_a_moved_patch_is_found_and_read(scene: MarkedScene, patch: Bool) -> None:
    suspect = rotate(scene.marked, patch, [0, 1, 0], 40.0).model
    seen = map_edits(suspect, scene.opened)
    assert hits(seen.kinds == Change.MOVED, patch) > (0.99, 0.99)
    assert seen.removed.mean() < 1e-3
    motion = seen.regions[0].motion
    assert motion is not None
    assert np.degrees(np.arccos((np.trace(motion.R) - 1) / 2)) == pytest.approx(40.0, abs=0.1)
    whole = verify_pieces(suspect, scene.opened, pieces=seen.pieces)
    alone = verify_pieces(suspect, scene.opened, pieces=register_pieces(scene.opened.reference, suspect, most=1))
    assert whole.bit_accuracy == alone.bit_accuracy == 1.0
    assert whole.derived_fraction == pytest.approx(1.0, abs=1e-3)
    assert whole.z > alone.z


def test_a_copied_patch_is_no_moved_one(scene: MarkedScene, patch: Bool) -> None:

    copied = duplicate(scene.marked, patch, Similarity(0.6, np.eye(3), np.ones(3))).model
    seen = map_edits(copied, scene.opened)
    assert hits(seen.kinds == Change.COPIED, np.arange(len(copied)) >= len(patch)) > (0.99, 0.99)


def test_removed_and_foreign_gaussians_are_found(scene: MarkedScene, patch: Bool, sheet: GaussianModel) -> None:
    from engine.lab.sim.model_placement import join

    far = sheet.with_(means=0.2 * sheet.means + 0.5, sh=sheet.sh[:, :1])
    suspect = join(delete(scene.marked, patch).model, far)
    seen = map_edits(suspect, scene.opened)
    assert hits(seen.removed, patch) > (0.99, 0.99)
    assert hits(seen.kinds == Change.FOREIGN, np.arange(len(suspect)) >= (~patch).sum()) > (0.99, 0.99)
    assert {region.kind for region in seen.regions} == {"removed", "foreign"}


def test_a_foreign_model_holds_nothing(scene: MarkedScene, sheet: GaussianModel) -> None:
    seen = map_edits(sheet, scene.opened)
    assert not seen.found
    assert (seen.kinds == Change.FOREIGN).all()
    assert verify_pieces(sheet, scene.opened).verdict is Verdict.INCONCLUSIVE


def edits(model: GaussianModel, patch: Bool) -> tuple[GaussianModel, EditTrack]:
    """Paint a patch, move it, copy a part of it, delete another part."""
    painted = recolor_towards(model, patch, (0.8, 0.2, 0.2), 0.7)
    moved = move(painted.model, patch, [0.3, 0, 0])
    copied = duplicate(moved.model, np.roll(patch, 200), Similarity(0.5, np.eye(3), np.ones(3)))
    cut = delete(copied.model, select_sphere(copied.model, copied.model.means[7], 0.1))
    return cut.model, EditTrack((painted.edit, moved.edit, copied.edit, cut.edit))


def test_a_known_track_gives_the_mark_back(scene: MarkedScene, patch: Bool) -> None:
    suspect, track = edits(scene.marked, patch)
    plain = verify_pieces(suspect, scene.opened)
    known = verify_edited(suspect, scene.opened, track).claim
    assert plain.bit_accuracy == known.bit_accuracy == 1.0
    assert known.derived_fraction == pytest.approx(1.0, abs=1e-3)
    assert any("4 edits" in note for note in known.notes)


def test_a_known_repaint_costs_less_of_the_evidence(scene: MarkedScene) -> None:
    most = scene.marked.means[:, 1] > -0.2
    suspect, edit = recolor_towards(scene.marked, most, (0.8, 0.2, 0.2), 0.6)
    plain = verify_model(suspect, scene.opened).claim
    known = verify_edited(suspect, scene.opened, EditTrack((edit,))).claim
    assert known.bit_accuracy == 1.0
    assert known.layers is not None
    assert plain.layers is not None
    assert known.layers["tint"] > 1.2 * plain.layers["tint"]


def test_a_track_puts_no_mark_into_an_unmarked_model(scene: MarkedScene, patch: Bool) -> None:
    # Subtracting the values that the edits added to the *marked* model would: its gain of 0.3 leaves 0.7 of the
    # mark in the difference.
    _, track = edits(scene.marked, np.ones_like(patch))
    unmarked = track.replay(scene.original)
    claim = verify_edited(unmarked, scene.opened, track).claim
    assert claim.verdict is Verdict.NOT_MARKED
    assert abs(claim.z) < 4.5


def test_a_track_must_start_where_the_record_does(scene: MarkedScene, sheet: GaussianModel) -> None:
    edit = delete(sheet, sheet.means[:, 0] > 0).edit
    with pytest.raises(InputError, match="starts from"):
        edited_record(scene.opened, EditTrack((edit,)))
