"""One picture of a small marked ball, read chip by chip."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from engine.flows.embed.layer_strengths import add_dc
from engine.pictures.alignment.blur import Blur
from engine.pictures.alignment.color_change import ColorSmoothing, Neighborhoods
from engine.pictures.jpeg.coded_blocks import jpeg_cotangent
from engine.watermark import image_evidence
from engine.watermark.config import CONFIG
from engine.watermark.image_evidence import PictureEvidence, PublicMark, _limits, gather_image_evidence
from engine.watermark.model_evidence import Evidence
from engine.watermark.power import expected_z
from engine.watermark.statistics import claim_z
from tests.watermark.ball import Ball, marked_ball


@pytest.fixture(scope="module")
def ball() -> Ball:
    return marked_ball(count=3000, size=128)


def marked_picture(ball: Ball, view: int) -> np.ndarray:
    return ball.original.render(view, add_dc(ball.model.sh, ball.displacement))


def said(ball: Ball, picture: np.ndarray, view: int = 0, blur: Blur | None = None, **shown: Any) -> PictureEvidence:
    reference = ball.original.images[view]
    mark = marked_picture(ball, view) - reference
    mask = np.ones(picture.shape[:2], dtype=bool)
    layout = ball.plan.layout
    if blur is not None:
        picture, reference, mark = (blur.apply(image) for image in (picture, reference, mark))
    return gather_image_evidence(
        layout,
        ball.original.views[view],
        reference,
        picture,
        mask,
        PublicMark(mark, np.sign(ball.signed), blur, **shown),
    )


def read(ball: Ball, picture: np.ndarray, view: int = 0) -> Evidence:
    return said(ball, picture, view).evidence()


def z(ball: Ball, evidence: Evidence) -> float:
    return claim_z(evidence.y, evidence.weights, ball.spreading.bit_of, ball.spreading.chips, ball.message)


def jpeg(picture: np.ndarray, quality: int, subsampling: int = 2) -> np.ndarray:
    """With chroma at half the size, or whole (0)."""
    buffer = io.BytesIO()
    Image.fromarray((np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)).save(
        buffer, "JPEG", quality=quality, subsampling=subsampling
    )
    return np.asarray(Image.open(buffer), dtype=np.float32) / 255


def test_a_marked_picture_shows_what_was_expected_of_it(ball: Ball) -> None:
    found = read(ball, marked_picture(ball, 0))
    expected = expected_z(found.y, found.weights, found.signal)
    assert z(ball, found) > 6
    assert 0.5 * z(ball, found) < expected < 1.5 * z(ball, found)


def test_an_unmarked_picture_shows_nothing_where_a_mark_would_have_shown(ball: Ball) -> None:
    noisy = ball.original.images[0] + 0.01 * np.random.default_rng(0).standard_normal((128, 128, 3)).astype(np.float32)
    found = read(ball, noisy)
    assert abs(z(ball, found)) < 4
    assert expected_z(found.y, found.weights, found.signal) > 5


def test_what_a_blur_moved_is_pulled_back_to_where_it_came_from(ball: Ball) -> None:
    """One that only moves the picture, by seven pixels and four, changes next to nothing."""
    kernel = np.zeros((15, 15), dtype=np.float32)
    kernel[3, 14] = 1.0
    moved = z(ball, said(ball, marked_picture(ball, 0), blur=Blur(kernel)).evidence())
    assert moved == pytest.approx(z(ball, read(ball, marked_picture(ball, 0))), rel=0.1)


def test_what_each_gaussian_says_goes_back_through_the_viewers_curve_and_then_the_washing(ball: Ball) -> None:
    """The curve comes after the washing in the picture, so before it on the way back: what displacements of the
    unwashed model answer is what their washed and flattened ones answer in the picture's own colors."""
    rng = np.random.default_rng(5)
    steep = rng.uniform(0.2, 1.8, (len(ball.model), 3)).astype(np.float32)
    washing = ColorSmoothing(Neighborhoods(ball.model.means), np.array([0.3, 0.5, 0.1, 0.1]))
    displaced = rng.normal(size=(len(ball.model), 3)).astype(np.float32)
    picture = marked_picture(ball, 0)
    plain, toned, washed, both = (
        said(ball, picture, steep=curve, change=change).pulled[0].astype(np.float64)
        for curve, change in ((None, None), (steep, None), (None, washing), (steep, washing))
    )
    scale = np.abs(plain * displaced).sum()
    for found, forward in (
        (toned, steep * displaced),
        (washed, washing.apply(displaced)),
        (both, steep * washing.apply(displaced)),
    ):
        assert (found * displaced).sum() == pytest.approx((plain * forward).sum(), abs=1e-5 * scale)
        assert abs((found * displaced).sum() - (plain * displaced).sum()) > 1e-3 * scale
    assert abs((plain * (steep * washing.apply(displaced) - washing.apply(steep * displaced))).sum()) > 1e-3 * scale


