"""Reading the grain: the differences are right, weighted by what they tell, and blind to signs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.model import DISC_THICKNESS, GaussianModel
from engine.numerics.similarity import transform_model
from engine.numerics.umeyama import Similarity
from engine.watermark import grain_evidence
from engine.watermark.grain import ATTRIBUTES, Grain, roughen
from engine.watermark.grain_evidence import gather_grain_evidence
from engine.watermark.model_evidence import Evidence
from tests.reference.grain import differences
from tests.watermark.test_grain import blobs, signs_for

GRAIN = Grain(0.05, 0.02)


def read(reference: GaussianModel, suspect: GaussianModel, rows: np.ndarray | None = None) -> Evidence:
    matches = np.arange(len(suspect), dtype=np.int32) if rows is None else rows.astype(np.int32)
    quality = np.ones(len(suspect), np.float32)
    return gather_grain_evidence(GRAIN, reference, suspect, Similarity.identity(), matches, quality)


def z_of(evidence: Evidence, signs: np.ndarray) -> float:
    return float(evidence.evidence @ signs.reshape(-1) / np.linalg.norm(evidence.evidence))


def test_differences_are_those_of_the_slow_twin() -> None:
    reference, turn = blobs(300), Rotation.random(rng=3).as_matrix()
    rough = roughen(reference, Grain(0.3, 0.3), signs_for(reference))
    order = np.random.default_rng(0).permutation(300)
    moved = transform_model(rough, 2.0, turn, [1, 2, 3]).take(order)
    # Axes named anew by another tool: the same ellipsoids.
    cycle = Rotation.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    quats = np.roll((Rotation.from_quat(np.roll(moved.quats, -1, axis=1)) * cycle).as_quat(), 1, axis=1)
    swapped = moved.with_(log_scales=moved.log_scales[:, [1, 2, 0]], quats=quats.astype(np.float32))
    # And axes of all but equal scales turned into each other.
    swapped.quats[:100] = np.roll(Rotation.random(100, rng=1).as_quat(), 1, axis=1)
    back = Similarity(0.5, turn.T, -0.5 * turn.T @ [1, 2, 3])
    matches = order.astype(np.int32)
    matches[7] = -1
    out, rows = np.zeros((300, ATTRIBUTES)), np.arange(300, dtype=np.int32)
    turned = np.append(np.roll(Rotation.from_matrix(back.R).as_quat(), 1), np.log(back.scale))
    arrays = [getattr(model, name) for model in (swapped, reference) for name in ("means", "log_scales", "quats")]
    grain_evidence._differences(*arrays, matches, rows, back.scale * back.R, back.t, turned, out)
    np.testing.assert_allclose(out, differences(reference, swapped, back, matches), atol=2e-3)


def test_a_clean_copy_shows_every_chip() -> None:
    reference = blobs(2_000)
    signs = signs_for(reference)
    evidence = read(reference, roughen(reference, GRAIN, signs))
    assert (np.sign(evidence.evidence) == signs.reshape(-1)).mean() > 0.999
    assert z_of(evidence, signs) == pytest.approx(np.sqrt(6 * 2_000), rel=0.02)
    np.testing.assert_allclose(evidence.signal.reshape(-1, 6), [[0.05] * 3 + [0.02] * 3] * 2_000)


def test_the_signs_turned_round_turn_the_evidence_and_leave_the_weights() -> None:
    """Blind to chips: weights are even in what was displaced."""
    reference = blobs(2_000)
    signs = signs_for(reference)
    one, other = (read(reference, roughen(reference, GRAIN, s * signs)) for s in (1, -1))
    np.testing.assert_allclose(one.weights, other.weights, rtol=1e-2)
    np.testing.assert_allclose(one.y, -other.y, atol=2e-4)


def test_formats_round_small_ones_away_and_large_ones_speak_on() -> None:
    """Centres on a grid that is fine for large Gaussians and coarse for small ones: classes of size tell them apart."""
    rng = np.random.default_rng(2)
    reference = blobs(8_000)
    size = np.where(np.arange(8_000) % 2 == 0, -1.0, -7.0)
    reference = reference.with_(log_scales=(size[:, None] + rng.normal(0, 0.2, (8_000, 3))).astype(np.float32))
    signs = signs_for(reference)
    rough = roughen(reference, GRAIN, signs)
    rounded = rough.with_(means=(np.round(rough.means / 0.01) * 0.01).astype(np.float32))
    evidence = read(reference, rounded)
    size_of = np.abs(evidence.evidence).reshape(-1, 6)[:, :3]
    assert np.median(size_of[::2]) > 20 * np.median(size_of[1::2])
    assert z_of(evidence, signs) > 0.8 * np.sqrt(4.5 * 8_000)


def test_what_is_usual_is_known_for_each_size() -> None:
    """Rounding that drowns the mark of small Gaussians, and not so much that they are taken for lost."""
    reference = blobs(8_000)
    size = np.where(np.arange(8_000) % 2 == 0, -1.0, -3.0)
    reference = reference.with_(log_scales=np.repeat(size[:, None], 3, axis=1).astype(np.float32))
    signs = signs_for(reference)
    rough = roughen(reference, GRAIN, signs)
    evidence = read(reference, rough.with_(means=(np.round(rough.means / 0.03) * 0.03).astype(np.float32)))
    size_of = np.abs(evidence.evidence).reshape(-1, 6)[:, :3]
    assert np.median(size_of[::2]) > 1.5 * np.median(size_of[1::2])
    assert z_of(evidence, signs) > 0.8 * np.sqrt(6 * 8_000)


def test_what_was_thrown_far_says_nothing() -> None:
    reference = blobs(4_000)
    signs = signs_for(reference)
    rough = roughen(reference, GRAIN, signs)
    means = rough.means.copy()
    means[:1_000] += 1.0
    evidence = read(reference, rough.with_(means=means))
    assert (evidence.weights.reshape(-1, 6)[:1_000, :3] == 0).mean() > 0.98
    assert z_of(evidence, signs) > 0.95 * np.sqrt(6 * 4_000 - 3_000)


def test_copies_of_one_gaussian_are_one_witness() -> None:
    reference = blobs(1_000)
    signs = signs_for(reference)
    rough = roughen(reference, GRAIN, signs)
    rng = np.random.default_rng(4)
    twice = np.concatenate([np.arange(1_000), np.arange(1_000)])
    noisy = roughen(rough.take(twice), Grain(0.1, 0.1), rng.normal(size=(2_000, 6)).astype(np.float32))
    both, first = read(reference, noisy, rows=twice), read(reference, noisy.take(np.arange(1_000)))
    assert both.weights.max() <= 1.0 * 0.05 / 0.05**2
    assert z_of(both, signs) > 1.2 * z_of(first, signs)
    assert np.abs(both.y).mean() < np.abs(first.y).mean(), "their mean, not their sum"


def test_a_disc_has_five_chips() -> None:
    reference = blobs(500)
    logs = np.sort(reference.log_scales, axis=1)
    logs[:, 0] = logs[:, 1] + np.log(DISC_THICKNESS)
    reference = reference.with_(log_scales=logs)
    evidence = read(reference, reference.with_(log_scales=logs + np.float32([[0.3, 0, 0]])))
    assert not evidence.weights.reshape(-1, 6)[:, 3].any()
    assert not evidence.signal.reshape(-1, 6)[:, 3].any()
    assert evidence.weights.reshape(-1, 6)[:, [0, 1, 2, 4, 5]].all()


def test_what_is_not_matched_weighs_nothing() -> None:
    reference = blobs(500)
    evidence = read(reference, reference.take(np.arange(100)), rows=np.arange(100))
    assert not evidence.weights.reshape(-1, 6)[100:].any()
    nothing = read(reference, reference.take(np.arange(3)), rows=np.full(3, -1))
    assert not nothing.weights.any()
    assert np.isfinite(nothing.y).all()
