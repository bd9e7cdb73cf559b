"""Code vectors fitted to the original's renders: the least-squares solution, of what is seen and not clamped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.compress import code_fit
from engine.compress.code_fit import fit_codes, fit_colors
from engine.compress.config import CONFIG
from engine.compress.hvq import Stage, decode_stages
from engine.compress.recovery import Target
from engine.flows.views.camera_rig import make_rig
from engine.flows.views.view_set import worst_psnr_against
from engine.model import Camera, GaussianModel
from engine.raster import render
from tests.threads import with_one_and_two_threads
from tests.watermark.ball import ball_model

SIDE = 48


def cameras(model: GaussianModel, views: int, seed: int = 1) -> list[Camera]:
    return make_rig(model, views, SIDE, SIDE, jitter=np.random.default_rng(seed).random((views, 4)))


def coded(model: GaussianModel, codes: tuple[int, ...], seed: int = 0) -> tuple[Stage, ...]:
    """Stages of random codes: the first holds the plain means of its members, the others nothing."""
    rng, stages = np.random.default_rng(seed), list[Stage]()
    for count in codes:
        labels = rng.permutation(np.arange(len(model)) % count).astype(np.int32)
        colors = model.sh.reshape(len(model), -1)
        means = np.stack([colors[labels == m].mean(axis=0) for m in range(count)])
        stages.append(Stage(means * np.float32(not stages), labels))
    return tuple(stages)


def tell(share: float, psnr_db: float) -> None:
    assert 0.0 < share <= 1.0
    assert 5.0 < psnr_db < 200.0


def squared_error(model: GaussianModel, target: Target) -> float:
    pairs = zip(target.images, target.cameras, strict=True)
    return sum(float(np.square(np.clip(render(model, camera), 0, 1) - image).sum()) for image, camera in pairs)


def renders(model: GaussianModel, seen: list[Camera]) -> np.ndarray:
    return np.concatenate([render(model, camera).ravel() for camera in seen]).astype(np.float64)


@pytest.mark.parametrize("degree", [0, 1])
def test_the_least_squares_solution(degree: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the whole matrix, column by column from renders."""
    monkeypatch.setattr(code_fit, "_CONFIG", replace(CONFIG.code_fit, steps=60, least_gain=0.0, prior=1e-6))
    model, codes = ball_model(90, degree), (12, 5)
    target, stages = Target.of(model, cameras(model, 3)), coded(model, codes)
    gray = model.with_(sh=np.zeros_like(model.sh))
    nothing = renders(gray, target.cameras)
    columns = []
    for stage in stages:
        for code in range(len(stage.codebook)):
            for number in range(3 * (degree + 1) ** 2):
                sh = gray.sh.reshape(len(gray), -1).copy()
                sh[stage.labels == code, number] = 0.1
                columns.append(10.0 * (renders(gray.with_(sh=sh.reshape(gray.sh.shape)), target.cameras) - nothing))
    wanted = np.concatenate([image.ravel() for image in target.images]) - nothing
    best = np.linalg.lstsq(np.stack(columns, 1), wanted, rcond=1e-6)[0]
    least = float(np.square(np.stack(columns, 1) @ best - wanted).sum())
    plain = squared_error(model.with_(sh=decode_stages(stages)), target)
    fitted = squared_error(model.with_(sh=decode_stages(fit_codes(model, stages, target, tell))), target)
    assert least < fitted < 1.03 * least < 0.7 * plain


def test_few_steps_do_also_for_views_that_had_no_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code_fit, "_CONFIG", replace(CONFIG.code_fit, prior=1e-3))  # 48 pixels are few
    model = ball_model(900)
    target, stages = Target.of(model, cameras(model, 8)), coded(model, (150, 40))
    others = cameras(model, 6, seed=2)
    measure, seen = worst_psnr_against([render(model, camera) for camera in others], others), list[float]()
    fitted = fit_codes(model, stages, target, lambda share, psnr_db: seen.append(psnr_db))
    before, after = (model.with_(sh=decode_stages(each)) for each in (stages, fitted))
    assert measure(after) > measure(before) + 1.0
    assert seen == sorted(seen)
    mean_error = squared_error(after, target) / (3 * SIDE**2 * len(target.cameras))
    assert seen[-1] == pytest.approx(-10 * np.log10(mean_error), abs=0.4)
    for old, new in zip(stages, fitted, strict=True):
        assert new.labels is old.labels
        assert new.codebook.dtype == np.float32


def test_it_ends_where_a_step_gains_next_to_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    model, seen = ball_model(200), list[float]()
    monkeypatch.setattr(code_fit, "_CONFIG", replace(CONFIG.code_fit, least_gain=1.0))
    fit_codes(model, coded(model, (30,)), Target.of(model, cameras(model, 2)), lambda share, _: seen.append(share))
    assert len(seen) == 1


def test_clamped_colors_and_what_hardly_shows_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """A code of black Gaussians, which no gradient may move, one of Gaussians without opacity, one of faint ones."""
    monkeypatch.setattr(code_fit, "_CONFIG", replace(CONFIG.code_fit, prior=0.5))
    model, labels = ball_model(300, 0), (np.arange(300) % 30).astype(np.int32)
    logits, sh = model.opacity_logits.copy(), model.sh.reshape(300, 3).copy()
    sh[labels == 7] = -9.0
    logits[labels == 8], logits[labels == 9] = -20.0, -4.0
    book = np.stack([sh[labels == code].mean(axis=0) for code in range(30)])
    target = Target.of(model, cameras(model, 3))
    fitted = fit_codes(model.with_(opacity_logits=logits), (Stage(book, labels),), target, tell)
    moved = np.abs(fitted[0].codebook - book).max(axis=1)
    assert (moved[[7, 8]] == 0.0).all()
    assert 0.0 < moved[9] < 0.1 * np.median(moved)


def test_colors_of_their_own_make_good_for_bands_that_went() -> None:
    model = ball_model(600, 1)
    cut = model.with_(sh=np.ascontiguousarray(0.7 * model.sh[:, :1]))
    target = Target.of(model, cameras(model, 6))
    assert squared_error(fit_colors(cut, target, tell), target) < 0.2 * squared_error(cut, target)


def test_the_same_bits_on_any_number_of_threads() -> None:
    model = ball_model(700)
    target, stages = Target.of(model, cameras(model, 3)), coded(model, (100, 20))
    one, two = with_one_and_two_threads(lambda: fit_codes(model, stages, target, tell))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.codebook, b.codebook)
