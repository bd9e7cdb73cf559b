"""What is left of a picture after its reference is taken off: the mark, and no false one."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from engine.errors import InputError
from engine.numerics.wavelet import dwt2, idwt2
from engine.pictures.alignment import residual
from engine.pictures.alignment.planar import align_image
from engine.pictures.alignment.residual import image_cotangent
from engine.pictures.alignment.tone_and_light import Toned, fit_tone, robust_regression
from engine.pictures.landmarks.keypoints import LUMA
from tests.parameters import few
from tests.pictures.image_cases import attack, marked, picture, z_score

# About 70 % of what was measured, so that a lost step of the method shows; the bound at z = 10 is 1e-22.
LEAST_Z = {
    "none": 40,
    "jpeg10": 9,
    "jpeg50": 34,
    "noise 0.1": 15,
    "noise 0.01": 40,
    "blur 1": 38,
    "brightness 0.5": 40,
    "brightness 1.5": 34,
    "rotation 30": 36,
    "scale 0.75": 40,
    "crop": 30,
    "rotation, scale, jpeg50": 23,
}


@cache
def evidence(name: str) -> np.ndarray:
    case = marked()
    alignment = align_image(case.plain, attack(name, case.image)[0])
    assert alignment is not None
    return case.read(image_cotangent(case.plain, alignment.warped, alignment.mask))


@pytest.mark.parametrize("name", few(["none", "jpeg10", "brightness 1.5", "rotation, scale, jpeg50", "crop"], LEAST_Z))
def test_the_mark_is_read(name: str) -> None:
    z = z_score(evidence(name), marked().chips)
    assert z > LEAST_Z[name], z


@pytest.mark.parametrize("name", few(["none", "jpeg10"], ["none", "jpeg10", "rotation 30", "brightness 1.5"]))
def test_wrong_chips_stay_below_the_hoeffding_bound(name: str) -> None:
    y = evidence(name)
    chips = np.random.default_rng(5).choice([-1.0, 1.0], (20_000, len(y)))
    z = chips @ y / np.linalg.norm(y)
    for threshold in (1.0, 2.0, 3.0):
        bound = np.exp(-(threshold**2) / 2)
        assert (z >= threshold).mean() <= bound + 4 * np.sqrt(bound / len(z))
    assert z.max() < 6


def test_an_unmarked_picture_shows_no_mark() -> None:
    case = marked()
    for name in ("none", "jpeg50", "rotation 30"):
        alignment = align_image(case.plain, attack(name, case.plain)[0])
        assert alignment is not None
        y = case.read(image_cotangent(case.plain, alignment.warped, alignment.mask))
        assert abs(z_score(y, case.chips)) < 4


def test_chroma_alone_is_what_is_left_without_brightness() -> None:
    """A cotangent's share of brightness is what it says of a change of all channels by the same."""
    case = marked()
    mask = np.ones(case.plain.shape[:2], dtype=bool)
    toned = Toned(case.plain, np.ones_like(case.plain))
    shown = case.image + np.float32(0.01) * np.random.default_rng(0).standard_normal(case.image.shape, dtype=np.float32)
    whole = image_cotangent(case.plain, shown, mask, toned)
    chroma = image_cotangent(case.plain, shown, mask, toned, planes=slice(1, 3))
    gray = np.ones(3, np.float32)  # Y of grey is its level, Cb and Cr are nothing
    assert np.abs(chroma @ gray).max() < 1e-4 * np.abs(whole @ gray).max()
    rest = whole - chroma
    np.testing.assert_allclose(rest, (rest @ gray)[..., None] * LUMA, atol=1e-4 * np.abs(whole).max())
    assert np.abs(chroma).max() > 0.05 * np.abs(whole).max()


def test_nothing_comes_from_outside_the_mask() -> None:
    case = marked()
    mask = np.ones(case.plain.shape[:2], dtype=bool)
    mask[:, 200:] = False
    spoiled = case.image.copy()
    spoiled[:, 200:] = np.random.default_rng(0).random(spoiled[:, 200:].shape)
    clean, dirty = (image_cotangent(case.plain, image, mask) for image in (case.image, spoiled))
    assert clean.dtype == np.float32
    assert not clean[:, 200:].any()
    np.testing.assert_array_equal(clean[:, :200], dirty[:, :200])


