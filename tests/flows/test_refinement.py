"""Each term of the refinement does what it is there for, on a ball of a few hundred Gaussians."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from engine.compress.impact import seen_harmonics
from engine.flows.embed import refinement
from engine.flows.embed.layer_strengths import add_dc
from engine.flows.embed.profiles import RefineConfig
from engine.flows.embed.refinement import Codes, Tint, refine
from engine.numerics.wavelet import dwt2
from engine.raster import prepare_view, render, sh_colors
from engine.watermark.statistics import bit_sums, weighted_evidence
from tests.watermark.ball import Ball, marked_ball

SILENT = RefineConfig(steps=8, size=64, lambda_msg=0.0, lambda_rec=0.0, lambda_wavelet=0.0)
"""No loss at all; each test turns on what it is about."""


@pytest.fixture(scope="module")
def ball() -> Ball:
    return marked_ball(count=500, size=64)


@pytest.fixture
def undistorted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(refinement, "draw", lambda rng: lambda image: image)


def refined(
    ball: Ball, config: RefineConfig, views: int = 3, codes: Codes | None = None, **changes: np.ndarray
) -> np.ndarray:
    options = {"displacement": ball.displacement, "uncertainty": np.ones(len(ball.model))} | changes
    return refine(
        ball.model,
        Tint(options["displacement"], ball.plan.layout, ball.signed, ball.spreading.bit_of, 16),
        ball.cameras[:views],
        options["uncertainty"],
        config,
        lambda _: None,
        codes=codes,
    )


def change(ball: Ball, displacement: np.ndarray, view: int = 0) -> np.ndarray:
    """What the mark adds to a picture."""
    return ball.original.render(view, add_dc(ball.model.sh, displacement)) - ball.original.images[view]


def bit_z(ball: Ball, displacement: np.ndarray) -> np.ndarray:
    """(16,) how clearly each bit shows in all views together, right signs positive."""
    y = np.zeros(ball.plan.layout.chips)
    for view in range(3):
        y += ball.plan.layout.gather(ball.original.views[view].backward_colors(change(ball, displacement, view)))
    T, norm = bit_sums(
        weighted_evidence(y, np.abs(ball.signed)), ball.spreading.bit_of, np.sign(ball.signed).astype(np.int8), 16
    )
    return T / norm


def test_without_any_loss_nothing_moves(ball: Ball) -> None:
    np.testing.assert_array_equal(refined(ball, SILENT), ball.displacement)


def test_the_message_loss_writes_the_message(ball: Ball, undistorted: None) -> None:
    """Into a displacement that carries none: noise too small to see."""
    noise = 1e-5 * np.random.default_rng(2).standard_normal(ball.displacement.shape).astype(np.float32)
    written = refined(ball, replace(SILENT, lambda_msg=1.0, steps=20), displacement=noise)
    assert abs(bit_z(ball, noise).mean()) < 0.7
    assert bit_z(ball, written).mean() > 1.0
    assert (bit_z(ball, written) > 0).mean() > 0.8


def test_the_reconstruction_loss_makes_the_mark_smaller(ball: Ball, undistorted: None) -> None:
    smaller = refined(ball, replace(SILENT, lambda_rec=1.0))
    assert np.abs(change(ball, smaller)).mean() < 0.97 * np.abs(change(ball, ball.displacement)).mean()


def test_the_wavelet_loss_takes_fine_detail_out_of_the_mark(ball: Ball, undistorted: None) -> None:
    def detail(displacement: np.ndarray) -> float:
        return float(sum(np.abs(band).mean() for band in dwt2(change(ball, displacement), 1)[1][0]))

    smoother = refined(ball, replace(SILENT, lambda_wavelet=1.0))
    plain = refined(ball, replace(SILENT, lambda_rec=1.0))
    assert detail(smoother) < 0.97 * detail(ball.displacement)
    assert detail(smoother) < detail(plain)


def test_the_message_is_read_through_the_distortion(ball: Ball, monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind a layer that hides the right half, what shows only there has nothing to gain."""
    seen: list[torch.Tensor] = []

    def hide(image: torch.Tensor) -> torch.Tensor:
        seen.append(image.detach())
        return image * (torch.arange(image.shape[3]) < 32)

    monkeypatch.setattr(refinement, "draw", lambda rng: hide)
    moved = (refined(ball, replace(SILENT, lambda_msg=1.0, steps=2), views=1) != ball.displacement).any(axis=1)
    left = np.zeros((64, 64, 1), np.float32)
    left[:, :32] = 1.0
    shown_left = prepare_view(ball.model, ball.cameras[0]).backward_colors(left)[:, 0]
    assert not moved[shown_left == 0].any()
    assert moved[shown_left > 1.0].mean() > 0.9
    # The layer gets the pictures as they are: the plain one and the marked one.
    pictures = [image[0].permute(1, 2, 0).numpy() for image in seen[:2]]
    marked = render(ball.model.with_(sh=add_dc(ball.model.sh, ball.displacement)), ball.cameras[0])
    np.testing.assert_allclose(pictures[0], ball.original.images[0], atol=1e-5)
    np.testing.assert_allclose(pictures[1], marked, atol=1e-5)


