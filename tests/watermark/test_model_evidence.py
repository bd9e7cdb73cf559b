from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.model import Float32
from engine.registration.mixtures import Mixtures
from engine.watermark.config import CONFIG
from engine.watermark.layout import Layout
from engine.watermark.model_evidence import Evidence, compare_colors, gather_residual, remove_affine_color
from engine.watermark.paper_decoder import adaptive_weights, decode_paper, paper_steps


def gather_model_evidence(layout: Layout, reference_dc: Float32, suspect_dc: Float32, mixtures: Mixtures) -> Evidence:
    """What `compare_colors` finds in one call with what `gather_residual` makes of it."""
    return gather_residual(layout, compare_colors(reference_dc, suspect_dc, mixtures))


def marked(n: int = 20_000, codes: int = 1024, seed: int = 0) -> tuple[Layout, np.ndarray, np.ndarray, np.ndarray]:
    """Layout, reference DC, marked DC and the signed displacement of each chip."""
    rng = np.random.default_rng(seed)
    layout = Layout(
        (rng.permutation(np.arange(n) % codes).astype(np.int32),),
        (codes,),
        (np.linalg.qr(rng.standard_normal((3, 3)))[0],),
        np.full(3 * codes, 0.02),
    )
    reference = rng.standard_normal((n, 3)).astype(np.float32)
    signs = rng.permutation(np.repeat([-1.0, 1.0], codes // 2 * 3)).reshape(codes, 3)
    signs[:, 1:] = rng.permuted(np.repeat([[-1.0], [1.0]], codes // 2, axis=0).repeat(2, axis=1), axis=0)
    signed = layout.amplitudes * signs.reshape(-1)
    return layout, reference, reference + layout.displace(signed), signed


def identity(n: int, quality: float = 1.0) -> Mixtures:
    return Mixtures.of_matches(np.arange(n, dtype=np.int32), np.full(n, quality, dtype=np.float32))


def test_displacements_come_back_exactly() -> None:
    layout, reference, suspect, signed = marked()
    evidence = gather_model_evidence(layout, reference, suspect, identity(len(reference)))
    np.testing.assert_allclose(evidence.y, signed, atol=3e-3)
    assert (evidence.weights > 0).all()


def test_unmatched_code_vectors_weigh_nothing() -> None:
    layout, reference, suspect, _ = marked()
    matches = np.arange(len(reference), dtype=np.int32)
    matches[layout.labels[0] < 5] = -1
    plain = Mixtures.of_matches(matches, np.ones(len(reference), np.float32))
    evidence = gather_model_evidence(layout, reference, suspect, plain)
    assert not evidence.weights[:15].any()
    assert not evidence.y[:15].any()
    assert (evidence.weights[15:] > 0).all()


def test_outliers_and_noisy_code_vectors_weigh_less() -> None:
    layout, reference, suspect, signed = marked()
    rng = np.random.default_rng(1)
    wild = rng.choice(len(reference), 200, replace=False)
    suspect = suspect.copy()
    suspect[wild] += 3.0
    noisy = layout.labels[0] < 512
    suspect[noisy] += 0.5 * rng.standard_normal((int(noisy.sum()), 3)).astype(np.float32)
    evidence = gather_model_evidence(layout, reference, suspect, identity(len(reference)))
    assert np.sign(evidence.y[1536:]) @ np.sign(signed[1536:]) > 0.97 * 1536
    assert evidence.weights[1536:].mean() > 2 * evidence.weights[:1536].mean()


def test_gain_tint_and_exposure_are_removed() -> None:
    layout, reference, suspect, signed = marked()
    tinted = suspect @ np.diag([1.1, 0.95, 1.0]).astype(np.float32) + np.array([0.3, -0.1, 0.05], np.float32)
    evidence = gather_model_evidence(layout, reference, tinted, identity(len(reference)))
    assert np.mean(np.sign(evidence.y) == np.sign(signed)) > 0.99


def test_affine_fit_leaves_the_mark() -> None:
    _, reference, suspect, _ = marked()
    residual = (suspect - reference).astype(np.float64)
    left = remove_affine_color(reference.astype(np.float64), residual, np.ones(len(reference)))
    assert np.abs(left - residual).max() < 5e-3


def test_later_stages_see_what_earlier_ones_leave() -> None:
    """Equation 11: two stages whose codes overlap are told apart."""
    rng = np.random.default_rng(2)
    n, codes = 20_000, (64, 32)
    layout = Layout(
        tuple(rng.integers(0, c, n).astype(np.int32) for c in codes),
        codes,
        (np.eye(3), np.eye(3)),
        np.full(3 * sum(codes), 0.02),
    )
    reference = rng.standard_normal((n, 3)).astype(np.float32)
    signed = layout.amplitudes * rng.choice([-1.0, 1.0], layout.chips)
    evidence = gather_model_evidence(layout, reference, reference + layout.displace(signed), identity(n))
    assert np.mean(np.sign(evidence.y) == np.sign(signed)) == 1.0


def test_unmarked_model_shows_no_displacement() -> None:
    layout, reference, _, _ = marked()
    evidence = gather_model_evidence(layout, reference, reference.copy(), identity(len(reference)))
    assert np.abs(evidence.y).max() < 1e-6


def test_paper_rule_counts_steps_and_drops_what_moved_too_far() -> None:
    amplitudes = np.full(5, 0.02)
    chips = np.array([1, -1, 1, 1, -1], np.int8)
    y = np.array([0.02, -0.021, 0.009, 0.2, 0.045])
    np.testing.assert_array_equal(paper_steps(y, amplitudes, chips), [1, 1, 0, 0, -2])
    bits, lead = decode_paper(y, amplitudes, chips, np.array([0, 0, 1, 1, 1], np.int32), 2)
    assert bits.tolist() == [1, -1]
    assert lead == pytest.approx([1.0, 1.0])


def noisy_unmarked(amplitudes: np.ndarray | None = None) -> tuple[Layout, np.ndarray, np.ndarray]:
    layout, reference, _, _ = marked()
    if amplitudes is not None:
        layout = replace(layout, amplitudes=amplitudes)
    noise = 0.1 * np.random.default_rng(3).standard_normal(reference.shape)
    return layout, reference, (reference + noise).astype(np.float32)


def test_what_was_moved_far_weighs_more() -> None:
    """The matched filter: of two chips in the same noise the one of four times the amplitude counts for more."""
    amplitudes = np.where(np.arange(3 * 1024) % 2 == 0, 0.004, 0.001)
    layout, reference, suspect = noisy_unmarked(amplitudes)
    weights = gather_model_evidence(layout, reference, suspect, identity(len(reference))).weights
    assert np.median(weights[::2]) > 2.5 * np.median(weights[1::2])


def test_trust_is_relative() -> None:
    """A suspect matched throughout at a quarter of the quality says the same about each chip."""
    layout, reference, suspect = noisy_unmarked()
    sure = gather_model_evidence(layout, reference, suspect, identity(len(reference)))
    unsure = gather_model_evidence(layout, reference, suspect, identity(len(reference), 0.25))
    np.testing.assert_allclose(unsure.y, sure.y, atol=1e-6)
    assert np.median(unsure.weights / sure.weights) == pytest.approx(1.0, abs=0.1)


def test_no_mean_is_trusted_beyond_the_mark_itself() -> None:
    """Members share errors that their spread does not show: an exact half outweighs a nearly exact one by little."""
    layout, reference, suspect, _ = marked()
    exact = layout.labels[0] < 512
    noise = np.where(exact[:, None], 1e-7, 1e-3) * np.random.default_rng(4).standard_normal(reference.shape)
    evidence = gather_model_evidence(layout, reference, (suspect + noise).astype(np.float32), identity(len(reference)))
    assert evidence.weights[:1536].mean() < 1.5 * evidence.weights[1536:].mean()
    assert evidence.weights.max() <= 0.02 / 0.02**2
    equal = gather_model_evidence(layout, reference, reference.astype(np.float32), identity(len(reference)))
    assert equal.weights.max() <= 0.02 / 0.02**2


def test_what_members_share_is_noise_though_they_agree() -> None:
    """A cleaned model: all members of a cell moved alike, by ten times the mark. No chip may pretend to be sure."""
    layout, reference, suspect, _ = marked()
    plain = gather_model_evidence(layout, reference, suspect, identity(len(reference)))
    moved = 0.2 * np.random.default_rng(5).standard_normal((layout.codes[0], 3))[layout.labels[0]]
    cleaned = gather_model_evidence(layout, reference, (suspect + moved).astype(np.float32), identity(len(reference)))
    assert np.median(np.abs(cleaned.evidence)) < 0.3 * np.median(np.abs(plain.evidence))


def test_no_chip_outweighs_the_others() -> None:
    """A second mark, ten times as strong, on a few code vectors: each saturates at `saturation` medians."""
    layout, reference, suspect, _ = marked()
    louder = suspect + np.where(layout.labels[0] < 20, 0.1, 0.0)[:, None].astype(np.float32)
    evidence = gather_model_evidence(layout, reference, louder, identity(len(reference)))
    shown = np.abs(evidence.weights * evidence.y).reshape(-1, 3)
    for carrier in shown.T:
        assert carrier.max() <= 1.1 * CONFIG.evidence.saturation * np.median(carrier)


def test_a_tie_of_the_paper_rule_reads_as_a_set_bit() -> None:
    y, chips = np.array([0.02, 0.02, -0.02]), np.array([1, -1, 1], np.int8)
    bits, lead = decode_paper(y, np.full(3, 0.02), chips, np.array([0, 0, 1], np.int32), 3)
    assert bits.tolist() == [1, -1, 1], "even, against, nothing to vote"
    assert lead.tolist() == [0.0, 1.0, 0.0]


def merged(dc: np.ndarray, first: np.ndarray, second: np.ndarray, share: float = 0.6) -> tuple[np.ndarray, Mixtures]:
    """DC of pairs (n,) as mixtures, `share` of the first in each, and what they are made of."""
    m = len(first)
    rows, parts = np.tile(np.arange(m, dtype=np.int32), 2), np.concatenate([first, second]).astype(np.int32)
    shares = np.repeat([share, 1.0 - share], m)
    mixed = share * dc[first] + (1.0 - share) * dc[second]
    return mixed.astype(np.float32), Mixtures(rows, parts, shares, np.ones(m, np.float32))


def test_pairs_of_one_code_vector_say_what_each_would() -> None:
    layout, reference, suspect, signed = marked()
    by_code = np.argsort(layout.labels[0], kind="stable")
    first, second = by_code[: len(by_code) // 38 * 38].reshape(-1, 2).T  # 19 or 20 members each
    same = layout.labels[0][first] == layout.labels[0][second]
    mixed, mixtures = merged(suspect, first[same], second[same])
    evidence = gather_model_evidence(layout, reference, mixed, mixtures)
    np.testing.assert_allclose(evidence.y, signed, atol=3e-3)


def test_pairs_of_two_code_vectors_speak_for_both() -> None:
    layout, reference, suspect, signed = marked()
    order = np.random.default_rng(5).permutation(len(reference))
    evidence = gather_model_evidence(layout, reference, *merged(suspect, *order.reshape(2, -1)))
    assert np.mean(np.sign(evidence.y) == np.sign(signed)) > 0.99


def test_a_mixture_is_predicted_from_all_its_parts() -> None:
    """Unmarked pairs show no displacement, however different the two are."""
    layout, reference, _, _ = marked()
    order = np.random.default_rng(6).permutation(len(reference))
    evidence = gather_model_evidence(layout, reference, *merged(reference, *order.reshape(2, -1)))
    assert np.abs(evidence.y).max() < 1e-5


def test_errors_that_mixtures_share_weigh_on_them() -> None:
    """What all pairs of a code vector err by alike counts against it; plain matches of the same colours may say so."""
    layout, reference, suspect, _ = marked()
    rng = np.random.default_rng(7)
    erring = layout.labels[0] < 512
    shared = 0.06 * rng.standard_normal((1024, 3))[layout.labels[0]] * erring[:, None]
    wrong = (suspect + shared + 0.03 * rng.standard_normal(reference.shape)).astype(np.float32)
    by_code = np.argsort(layout.labels[0], kind="stable")
    first, second = by_code[: len(by_code) // 2 * 2].reshape(-1, 2).T
    same = layout.labels[0][first] == layout.labels[0][second]
    ratios = []
    for evidence in (
        gather_model_evidence(layout, reference, *merged(wrong, first[same], second[same])),
        gather_model_evidence(layout, reference, wrong, identity(len(reference))),
    ):
        ratios.append(np.median(evidence.weights[:1536]) / np.median(evidence.weights[1536:]))
    assert ratios[0] < 0.99 * ratios[1]


def widely_marked() -> tuple[Layout, np.ndarray, np.ndarray, np.ndarray]:
    """As `marked`, along carriers over four coefficients."""
    layout, _, _, signed = marked()
    rng = np.random.default_rng(7)
    wide = replace(layout, directions=(np.linalg.qr(rng.standard_normal((12, 3)))[0].T,))
    reference = rng.standard_normal((20_000, 12)).astype(np.float32)
    return wide, reference, reference + wide.displace(signed), signed


def test_displacements_over_all_coefficients_come_back() -> None:
    layout, reference, suspect, signed = widely_marked()
    evidence = gather_model_evidence(layout, reference, suspect, identity(len(reference)))
    np.testing.assert_allclose(evidence.y, signed, atol=3e-3)
    difference = (signed.reshape(-1, 3) @ layout.directions[0]).astype(np.float32)
    np.testing.assert_allclose(evidence.differences[0], difference, atol=3e-3)


def test_of_a_suspect_without_harmonics_dc_is_read() -> None:
    layout, reference, suspect, signed = widely_marked()
    evidence = gather_model_evidence(layout, reference[:, :3], suspect[:, :3], identity(len(reference)))
    assert evidence.differences[0].shape == (1024, 3)
    assert np.corrcoef(evidence.y, signed)[0, 1] > 0.3


def test_adaptive_weights_grow_with_beta_and_fall_with_detail() -> None:
    smooth, rough = np.zeros((1, 4, 3)), np.zeros((1, 4, 3))
    smooth[0, :2], rough[0, 0], rough[0, 1] = 0.1, 0.1, -0.1
    differences = (np.concatenate([smooth, rough]).reshape(2, 12), np.zeros((1, 12)))
    amplitudes = np.array([0.02, 0.02, 0.02, 0.02, 0.04, 0.02])  # two chips a code vector
    weights = adaptive_weights(differences, amplitudes)
    np.testing.assert_allclose(
        weights, np.array([1, 1, 1, 1, 2, 1]) * np.repeat([1, 1 / (1 + CONFIG.paper.lambda_freq), 1], 2)
    )
    np.testing.assert_array_equal(adaptive_weights((np.ones((3, 3)),), np.full(6, 0.1)), np.ones(6))


def test_weighted_steps_outvote_more_of_them() -> None:
    y, chips, bit_of = np.array([0.02, -0.02, -0.02]), np.ones(3, np.int8), np.zeros(3, np.int32)
    assert decode_paper(y, np.full(3, 0.02), chips, bit_of, 1)[0].tolist() == [-1]
    bits, lead = decode_paper(y, np.full(3, 0.02), chips, bit_of, 1, np.array([4.0, 1.0, 1.0]))
    assert (bits.tolist(), lead.tolist()) == ([1], [pytest.approx(2 / 6)])