def test_a_quiet_band_counts_more_than_a_noisy_one() -> None:
    """Noise in the finest diagonal details takes their weight away, and leaves that of others."""
    case, rng = marked(), np.random.default_rng(3)
    everywhere = np.ones(case.plain.shape[:2], dtype=bool)
    plain = (0.2 + 0.6 * case.plain).astype(np.float32)  # nothing is clipped
    approx, details = dwt2(np.zeros(plain.shape[:2], dtype=np.float32), 1)
    details[0] = (*details[0][:2], (0.1 * rng.normal(size=details[0][2].shape)).astype(np.float32))
    noise = idwt2(approx, details)[..., None]

    def gains(image: np.ndarray) -> list[float]:
        """Weight of the diagonal details of the first level, and of those of the second."""
        cotangent, off = (
            dwt2(each.mean(axis=2), 2)[1] for each in (image_cotangent(plain, image, everywhere), image - plain)
        )
        return [float(np.std(cotangent[level][2]) / np.std(off[level][2])) for level in (0, 1)]

    clean = (plain + 0.6 * (case.image - case.plain)).astype(np.float32)
    quiet, loud = gains(clean), gains(clean + noise)
    assert loud[0] < 0.05 * quiet[0]
    assert loud[1] > 0.5 * quiet[1]


def test_a_band_that_a_coder_emptied_counts_less(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is quiet, too, but shows none of the reference's own faint details."""
    name = "rotation, scale, jpeg50"
    with_ = z_score(evidence(name), marked().chips)
    monkeypatch.setattr(residual, "_survival", lambda off, known, share: 1.0)
    assert with_ > 1.03 * z_score(evidence.__wrapped__(name), marked().chips)


def test_how_much_of_faint_details_survives() -> None:
    rng = np.random.default_rng(0)
    known = rng.uniform(-2.5, 2.5, (100, 100)) / 255
    known[::2] *= 100  # strong ones, of which nothing is lost
    faint = np.abs(known) < 2.5 / 255
    whole = np.ones_like(known)
    assert residual._survival(np.where(faint, -0.6 * known, 0.0), known, whole) == pytest.approx(0.4, abs=0.05)
    assert residual._survival(0.03 * rng.normal(size=known.shape), known, whole) == 1.0  # noise takes nothing away
    assert residual._survival(-known, known, whole) == pytest.approx(0.0, abs=0.05)
    assert residual._survival(-known, known, np.where(faint, 0.5, 1.0)) == 1.0  # half outside the mask


@pytest.mark.parametrize("height", [1, 7, 33])
def test_small_and_flat_pictures_are_answered(height: int) -> None:
    flat = np.full((height, 40, 3), 0.5, dtype=np.float32)
    everywhere = np.ones((height, 40), dtype=bool)
    result = image_cotangent(flat, flat, everywhere)
    assert result.shape == flat.shape
    assert np.isfinite(result).all()
    assert np.abs(result).max() < 1e-2
    assert not image_cotangent(flat, flat, ~everywhere).any()
    saturated = image_cotangent(flat, np.ones_like(flat), everywhere)
    assert np.isfinite(saturated).all()


def test_tone_curve_of_exposure_gamma_and_clipping() -> None:
    reference = picture(0)
    everywhere = np.ones(reference.shape[:2], dtype=bool)
    bright = np.clip(1.5 * reference, 0, 1)
    toned = fit_tone(reference, bright, everywhere, 9)
    open_, shut = 1.5 * reference < 0.95, 1.5 * reference > 1.05
    assert shut.sum() > 100
    assert np.abs(toned.predicted - bright)[open_].max() < 0.01
    assert toned.slope[open_].min() > 0.95
    assert toned.slope[shut].max() < 0.05
    gamma = reference**0.7
    assert np.abs(fit_tone(reference, gamma, everywhere, 9).predicted - gamma).mean() < 0.01


def test_noise_on_black_costs_part_of_the_mark() -> None:
    rng = np.random.default_rng(0)
    reference = np.concatenate([np.zeros((64, 64, 3)), np.full((64, 64, 3), 0.5)]).astype(np.float32)
    reference += rng.normal(0, 0.02, reference.shape).astype(np.float32).clip(0)
    noisy = np.clip(reference + rng.normal(0, 0.1, reference.shape), 0, 1).astype(np.float32)
    toned = fit_tone(reference, noisy, np.ones((128, 64), dtype=bool), 9)
    # One half in theory; the noise is measured on values of which many are clipped, so a little low.
    assert 0.4 < np.median(toned.slope[:64]) < 0.8
    assert np.median(toned.slope[64:]) > 0.98


def test_regression_is_robust_and_survives_empty_columns() -> None:
    rng = np.random.default_rng(0)
    design = np.concatenate([rng.normal(size=(500, 2)), np.zeros((500, 1))], axis=1).astype(np.float32)
    target = (design @ np.array([1.0, -2.0, 5.0])).astype(np.float32)
    target[:100] += 50.0
    np.testing.assert_allclose(robust_regression(design, target, rounds=8), [1.0, -2.0, 0.0], atol=0.02)
    assert not robust_regression(design[:3], target[:3]).any()


def test_bad_input_is_refused() -> None:
    case = marked()
    with pytest.raises(InputError, match="shapes differ"):
        image_cotangent(case.plain, case.image[:-1], np.ones(case.plain.shape[:2], dtype=bool))