def test_steps_are_adams_scaled_by_the_uncertainty(ball: Ball, undistorted: None) -> None:
    """A mark that brightens everything, against the reconstruction alone: the gradient stays the same for all steps,
    and then each step of Adam is the rate itself."""
    bright = np.full_like(ball.displacement, 0.2)
    doubt = np.where(np.arange(len(ball.model)) % 2 == 0, 1.0, 4.0)
    config = replace(SILENT, lambda_rec=1.0, steps=5, rate=1e-3)
    moved = (bright - refined(ball, config, views=1, displacement=bright, uncertainty=doubt))[:, 0]
    seen = ball.impact.per_view[0] > 0.5
    root = np.sqrt(doubt / np.median(doubt))
    np.testing.assert_allclose(moved[seen], (5 * 1e-3 * root)[seen], rtol=1e-3)
    assert not moved[ball.impact.per_view[0] == 0].any()


def test_a_bit_is_the_matched_sum_of_its_gaussians_in_every_stage() -> None:
    """Against loops over stages and Gaussians: T of each bit over the root of its squared parts."""
    ball = marked_ball(count=500, size=64, stages=2)
    layout, bit_of = ball.plan.layout, ball.spreading.bit_of
    pulled = np.random.default_rng(0).standard_normal((500, 3)).astype(np.float32)
    total, squares = np.zeros(16), np.zeros(16)
    chip = 0
    for labels, directions, codes in zip(layout.labels, layout.directions, layout.codes, strict=True):
        for code in range(codes):
            carrier = sum(ball.signed[chip + r] * directions[r] for r in range(3))
            for row in np.flatnonzero(labels == code):
                part = float(pulled[row] @ carrier)
                total[bit_of[chip]] += part
                squares[bit_of[chip]] += part**2
            chip += 3
    assert chip == layout.chips
    tint = Tint(ball.displacement, layout, ball.signed, bit_of, 16)
    pattern, groups = refinement._bit_patterns(tint)
    z = refinement._soft_bits(torch.from_numpy(pulled), pattern, groups, 16).numpy()
    np.testing.assert_allclose(z, total / np.sqrt(squares), rtol=1e-3, atol=1e-4)


