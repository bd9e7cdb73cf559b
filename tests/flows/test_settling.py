"""Both layers share one budget, and strengths are settled before a chip is drawn."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from engine.flows.embed import copy_mark as marking
from engine.flows.embed import layer_strengths as settling
from engine.flows.embed.config import CONFIG
from engine.flows.embed.copy_mark import Committed, make_owner_mark
from engine.flows.embed.embedding import embed
from engine.flows.embed.layer_strengths import Fidelity, Settled, add_dc, measure, settle, settle_grain
from engine.flows.embed.profiles import EmbedConfig, profile
from engine.flows.embed.variant import Variant
from engine.flows.views.view_set import ViewSet
from engine.lab.evaluate.marked_scene import bench_key
from engine.model import GaussianModel
from engine.watermark.grain import Grain, roughen
from engine.watermark.spreading import public_signs
from tests.watermark.ball import marked_ball

pytestmark = pytest.mark.slow

WANTED = EmbedConfig(psnr_db=40.0, ssim=0.9)
SMALL = profile("fast", views=2, view_size=128, landmark_views=0)


@pytest.fixture(scope="module")
def settled() -> tuple[ViewSet, Settled]:
    ball = marked_ball(size=96)
    return ball.original, settle(ball.original, ball.plan, WANTED, settle_grain(ball.original, WANTED))


def grained(views: ViewSet, grain: Grain) -> GaussianModel:
    return roughen(views.model, grain, public_signs(6 * len(views.model)).astype(np.float32).reshape(-1, 6))


def test_grain_and_tint_together_keep_the_budget(settled: tuple[ViewSet, Settled]) -> None:
    views, found = settled
    layout = found.plan.layout
    rough = grained(views, found.grain)
    both = rough.with_(sh=add_dc(rough.sh, layout.displace(layout.amplitudes * public_signs(layout.chips))))
    assert 39.7 < measure(views, both).psnr_db < 41.0


def test_the_grain_takes_no_more_than_its_part() -> None:
    ball = marked_ball(size=96)
    coarse = replace(WANTED, plan=replace(WANTED.plan, grain_center=0.9, grain_scale=0.4))
    found = settle(ball.original, ball.plan, coarse, settle_grain(ball.original, coarse))
    assert 0.001 < found.grain.center < 0.9
    assert found.grain.scale == pytest.approx(found.grain.center * 0.4 / 0.9, rel=1e-3)
    alone = measure(ball.original, grained(ball.original, found.grain))
    allowed = Fidelity(
        WANTED.psnr_db + CONFIG.strength.grain_room_db, 1 - CONFIG.strength.grain_ssim_share * (1 - WANTED.ssim)
    )
    assert math.exp(-CONFIG.strength.close) - 0.02 < alone.room_to(allowed) < math.exp(CONFIG.strength.waste) + 0.02


@pytest.mark.parametrize("power", [1.0, 0.5, 0.35])
def test_what_the_grain_costs_is_measured_where_it_is_used(monkeypatch: pytest.MonkeyPatch, power: float) -> None:
    """Errors that grow more slowly than the grain: proportion alone would leave it too coarse."""
    monkeypatch.setattr(settling, "roughen", lambda model, grain, signs: grain)
    ball = marked_ball(size=64)
    better = {id(camera): 3.0 * number for number, camera in enumerate(reversed(ball.cameras))}  # the last is the worst

    def shows(views: ViewSet, grain: Grain, at_view: None, chosen: list[int]) -> list[Fidelity]:
        worst = 38.0 - 20 * power * math.log10(grain.center / 0.05)
        return [Fidelity(worst + better[id(views.cameras[k])], 1.0) for k in chosen]

    monkeypatch.setattr(settling, "measure_each", shows)
    asked = replace(WANTED, psnr_db=40.0 - CONFIG.strength.margin_db)
    found = settle_grain(ball.original, asked)
    grain, spent = found.grain, found.spent
    over = spent.psnr_db - 40.0 - CONFIG.strength.grain_room_db
    assert -20 * CONFIG.strength.close / math.log(10) - 0.01 < over < 20 * CONFIG.strength.waste / math.log(10)
    assert spent.psnr_db == pytest.approx(38.0 - 20 * power * math.log10(grain.center / 0.05))


def test_without_grain_the_tint_has_all() -> None:
    ball = marked_ball(size=96)
    found = settle(
        ball.original,
        ball.plan,
        WANTED,
        settle_grain(ball.original, WANTED, Variant(free_centers=False, free_sizes=False)),
    )
    assert not found.grain.there
    assert found.tint.psnr_db == pytest.approx(WANTED.psnr_db + CONFIG.strength.margin_db)


def test_strengths_know_nothing_of_the_copy(small_plant: GaussianModel) -> None:
    """All that two copies' records commit to is the same, but for which draw it is."""
    one, other = (embed(small_plant, bench_key(1), original_sha256="11" * 32, config=SMALL, copy=c) for c in "ab")
    assert one.report["grain"] == other.report["grain"]
    assert "strength" not in one.record.extra
    for name, array in one.record.plan_arrays.items():
        np.testing.assert_array_equal(array, other.record.plan_arrays[name])
    plans = [{**made.record.plan, "copies": {**made.record.plan["copies"], "draw": 0}} for made in (one, other)]
    assert plans[0] == plans[1]


