"""What pruning leaves, fitted to the original's renders: fewer Gaussians of the quality that was asked for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.compress import recovery
from engine.compress.config import CONFIG
from engine.compress.pruning import PruneConfig, prune
from engine.compress.recovery import Measure, Recovery, Target, fit, prune_and_fit, recoverable, sum_squares, views_for
from engine.flows.embed.delivery import slim_down
from engine.flows.embed.planning_basis import lay_groundwork
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.terms import MarkTerms
from engine.flows.progress import Clock
from engine.flows.views.camera_rig import make_rig
from engine.flows.views.view_set import worst_psnr_against
from engine.formats import write_model
from engine.lab.evaluate.marked_scene import bench_key
from engine.model import Camera, GaussianModel
from engine.raster import render
from engine.usecases.mark import MarkOutput, MarkRequest, mark
from tests.threads import with_one_and_two_threads
from tests.watermark.ball import ball_model

BUDGET = 32.0
SIDE = 64


@pytest.fixture(scope="module", autouse=True)
def _small() -> object:
    """As little work as shows it."""
    patch = pytest.MonkeyPatch()
    patch.setattr(
        recovery,
        "_CONFIG",
        replace(CONFIG.recovery, least_work=3e8, work_each=0.0, round=(30, 12, 8), least_gain_db=0.05),
    )
    yield
    patch.undo()


def dense(count: int = 3000, degree: int = 0) -> GaussianModel:
    """A ball with more Gaussians than its pictures need: each stands four times, a little apart and fainter."""
    ball = ball_model(count // 4, degree).take(np.repeat(np.arange(count // 4), 4))
    apart = 0.4 * np.exp(ball.log_scales) * np.random.default_rng(5).standard_normal((len(ball), 3))
    faint = 1.0 - (1.0 - ball.opacities) ** 0.25
    return ball.with_(means=ball.means + apart, opacity_logits=np.log(faint / (1.0 - faint)))


def belt(model: GaussianModel, views: int, seed: int) -> list[Camera]:
    """Views of the ball from neither pole."""
    return make_rig(model, 2 * views, SIDE, SIDE, jitter=np.random.default_rng(seed).random((2 * views, 4)))[
        views // 2 : -(views // 2)
    ]


def target_of(model: GaussianModel, views: int = 16) -> Target:
    return Target.of(model, belt(model, views, 1))


def unseen(model: GaussianModel, seed: int = 2) -> Measure:
    cameras = belt(model, 6, seed)
    return worst_psnr_against([render(model, camera) for camera in cameras], cameras)


def tell(share: float, psnr_db: float) -> None:
    assert 0.0 <= share <= 1.0
    assert psnr_db > 0.0


def test_many_decibels_come_back() -> None:
    whole = dense()
    measure = unseen(whole)
    thin = whole.take(np.arange(0, len(whole), 2))
    fitted, psnr_db = fit(Recovery(thin, target_of(whole)), measure, tell)
    assert psnr_db == pytest.approx(measure(fitted), abs=1e-6)
    assert psnr_db > measure(thin) + 5.0
    np.testing.assert_array_equal(fitted.sh, thin.sh)


def test_fewer_are_left_at_the_same_budget_also_in_views_that_had_no_part() -> None:
    whole = dense()
    measure, target, config = unseen(whole), target_of(whole), PruneConfig(budget_db=BUDGET)
    impact = sum_squares(whole, target.cameras)
    plain = prune(whole, impact, measure, 1.0, config)
    found = prune_and_fit(whole, impact, measure, 1.0, config, target, 100, tell)
    assert len(found.model) == len(found.kept) < 0.8 * len(plain.model)
    assert found.psnr_db == pytest.approx(measure(found.model), abs=1e-6)
    assert found.psnr_db >= BUDGET
    assert unseen(whole, seed=3)(found.model) > BUDGET - 1.0


@pytest.mark.parametrize(("fewest", "left"), [(300, 300), (5000, 375)])
def test_no_more_goes_than_the_mark_can_spare(fewest: int, left: int) -> None:
    """However good what is left looks: so many, or a quarter of the model."""
    whole = dense(1500)
    target = target_of(whole, 4)
    impact, config = sum_squares(whole, target.cameras), PruneConfig(budget_db=30.0)
    found = prune_and_fit(whole, impact, lambda _: 50.0, 1.0, config, target, fewest, tell)
    assert len(found.model) == len(found.kept) == left


def test_where_no_fit_reaches_the_budget_nothing_goes() -> None:
    """A decibel short is short; what the fits began with was allowed less."""
    whole = dense(1500)
    target = target_of(whole, 4)
    impact, config = sum_squares(whole, target.cameras), PruneConfig(budget_db=30.0)
    short = lambda model: 50.0 if len(model) == len(whole) else 29.0  # noqa: E731
    assert len(prune_and_fit(whole, impact, short, 1.0, config, target, 300, tell).model) == len(whole)


def test_work_is_not_spent_on_a_fit_that_will_not_reach_the_budget() -> None:
    """Where every Gaussian counts, what pruning alone leaves is fitted, and a few more go."""
    whole = dense(1500)
    target = target_of(whole, 4)
    impact, config = sum_squares(whole, target.cameras), PruneConfig(budget_db=30.0)
    seen: list[tuple[float, float]] = []

    def steep(model: GaussianModel) -> float:
        """40 dB a factor of e, of which a fit gives 2, and 0.2 more with each round."""
        fitted = not np.isin(model.means, whole.means).all()
        return float(31.0 + 40.0 * np.log(len(model) / len(whole))) + fitted * (2.0 + 0.2 * len(seen))

    plain = prune(whole, impact, steep, 1.0, config)
    found = prune_and_fit(whole, impact, steep, 1.0, config, target, 100, lambda *progress: seen.append(progress))
    assert found.psnr_db >= 30.0
    assert 0.8 * len(plain.model) < len(found.model) < len(plain.model)
    assert not np.isin(found.model.means, whole.means).all()
    assert [psnr_db > 28.0 for _, psnr_db in seen[:4]] == [False, False, True, True]


def test_the_same_bits_on_any_number_of_threads() -> None:
    whole = dense(1500, 1)
    thin, target = whole.take(np.arange(0, len(whole), 2)), target_of(whole, 4)

    def run() -> GaussianModel:
        at_work = Recovery(thin, target)
        worth = sum_squares(at_work.round(), target.cameras)
        fewer = at_work.thinned(0.8)
        gone = np.setdiff1d(np.arange(len(thin)), fewer.kept)
        assert worth[fewer.kept].mean() > 3.0 * worth[gone].mean()
        return fewer.round()

    one, two = with_one_and_two_threads(run)
    assert len(one) < len(thin)
    for name in ("means", "quats", "log_scales", "opacity_logits"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_odd_gaussians_do_no_harm(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stray far away, one as large as the scene, needles, quaternions of any length."""
    whole = dense(1200)
    means, log_scales, quats = whole.means.copy(), whole.log_scales.copy(), 5.0 * whole.quats
    means[0] = 1e6
    log_scales[1] = 3.0
    log_scales[2:40, 0] -= 12.0
    odd = whole.with_(means=means, log_scales=log_scales, quats=quats)
    monkeypatch.setattr(recovery, "_CONFIG", replace(CONFIG.recovery, stretch=0.08))
    fitted = Recovery(odd.take(np.arange(0, len(odd), 2)), target_of(odd)).round()
    start = odd.log_scales[::2]
    assert all(np.isfinite(getattr(fitted, name)).all() for name in ("means", "quats", "log_scales", "opacity_logits"))
    assert 0.07 < np.abs(fitted.log_scales - start).max() <= 0.08 + 1e-5
    assert np.abs(fitted.opacity_logits).max() <= CONFIG.recovery.opacity_logit
    np.testing.assert_allclose(np.linalg.norm(fitted.quats, axis=1), 1.0, atol=1e-5)
    assert unseen(odd)(fitted) > unseen(odd)(odd.take(np.arange(0, len(odd), 2))) + 1.0


