"""Local edits: they do what they say to the selection, nothing to the rest, and can be taken back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.errors import InputError
from engine.lab.sim.edits.edit import (
    Edited,
    EditTrack,
    delete,
    duplicate,
    move,
    place,
    recolor,
    recolor_towards,
    rotate,
    scale,
)
from engine.lab.sim.edits.selection import select_sphere
from engine.model import SH_C0, Bool, Camera, GaussianModel, look_at
from engine.numerics.image_metrics import psnr
from engine.numerics.umeyama import Similarity
from engine.raster import render

ATTRIBUTES = ("means", "log_scales", "quats", "opacity_logits", "sh")
TURN = Similarity(0.5, Rotation.from_rotvec([0.3, 1.0, -0.4]).as_matrix(), np.array([1.0, 2.0, 3.0]))

CHANGES: dict[str, Callable[[GaussianModel, Bool], Edited]] = {
    "move": lambda m, s: move(m, s, [1.0, 0, 0]),
    "rotate": lambda m, s: rotate(m, s, [0, 1, 1], 40.0),
    "scale": lambda m, s: scale(m, s, 1.7),
    "place": lambda m, s: place(m, s, TURN),
    "recolor": lambda m, s: recolor(m, s, gain=(0.5, 1, 1.5), tint=0.1),
    "towards": lambda m, s: recolor_towards(m, s, (1, 0, 0), 0.5),
}
COUNTS: dict[str, Callable[[GaussianModel, Bool], Edited]] = {
    "delete": delete,
    "duplicate": lambda m, s: duplicate(m, s, TURN),
}


@pytest.fixture
def selection(model: GaussianModel) -> Bool:
    chosen = select_sphere(model, model.means[0], 0.8)
    assert 20 < chosen.sum() < 400
    return chosen


def same(a: GaussianModel, b: GaussianModel) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ATTRIBUTES)


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_touches_the_selection_alone(model: GaussianModel, selection: Bool, name: str) -> None:
    before = model.take(np.arange(len(model)))
    changed, edit = CHANGES[name](model, selection)
    assert same(model, before)  # the input is left as it is
    assert same(changed.take(~selection), model.take(~selection))
    moved = [a for a in ATTRIBUTES if not np.array_equal(getattr(changed, a), getattr(model, a))]
    assert moved
    assert same(edit.apply(model), changed)


@pytest.mark.parametrize("name", [*CHANGES, *COUNTS])
def test_every_edit_can_be_taken_back_exactly(model: GaussianModel, selection: Bool, name: str) -> None:
    changed, edit = {**CHANGES, **COUNTS}[name](model, selection)
    assert not same(changed, model)
    assert same(edit.undo(changed), model)
    assert same(edit.apply(model), changed)


def test_a_moved_piece_looks_as_before_from_a_moved_camera(model: GaussianModel) -> None:
    everyone = np.ones(len(model), dtype=np.bool_)
    center = model.means.mean(axis=0).astype(np.float64)
    camera = look_at(center + np.array([0, 0.5, -5]), center, [0, -1, 0], 160.0, 96, 96)
    changed = place(model, everyone, TURN).model
    eye = TURN.apply(camera.position)
    world = np.eye(4)
    world[:3, :3] = camera.viewmat[:3, :3] @ TURN.R.T
    world[:3, 3] = -world[:3, :3] @ eye
    assert psnr(render(model, camera), render(changed, Camera(world, camera.K, 96, 96))) > 55
    # colors that depend on the view turned, too: without Wigner-D the picture differs
    still = changed.with_(sh=model.sh)
    assert psnr(render(model, camera), render(still, Camera(world, camera.K, 96, 96))) < 45


def test_rotating_and_scaling_keep_their_pivot(model: GaussianModel, selection: Bool) -> None:
    means = model.means[selection].astype(np.float64)
    middle = 0.5 * (means.min(axis=0) + means.max(axis=0))
    turned = rotate(model, selection, [0, 0, 2], 90.0).model.means[selection] - middle
    expected = (means - middle) @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    assert np.allclose(turned, expected, atol=1e-5)
    bigger = scale(model, selection, 2.0).model
    assert np.allclose(bigger.means[selection] - middle, 2 * (means - middle), atol=1e-5)
    assert np.allclose(bigger.log_scales[selection] - model.log_scales[selection], np.log(2), atol=1e-5)


def test_recoloring_is_affine_in_the_shown_color(model: GaussianModel, selection: Bool) -> None:
    gain, tint = np.array([0.5, 1.0, 2.0]), np.array([0.1, 0.0, -0.2])
    changed = recolor(model, selection, gain=gain, tint=tint).model
    old, new = (0.5 + SH_C0 * m.sh[selection, 0] for m in (model, changed))
    assert np.allclose(new, gain * old + tint, atol=1e-5)
    assert np.allclose(changed.sh[selection, 1:], model.sh[selection, 1:] * gain, atol=1e-6)


def test_painting_reaches_its_target(model: GaussianModel, selection: Bool) -> None:
    target = np.array([0.9, 0.2, 0.4])
    half = recolor_towards(model, selection, target, 0.5).model
    full = recolor_towards(model, selection, target).model
    old = 0.5 + SH_C0 * model.sh[selection, 0]
    assert np.allclose(0.5 + SH_C0 * half.sh[selection, 0], 0.5 * old + 0.5 * target, atol=1e-5)
    assert np.allclose(0.5 + SH_C0 * full.sh[selection, 0], target, atol=1e-5)
    assert not full.sh[selection, 1:].any()


def test_deleting_and_duplicating_change_the_count(model: GaussianModel, selection: Bool) -> None:
    fewer, edit = delete(model, selection)
    assert same(fewer, model.take(~selection))
    assert np.array_equal(edit.origin(), np.flatnonzero(~selection))
    more, edit = duplicate(model, selection, TURN)
    assert same(more.take(np.arange(len(model))), model)
    assert np.allclose(more.means[len(model) :], TURN.apply(model.means[selection]), atol=1e-5)
    assert np.array_equal(edit.origin()[len(model) :], np.flatnonzero(selection))


def test_bad_arguments_are_refused(model: GaussianModel, selection: Bool) -> None:
    nothing = np.zeros(len(model), dtype=np.bool_)
    with pytest.raises(InputError, match="holds none"):
        move(model, nothing, [1, 0, 0])
    with pytest.raises(InputError, match="selection must be bool"):
        move(model, selection.astype(np.int64), [1, 0, 0])
    with pytest.raises(InputError, match="no model"):
        delete(model, ~nothing)
    with pytest.raises(InputError, match="shift"):
        move(model, selection, [np.inf, 0, 0])
    with pytest.raises(InputError, match="axis"):
        rotate(model, selection, [0, 0, 0], 10.0)
    with pytest.raises(InputError, match="angle"):
        rotate(model, selection, [0, 0, 1], np.nan)
    with pytest.raises(InputError, match="factor"):
        scale(model, selection, 0.0)
    with pytest.raises(InputError, match="gain"):
        recolor(model, selection, gain=-1.0)
    with pytest.raises(InputError, match="strength"):
        recolor_towards(model, selection, 0.5, 1.5)
    with pytest.raises(InputError, match="is for a model of"):
        delete(model, selection).edit.apply(model.take(selection))


def test_a_track_replays_and_undoes_in_order(model: GaussianModel, selection: Bool) -> None:
    now, track, history = model, EditTrack(), [model]
    for step in (CHANGES["move"], CHANGES["towards"], COUNTS["duplicate"], COUNTS["delete"]):
        now, edit = step(now, select_sphere(now, now.means[5], 1.0 - 0.1 * len(track.edits)))
        track = track.then(edit)
        history.append(now)
    assert len(history[3]) > len(model)
    assert same(track.replay(model), now)
    for steps in range(5):
        assert same(track.undo(now, steps), history[4 - steps])
    with pytest.raises(InputError, match="undo"):
        track.undo(now, 5)
    with pytest.raises(InputError, match="starts from"):
        track.then(COUNTS["delete"](history[3], np.arange(len(history[3])) < 9).edit)


def test_a_track_knows_origins(model: GaussianModel, selection: Bool) -> None:
    red, paint = recolor(model, selection, tint=(0.2, 0, 0))
    twice, copy = duplicate(red, selection, TURN)
    track = EditTrack((paint, copy))
    origin = track.origin(len(model))
    assert np.array_equal(origin[len(model) :], np.flatnonzero(selection))
    assert len(origin) == len(twice)