def test_a_miss_lowers_both_layers_by_what_was_missed() -> None:
    ball = marked_ball(size=64)
    before = Settled(ball.plan, Grain(0.05, 0.02), Fidelity(40.0, 0.9))
    after = before.lowered(Fidelity(39.0, 0.99), Fidelity(40.0, 0.9))
    factor = 0.997 * 10 ** (-1 / 20)
    np.testing.assert_allclose(after.plan.layout.amplitudes, factor * ball.plan.layout.amplitudes, rtol=1e-5)
    assert after.grain.center == pytest.approx(0.05 * factor, rel=1e-5)
    by_ssim = before.lowered(Fidelity(41.0, 0.8), Fidelity(40.0, 0.9))
    assert by_ssim.grain.scale == pytest.approx(0.02 * 0.997 * 0.5**0.5, rel=1e-5)


def test_key_views_keep_the_asked_fidelity_whatever_the_chips(small_plant: GaussianModel) -> None:
    for copy in ("", "a", "b", "c"):
        made = embed(small_plant, bench_key(3), original_sha256="11" * 32, config=SMALL, copy=copy)
        assert made.report["psnr_worst_view"] >= 47.0
        assert made.report["ssim_worst_view"] >= 0.998
    assert CONFIG.strength.draws > 1


def test_where_no_strength_will_do_the_last_plan_is_the_one_embedded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fidelity out of reach: what comes back belongs together."""
    monkeypatch.setattr(marking, "measure", lambda *_: Fidelity(39.9, 0.95))
    ball = marked_ball(size=64)
    start = Settled(ball.plan, Grain(0.05, 0.02), Fidelity(40.0, 0.9))
    wanted = Fidelity(40.0, 0.9)
    pixels = np.full((len(ball.cameras), 1), 100.0)
    committed = Committed(bytes(32), ball.message, ball.cameras, None)
    made = make_owner_mark(ball.original, start, bench_key(1), committed, wanted, pixels, None)
    plan = committed.plan(ball.model, made.settled)
    amplitudes = made.settled.plan.layout.amplitudes
    np.testing.assert_array_equal(plan[1]["amplitudes"], amplitudes.astype(np.float32))
    np.testing.assert_allclose(np.abs(made.signed), amplitudes * made.drawn.tint.sizes)
    assert not made.fidelity.meets(wanted)


def test_a_copy_that_shows_too_much_is_drawn_anew_and_never_made_weaker(
    small_plant: GaussianModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def shows(*_: object) -> Fidelity:
        calls.append(1)  # the owner's layer first, then three draws
        return Fidelity(60.0 if len(calls) in (1, 4) else 40.0, 1.0)

    monkeypatch.setattr(marking, "measure", shows)
    made = embed(small_plant, bench_key(1), original_sha256="11" * 32, config=SMALL, copy="a")
    assert made.record.plan["copies"]["draw"] == 2
    monkeypatch.setattr(marking, "measure", lambda *_: Fidelity(60.0, 1.0))
    first = embed(small_plant, bench_key(1), original_sha256="11" * 32, config=SMALL, copy="a")
    np.testing.assert_array_equal(
        first.record.plan_arrays["copies/amplitudes"], made.record.plan_arrays["copies/amplitudes"]
    )
    assert (first.model.means != made.model.means).any()
