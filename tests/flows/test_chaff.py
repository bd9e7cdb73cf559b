"""Gaussians that hardly anybody sees, put into a marked model to be taken for the real ones; and the time they cost."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.verify.search import VerifyConfig, verify_images, verify_model
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.model import ATTRIBUTES, GaussianModel
from engine.watermark.claim import Verdict

AT_ONCE = 1e-9
"""Seconds after which no step begins."""


def chaff(model: GaussianModel, opacity: float) -> GaussianModel:
    """Three near twins of every Gaussian."""
    rng = np.random.default_rng(3)
    sizes = np.exp(model.log_scales.mean(axis=1, keepdims=True))
    parts = [model]
    for _ in range(3):
        means = model.means + 0.1 * sizes * rng.normal(size=model.means.shape)
        log_scales = model.log_scales + 0.1 * rng.normal(size=model.log_scales.shape)
        logits = np.full(len(model), np.log(opacity / (1.0 - opacity)))
        twin = model.with_(means=means, log_scales=log_scales, opacity_logits=logits)
        parts.append(twin.with_dc(model.sh[:, 0] + rng.normal(0.0, 0.05, (len(model), 3))))
    whole = GaussianModel(**{name: np.concatenate([getattr(each, name) for each in parts]) for name in ATTRIBUTES})
    return whole.take(rng.permutation(len(whole)))


@pytest.mark.parametrize(("opacity", "left"), [(0.003, 0.99), (0.0045, 0.9)])
def test_twins_that_hardly_show_do_not_drown_the_mark(scene: MarkedScene, opacity: float, left: float) -> None:
    plain = verify_model(scene.marked, scene.opened)
    got = verify_model(chaff(scene.marked, opacity), scene.opened)
    assert got.claim.verdict is Verdict.MARKED
    assert got.claim.z > left * plain.claim.z
    told = [note for note in got.claim.notes if "no viewer draws" in note]
    assert len(told) == (opacity < 1 / 255)
    assert not any("no viewer draws" in note for note in plain.claim.notes)


def test_time_that_ran_out_is_told_and_acquits_nobody(scene: MarkedScene) -> None:
    clean = scene.original.take(np.arange(0, len(scene.original), 2))  # half of it: further pieces are searched for
    assert verify_model(scene.original, scene.opened).claim.verdict is Verdict.NOT_MARKED
    turned = clean.with_(means=clean.means[:, [1, 2, 0]] * np.float32(1.7) + np.float32(0.3))
    got = verify_model(turned, scene.opened, VerifyConfig(time_budget=AT_ONCE)).claim
    assert got.verdict is Verdict.INCONCLUSIVE
    assert any("time budget of 1e-09 s" in note for note in got.notes)


def test_what_was_read_in_time_still_claims(scene: MarkedScene) -> None:
    got = verify_model(scene.marked, scene.opened, VerifyConfig(time_budget=AT_ONCE)).claim
    assert got == verify_model(scene.marked, scene.opened).claim, "no step was left out"
    assert got.verdict is Verdict.MARKED


def test_an_unread_rest_keeps_not_marked_from_being_said(scene: MarkedScene) -> None:
    """Half of the original in its place, half of it strangers: what the strangers are is not looked into."""
    half = len(scene.original) // 2
    rng = np.random.default_rng(0)
    means = scene.original.means.copy()
    means[half:] = rng.uniform(means.min(axis=0), means.max(axis=0), means[half:].shape)
    mixed = scene.original.with_(means=means).take(rng.permutation(len(means)))
    assert verify_model(mixed, scene.opened, VerifyConfig(route="model")).claim.verdict is Verdict.NOT_MARKED
    got = verify_model(mixed, scene.opened, VerifyConfig(route="model", time_budget=AT_ONCE)).claim
    assert got.verdict is Verdict.INCONCLUSIVE
    assert "time budget" in got.missing
    assert got.derivation.derived


def test_pictures_that_the_time_does_not_allow_are_named(scene: MarkedScene) -> None:
    black = [np.zeros((48, 64, 3), np.float32)] * 3
    cameras = [camera.resized(64, 48) for camera in scene.opened.cameras[:1]] * 3
    got = verify_images(black, scene.opened, VerifyConfig(time_budget=AT_ONCE), cameras).claim
    assert got.verdict is Verdict.INCONCLUSIVE
    assert any("pictures " in note and "time budget" in note for note in got.notes)


def test_a_budget_of_no_time_is_refused() -> None:
    with pytest.raises(InputError, match="time budget"):
        VerifyConfig(time_budget=0.0)
