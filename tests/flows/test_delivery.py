"""What is delivered: no more than the scene needs, and never less than was asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from engine.compress.code_fit import fit_codes
from engine.compress.config import CONFIG as COMPRESS
from engine.compress.hvq import Stage, decode_stages
from engine.compress.impact import paper_impact
from engine.compress.pruning import PruneConfig, Pruned, drop_unseen_bands
from engine.compress.recovery import Target, Tell
from engine.flows.embed import delivery
from engine.flows.embed.config import CONFIG
from engine.flows.embed.delivery import slim_down, unmarked_delivery
from engine.flows.embed.planning_basis import Groundwork, color_weights
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.variant import PLAIN
from engine.flows.progress import Clock
from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.flows.views.view_set import worst_psnr_against
from engine.model import GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import render
from tests.watermark.ball import Ball, marked_ball


@pytest.fixture(scope="module")
def ball() -> Ball:
    return marked_ball(size=64)


def slim(ball: Ball, budget: float, **knobs: object) -> tuple[GaussianModel, dict[str, object]]:
    prune = PruneConfig(budget_db=budget, merge_distance=0.0, recover=False, **knobs)  # type: ignore[arg-type]
    return slim_down(groundwork(ball), EmbedConfig(prune=prune), Clock())


def groundwork(ball: Ball) -> Groundwork:
    return Groundwork(measure_extent(ball.model), ball.original, ball.impact, EmbedConfig(), PLAIN)


def worst_psnr(ball: Ball, model: GaussianModel) -> float:
    return min(
        psnr(image, render(model, camera)) for image, camera in zip(ball.original.images, ball.cameras, strict=True)
    )


def kept_rows(ball: Ball, model: GaussianModel) -> np.ndarray:
    """(N,) bool."""
    left = {tuple(mean) for mean in model.means.tolist()}
    return np.array([tuple(mean) in left for mean in ball.model.means.tolist()])


@pytest.mark.parametrize("rank", ["error", "paper"])
def test_what_goes_is_what_the_rank_says(ball: Ball, rank: str) -> None:
    """Eq 4 with "paper", the error of leaving one out with "error"."""
    model, report = slim(ball, 24.0, rank=rank)
    kept = kept_rows(ball, model)
    values = {"paper": paper_impact(ball.model, ball.impact), "error": ball.impact.squared}
    assert 0.05 < kept.mean() < 0.95
    assert values[rank][kept].min() >= values[rank][~kept].max()
    other = values["error" if rank == "paper" else "paper"]
    assert other[kept].min() < other[~kept].max(), "the two ranks would have kept the same"
    assert report["psnr_pruned_worst_view"] == pytest.approx(worst_psnr(ball, model), abs=1e-3)


def test_bands_spend_their_share_of_the_error_at_most(ball: Ball, monkeypatch: pytest.MonkeyPatch) -> None:
    allowed: list[tuple[int, float]] = []

    def spy(model: GaussianModel, curvature: np.ndarray, pixels: int, error: float) -> tuple[GaussianModel, int]:
        allowed.append((pixels, -10 * np.log10(error)))
        return drop_unseen_bands(model, curvature, pixels, error)

    monkeypatch.setattr(delivery, "drop_unseen_bands", spy)
    monkeypatch.setattr(delivery, "prune_and_fit", lambda model, *_: Pruned(model, np.arange(len(model)), 99.0, 0))
    thin, report = slim(ball, 30.0)
    assert allowed == [(3 * 64 * 64, pytest.approx(30.0 - 10 * np.log10(CONFIG.plan.band_share)))]
    assert report["sh_bands_dropped"] > 0  # type: ignore[operator]
    assert worst_psnr(ball, thin) >= 30.0 - 10 * np.log10(CONFIG.plan.band_share)


def test_a_budget_that_the_bands_alone_would_break_keeps_them(ball: Ball, monkeypatch: pytest.MonkeyPatch) -> None:
    gray = ball.model.with_(sh=np.zeros_like(ball.model.sh))
    monkeypatch.setattr(delivery, "drop_unseen_bands", lambda *_: (gray, 5))
    model, report = slim(ball, 30.0)
    assert report["sh_bands_dropped"] == 0
    assert worst_psnr(ball, model) >= 30.0


def test_without_a_budget_the_model_is_left_alone(ball: Ball) -> None:
    model, report = slim_down(groundwork(ball), EmbedConfig(), Clock())
    assert model is ball.model
    assert report == {}


def test_colors_weigh_what_their_error_costs(ball: Ball) -> None:
    """The inverse of the Laplace uncertainty: the squared blending weight, and next to nothing for the unseen."""
    weights = color_weights(ball.model, ball.impact)
    np.testing.assert_allclose(weights, ball.impact.squared + COMPRESS.prior, rtol=1e-6)
    unseen = replace(ball.impact, squared=np.zeros(len(ball.model)))
    np.testing.assert_allclose(color_weights(ball.model, unseen), COMPRESS.prior, rtol=1e-6)


@dataclass
class Compact:
    """What a compact delivery of the ball came to, so many dB above its first stage as it comes."""

    more_db: float
    fits: list[tuple[int, float]]  # stages, and worst PSNR after each fit
    ground: Groundwork
    model: GaussianModel
    stages: tuple[Stage, ...]


@pytest.fixture(scope="module")
def seen_ball() -> Ball:
    """From so many views that what is seen best in them is seen well all around."""
    return marked_ball(size=64, views=10)


@pytest.fixture
def compacted(seen_ball: Ball, monkeypatch: pytest.MonkeyPatch) -> Callable[[float], Compact]:
    fits: list[tuple[int, float]] = []

    def spy(model: GaussianModel, stages: tuple[Stage, ...], target: Target, tell: Tell) -> tuple[Stage, ...]:
        known = {camera.viewmat.tobytes() for camera in seen_ball.cameras}
        assert not known & {camera.viewmat.tobytes() for camera in target.cameras}
        fitted = fit_codes(model, stages, target, tell)
        fits.append((len(stages), worst_psnr(seen_ball, model.with_(sh=decode_stages(fitted)))))
        return fitted

    def run(more_db: float) -> Compact:
        ground = replace(groundwork(seen_ball), config=EmbedConfig(output="compact"))
        first = worst_psnr(seen_ball, seen_ball.model.with_(sh=decode_stages(ground.stages)))
        config = replace(ground.config, compact_db=first + more_db - CONFIG.plan.mark_room_db)
        model, stages = unmarked_delivery(ground, ground, config, lambda *_: None)
        np.testing.assert_array_equal(model.sh, decode_stages(stages))
        return Compact(more_db, fits, ground, model, stages)

    monkeypatch.setattr(delivery, "fit_codes", spy)
    return run


def test_compact_is_the_cells_alone_where_they_do(compacted: Callable[[float], Compact]) -> None:
    found = compacted(-0.01)
    assert found.fits == []
    assert found.stages is found.ground.stages


def test_compact_fits_codes_before_it_learns_more(seen_ball: Ball, compacted: Callable[[float], Compact]) -> None:
    found = compacted(0.5)
    assert [count for count, _ in found.fits] == [1]
    assert len(found.stages) == 1
    assert worst_psnr(seen_ball, found.model) == pytest.approx(found.fits[0][1], abs=1e-3)
    assert found.stages[0].labels is found.ground.stages[0].labels, "the cells that carry the mark"


def test_compact_learns_stages_until_the_mark_has_room(seen_ball: Ball, compacted: Callable[[float], Compact]) -> None:
    """Far below what is wanted nothing is fitted."""
    found = compacted(CONFIG.plan.fit_gain_db + 0.5)
    first = worst_psnr(seen_ball, seen_ball.model.with_(sh=decode_stages(found.ground.stages)))
    assert worst_psnr(seen_ball, found.model) >= first + found.more_db
    assert 1 < len(found.stages) <= CONFIG.plan.most_stages
    assert all(count > 1 for count, _ in found.fits)


def test_compact_out_of_stages_delivers_the_better(
    compacted: Callable[[float], Compact], seen_ball: Ball, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(delivery, "_CONFIG", replace(CONFIG.plan, most_stages=0))
    found = compacted(60.0)
    assert [count for count, _ in found.fits] == [1]
    assert worst_psnr(seen_ball, found.model) == pytest.approx(found.fits[0][1], abs=1e-3)
    monkeypatch.setattr(delivery, "fit_codes", lambda model, stages, *_: _blackened(stages))
    assert worst_psnr(seen_ball, compacted(60.0).model) > 20.0


def test_compact_of_a_pruned_model_is_fitted_to_the_original(seen_ball: Ball, monkeypatch: pytest.MonkeyPatch) -> None:
    """What stands in for a pruned model is darker: renders of the original say so, its own do not."""
    monkeypatch.setattr(delivery, "_CONFIG", replace(CONFIG.plan, most_stages=0))
    original = replace(groundwork(seen_ball), config=EmbedConfig(output="compact", compact_db=60.0))
    dark, heard = seen_ball.model.with_(sh=seen_ball.model.sh - np.float32(0.2)), list[float]()
    ground = original.of(dark, Clock())
    model, _ = unmarked_delivery(original, ground, original.config, lambda share, psnr_db: heard.append(share))
    assert worst_psnr(seen_ball, model) > worst_psnr(seen_ball, dark) + 3.0
    assert 0.0 < heard[0] <= heard[-1] <= 1.0


def _blackened(stages: tuple[Stage, ...]) -> tuple[Stage, ...]:
    return tuple(replace(stage, codebook=stage.codebook - 9.0) for stage in stages)


def test_colors_are_fitted_where_harmonics_are_cut(ball: Ball) -> None:
    """To the renders of the whole model, where the owner's cameras leave views enough."""
    prune = PruneConfig(budget_db=20.0, sh_degree=0, merge_distance=0.0)
    config = EmbedConfig(view_size=64, prune=prune)
    keep_all = lambda model, *_: Pruned(model, np.arange(len(model)), 99.0, 0)  # noqa: E731
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(delivery, "prune_and_fit", keep_all)
        fitted, _ = slim_down(groundwork(ball), config, Clock())
        cut, _ = slim_down(groundwork(ball), replace(config, prune=replace(prune, recover=False)), Clock())
        (other,) = make_rig(ball.model, 1, 64, 64)
        few, _ = slim_down(replace(groundwork(ball), own=[*ball.cameras, other]), config, Clock())
    assert fitted.sh.shape == cut.sh.shape == (len(ball.model), 1, 3)
    for model in (cut, few):
        np.testing.assert_array_equal(model.sh, ball.model.sh[:, :1])
    assert worst_psnr(ball, fitted) > worst_psnr(ball, cut) + 0.5


def test_fidelity_is_the_model_itself(ball: Ball) -> None:
    ground = groundwork(ball)
    delivered = unmarked_delivery(ground, ground, EmbedConfig(), lambda *_: None)
    assert delivered == (ball.model, ground.stages)


def test_the_worst_view_decides(ball: Ball) -> None:
    """Colours changed on one side of the ball: the views of that side say how much."""
    sh = ball.model.sh.copy()
    sh[ball.model.means[:, 0] > 0.3, 0] += 0.5
    changed = ball.model.with_(sh=sh)
    each = [psnr(image, render(changed, c)) for image, c in zip(ball.original.images, ball.cameras, strict=True)]
    assert max(each) > min(each) + 1.0
    assert worst_psnr_against(ball.original.images, ball.cameras)(changed) == pytest.approx(min(each), abs=1e-3)
    assert ball.original.worst(sh) == pytest.approx(min(each), abs=1e-3)