def test_a_step_is_what_the_rasterizer_says() -> None:
    """Both directions of the linear map, against differences."""
    ball = marked_ball(count=500, size=64)
    view = ball.original.views[0]
    rng = np.random.default_rng(1)
    colors = torch.from_numpy(rng.standard_normal((500, 3)).astype(np.float32)).requires_grad_(True)
    picture = torch.from_numpy(rng.standard_normal((64, 64, 3)).astype(np.float32)).requires_grad_(True)
    blend: Callable[..., torch.Tensor] = refinement._blend
    forward = (blend(colors, view) * picture.detach()).sum()
    back = (refinement._pull(picture, view) * colors.detach()).sum()
    assert float(forward.detach()) == pytest.approx(float(back.detach()), rel=1e-4)
    (by_colors,), (by_picture,) = torch.autograd.grad(forward, [colors]), torch.autograd.grad(back, [picture])
    assert float((by_colors * colors.detach()).sum()) == pytest.approx(float(forward.detach()), rel=1e-4)
    assert float((by_picture * picture.detach()).sum()) == pytest.approx(float(back.detach()), rel=1e-4)


def test_code_vectors_move_with_all_their_members(undistorted: None) -> None:
    """The paper's way, in two stages: of a Gaussian moves what its two code vectors move."""
    ball = marked_ball(count=500, size=64, stages=2)
    free = Codes(np.zeros((500, 3), np.float32), 0.0, 0.1)
    np.testing.assert_allclose(refined(ball, SILENT, codes=free), ball.displacement, atol=1e-6)
    moved = refined(ball, replace(SILENT, lambda_rec=1.0), codes=free) - ball.displacement
    design = np.zeros((500, sum(ball.plan.layout.codes)))
    design[np.arange(500), ball.plan.layout.labels[0]] = 1.0
    design[np.arange(500), ball.plan.layout.codes[0] + ball.plan.layout.labels[1]] = 1.0
    fitted = design @ np.linalg.lstsq(design, moved, rcond=None)[0]
    assert np.abs(moved).max() > 1e-3
    np.testing.assert_allclose(moved, fitted, atol=1e-5)


def test_equation_7_draws_code_vectors_to_what_they_stand_for(ball: Ball, undistorted: None) -> None:
    left = 0.3 * np.sin(np.arange(len(ball.model)))[:, None].astype(np.float32) * np.ones(3, np.float32)
    config = replace(SILENT, steps=20, rate=1e-3)
    drawn = refined(ball, config, codes=Codes(left, 1.0, 0.0))
    label = ball.plan.layout.labels[0]
    members = np.maximum(np.bincount(label), 1)[:, None]
    wanted = np.stack([np.bincount(label, left[:, c]) for c in range(3)], axis=1) / members
    before, after = (np.abs(x - wanted[label]).mean() for x in (ball.displacement, drawn))
    assert after < 0.95 * before
    still = refined(ball, config, codes=Codes(left, 0.0, 0.0))
    np.testing.assert_allclose(still, ball.displacement, atol=1e-6)


def test_energy_of_a_gap_is_equation_7() -> None:
    gap = np.random.default_rng(0).standard_normal((5, 12)).astype(np.float32)
    x = gap.reshape(5, 4, 3).astype(np.float64)
    detail = ((x[:, 0] - x[:, 1]) ** 2 + (x[:, 2] - x[:, 3]) ** 2).sum() / 2
    found = float(refinement._code_energy(torch.from_numpy(gap), 0.5))
    assert found == pytest.approx(((x**2).sum() + 0.5 * detail) / gap.size, rel=1e-5)
    assert float(refinement._code_energy(torch.ones(5, 3), 0.5)) == pytest.approx(1.0)


def test_harmonics_show_as_the_rasterizer_draws_them(ball: Ball) -> None:
    """A displacement of all coefficients adds to each colour what `sh_colors` adds."""
    wide = 0.01 * np.random.default_rng(6).standard_normal((len(ball.model), 12)).astype(np.float32)
    camera = ball.cameras[1]
    sh = add_dc(ball.model.sh, wide)
    position = camera.position.astype(np.float32)
    added = sh_colors(sh, ball.model.means, position) - sh_colors(ball.model.sh, ball.model.means, position)
    harmonics = torch.from_numpy(seen_harmonics(ball.model, camera, 1))
    shown = refinement._shown(torch.from_numpy(wide), harmonics).numpy()
    np.testing.assert_allclose(shown, added, atol=2e-6)