def test_what_has_no_gradients_is_only_pruned() -> None:
    whole = dense(900)
    assert not recoverable(replace(whole, antialiased=True))
    log_scales = whole.log_scales.copy()
    log_scales[:, 2] = log_scales[:, :2].min(axis=1) + np.log(1e-6)
    discs = whole.with_(log_scales=log_scales)
    config = EmbedConfig(views=3, view_size=SIDE, landmark_views=0, prune=PruneConfig(budget_db=30.0))
    slim, report = slim_down(lay_groundwork(discs, bench_key(1), "11" * 32, config), config, Clock())
    assert report["psnr_pruned_worst_view"] >= 30.0
    assert {tuple(mean) for mean in slim.means.tolist()} < {tuple(mean) for mean in discs.means.tolist()}


def test_views_are_fewer_where_they_cost_more() -> None:
    assert (views_for(1_000, SIDE), views_for(10_000_000, 800)) == (CONFIG.recovery.views, CONFIG.recovery.least_views)


def test_stopped_halfway_nothing_is_written(tmp_path: Path) -> None:
    write_model(dense(1500), tmp_path / "scene.ply")
    seen: list[str] = []

    def stop(stage: str, fraction: float) -> None:
        seen.append(stage)
        if stage.startswith("prune: "):
            raise KeyboardInterrupt

    config = EmbedConfig(views=3, view_size=SIDE, landmark_views=0, prune=PruneConfig(budget_db=BUDGET))
    output = MarkOutput(tmp_path / "marked.ply", tmp_path / "a.record")
    request = MarkRequest(
        model=tmp_path / "scene.ply", key=bench_key(1), outputs={"": output}, terms=MarkTerms(config=config)
    )
    with pytest.raises(KeyboardInterrupt):
        next(mark(request, stop))
    assert seen[-1].endswith(" dB")
    assert [path.name for path in tmp_path.iterdir()] == ["scene.ply"]