def test_a_patch_painted_over_saturates(ball: Ball) -> None:
    """It may not outweigh the rest: no chip counts for more than `clip` medians of its carrier."""
    painted = marked_picture(ball, 0).copy()
    painted[50:80, 50:80] = [1.0, 0.0, 1.0]
    found = read(ball, painted)
    shown = np.abs(found.weights * found.y).reshape(-1, 3)
    for carrier in shown.T:
        assert carrier.max() <= 1.02 * CONFIG.evidence.clip * np.median(carrier[carrier > 0])


def test_the_quantiser_of_a_jpeg_is_made_use_of(ball: Ball, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only where there was one; the quality is the one that the picture was saved with."""
    qualities: list[int] = []

    def spy(*arguments: object) -> np.ndarray:
        qualities.append(arguments[-1])  # type: ignore[arg-type]
        return jpeg_cotangent(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(image_evidence, "jpeg_cotangent", spy)
    assert z(ball, read(ball, jpeg(marked_picture(ball, 0), 60))) > 4
    assert qualities
    assert max(abs(quality - 60) for quality in qualities) <= 2
    qualities.clear()
    read(ball, marked_picture(ball, 0))
    assert not qualities


def test_chroma_of_a_jpeg_says_something_too(ball: Ball, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the coder's intervals, and by its pixels where it kept chroma whole."""
    for subsampling, name in ((2, "CodedChroma.cotangent"), (0, "image_cotangent")):
        picture = jpeg(marked_picture(ball, 0), 80, subsampling)
        both = z(ball, read(ball, picture))
        with monkeypatch.context() as patch:
            patch.setattr(f"engine.watermark.image_evidence.{name}", lambda *_, **__: np.float32(0.0))
            assert both > 1.03 * z(ball, read(ball, picture)) > 2.5


def test_exposure_of_a_jpeg_is_taken_out(ball: Ball) -> None:
    """A picture a tenth darker reads as well: the difference is no mark, and the coder's steps still fit."""
    plain, darker = (z(ball, read(ball, jpeg(gain * marked_picture(ball, 0), 80))) for gain in (1.0, 0.9))
    assert darker > 0.96 * plain > 2.5


def test_pictures_of_several_views_add_up(ball: Ball) -> None:
    parts = [said(ball, marked_picture(ball, view), view) for view in range(3)]
    total = parts[0].plus(parts[1]).plus(parts[2])
    for name in ("y", "response", "held_y", "held_response"):
        np.testing.assert_allclose(getattr(total, name), sum(getattr(part, name) for part in parts), atol=1e-9)
    assert len(total.pulled) == 3
    assert z(ball, total.evidence()) > 1.2 * max(z(ball, part.evidence()) for part in parts)


def made(y: np.ndarray, response: np.ndarray, chips: tuple[int, int]) -> PictureEvidence:
    """Of two layers, three and two kinds that take turns, with weights of one."""
    return PictureEvidence(((chips[0], 3), (chips[1], 2)), np.ones(len(y)), y, response, y, response, ())


def test_each_layer_counts_for_what_it_should_show() -> None:
    """Whatever unit the second one has: z of both is as near as it can be to the root of the sum of squares."""
    rng, tint, grain = np.random.default_rng(1), 3000, 6000
    size = np.concatenate([np.full(tint, 0.2), np.full(grain, 0.1)])
    y = size + rng.standard_normal(tint + grain)
    alone = [part.sum() / np.linalg.norm(part) for part in (y[:tint], y[tint:])]
    for unit in (1e-3, 1.0, 1e3):
        units = np.concatenate([np.ones(tint), np.full(grain, unit)])
        found = made(units * y, units * size, (tint, grain)).evidence(2.0)
        both = found.evidence.sum() / np.linalg.norm(found.evidence)
        assert both == pytest.approx(np.hypot(*alone), rel=0.02)
        np.testing.assert_array_equal(found.y[:tint], y[:tint])
        np.testing.assert_array_equal(found.signal[:tint], 2.0 * size[:tint])
    silent = made(y, np.concatenate([size[:tint], -size[tint:]]), (tint, grain)).evidence()
    assert not silent.weights[tint:].any()
    nothing = made(0.0 * y, 0.0 * y, (tint, grain)).evidence()
    assert np.isfinite(nothing.y).all()


def test_chips_of_like_response_count_for_what_their_scatter_leaves() -> None:
    """A tenth of the chips hold the mark and respond loudly; the scatter of the others would drown it."""
    rng, chips = np.random.default_rng(2), 3000
    loud = rng.random(chips) < 0.1
    y = np.where(loud, 1.0 + rng.standard_normal(chips), 3.0 * rng.standard_normal(chips))
    response = np.where(loud, 1.0, 0.02) * rng.uniform(0.9, 1.1, chips)
    picture = made(np.concatenate([y, y[:2]]), np.concatenate([response, response[:2]]), (chips, 2))
    plain, weighed = (each.evidence[:chips] for each in (picture.evidence(), picture.by_scatter()))
    assert weighed.sum() / np.linalg.norm(weighed) > 2.0 * plain.sum() / np.linalg.norm(plain)
    # of one kind and class, all have one factor
    rank = np.argsort(np.argsort(response[::3]))
    factor = weighed[::3] / y[::3]
    for part in np.array_split(np.arange(len(rank)), CONFIG.evidence.alike):
        inside = factor[np.isin(rank, part[5:-5])]
        np.testing.assert_allclose(inside, inside[0], rtol=1e-9)
    silent = np.where(np.arange(chips) % 7 == 0, 0.0, response)  # what is not seen says nothing, whatever is measured
    heard = made(np.concatenate([y, y[:2]]), np.concatenate([silent, silent[:2]]), (chips, 2)).by_scatter()
    assert not heard.evidence[:chips:7].any()
    turned = made(np.concatenate([-y, y[:2]]), np.concatenate([response, response[:2]]), (chips, 2)).by_scatter()
    np.testing.assert_allclose(turned.evidence[:chips], -weighed, rtol=1e-9)  # an odd function: blind to signs
    wild = made(np.concatenate([10.0 * y, y[:2]]), np.concatenate([response, response[:2]]), (chips, 2)).by_scatter()
    np.testing.assert_allclose(wild.evidence[:chips], weighed / 10.0, rtol=1e-9)


def test_what_saturates_follows_from_the_usual_not_from_the_loudest() -> None:
    """Of each carrier its own; silent chips do not count."""
    loudest = np.array([1.0, 20.0, -1.0, 20.0, 1.0, 0.0, 500.0, -60.0])
    np.testing.assert_array_equal(_limits(loudest, 2), CONFIG.evidence.clip * np.array([1.0, 20.0] * 4))
