"""Fits on a GPU: recovery and refinement through gsplat reach what the CPU reaches, and records say where they ran.

No GPU is needed: behind gsplat's signature stand our own passes (`tests.gsplat_stand_in`). What gsplat itself draws is
compared in `tests/raster/test_cuda.py`, where there is a GPU.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.compress import recovery
from engine.compress.config import CONFIG
from engine.compress.pruning import PruneConfig
from engine.compress.recovery import Recovery
from engine.errors import InputError
from engine.flows.embed.embedding import Embedding, embed
from engine.flows.embed.profiles import EmbedConfig, RefineConfig, compose
from engine.flows.embed.refinement import Tint, refine
from engine.flows.embed.terms import MarkTerms
from engine.flows.records.opened_record import open_record
from engine.flows.verify.search import verify_model
from engine.lab.evaluate.marked_scene import bench_key
from engine.model import GaussianModel
from engine.usecases.mark import device_note
from tests.flows.test_recovery import BUDGET, SIDE, dense, target_of, unseen
from tests.gsplat_stand_in import StandIn, install
from tests.watermark.ball import marked_ball

KEY = bench_key(1)
PRUNED = EmbedConfig(views=3, view_size=SIDE, landmark_views=0, psnr_db=40.0, prune=PruneConfig(budget_db=BUDGET))
ON_GPU = replace(PRUNED, device="cuda")


@pytest.fixture(autouse=True)
def gsplat(monkeypatch: pytest.MonkeyPatch) -> StandIn:
    """And as little work as shows it."""
    small = replace(CONFIG.recovery, least_work=1e8, work_each=0.0, round=(20, 6, 4), least_gain_db=0.05)
    monkeypatch.setattr(recovery, "_CONFIG", small)
    return install(monkeypatch)


def marked(model: GaussianModel, config: EmbedConfig, copy: str = "a", **options: object) -> Embedding:
    return embed(model, KEY, original_sha256="22" * 32, config=config, copy=copy, bits=16, **options)


def test_recovery_gains_as_much_on_either(gsplat: StandIn) -> None:
    whole = dense(1500, 1)
    thin, target, measure = whole.take(np.arange(0, len(whole), 2)), target_of(whole, 4), unseen(whole)
    on_cpu = Recovery(thin, target).round()
    assert not gsplat.calls
    on_gpu = Recovery(thin, replace(target, device="cuda")).round()
    assert len(gsplat.calls) == 30
    assert measure(on_gpu) == pytest.approx(measure(on_cpu), abs=0.1)
    assert measure(on_gpu) > measure(thin) + 1.0


def test_refinement_moves_the_mark_as_far_on_either(gsplat: StandIn) -> None:
    ball = marked_ball(count=300, size=48)
    tint = Tint(ball.displacement, ball.plan.layout, ball.signed, ball.spreading.bit_of, 16)
    given = (ball.model, tint, ball.cameras[:2], np.ones(300), RefineConfig(steps=4, size=48), lambda _: None)
    on_cpu, on_gpu = refine(*given), refine(*given, device="cuda")
    assert len(gsplat.calls) == 2 + 4 * 4, "each view once; a step draws, pulls, and each of that backward"
    moved = np.linalg.norm(on_cpu - ball.displacement)
    assert moved > 0.0
    assert np.linalg.norm(on_gpu - on_cpu) < 0.05 * moved


def test_a_record_says_that_a_gpu_fitted_and_no_copy_is_made_from_it_alone(gsplat: StandIn) -> None:
    """A second fit would be another model, with another watermark of the same owner."""
    whole = dense(1500)
    made = marked(whole, ON_GPU)
    assert gsplat.calls
    assert made.report.device == made.record.extra["settings"]["device"] == "cuda"
    assert "all copies in one command" in device_note(MarkTerms(config=ON_GPU), made)[0]
    assert verify_model(made.model, open_record(made.record.to_bytes(KEY), KEY)).claim.matching_bits == 16
    for config in (PRUNED, ON_GPU, compose("auto", budget_db=BUDGET)):
        with pytest.raises(InputError, match="copy 'a' and a further one"):
            marked(whole, config, "b", earlier=made.record)
    by_cpu = marked(whole, PRUNED)
    assert "device" not in by_cpu.record.extra["settings"]
    assert len(made.model) == pytest.approx(len(by_cpu.model), rel=0.05)
    assert made.report["psnr_pruned_worst_view"] == pytest.approx(by_cpu.report["psnr_pruned_worst_view"], abs=0.5)
    with pytest.raises(InputError, match="copy 'a' and a further one"):
        marked(whole, ON_GPU, "b", earlier=by_cpu.record)
    later = marked(whole, PRUNED, "b", earlier=by_cpu.record)
    assert later.record.header.reference_digest == by_cpu.record.header.reference_digest


def test_where_a_gpu_has_nothing_to_fit_the_bytes_are_the_cpus(gsplat: StandIn) -> None:
    whole = dense(900)
    kept = replace(PRUNED, prune=PruneConfig())
    one, other = marked(whole, kept), marked(whole, replace(kept, device="cuda"))
    assert not gsplat.calls
    assert one.record.to_bytes(KEY) == other.record.to_bytes(KEY)
    assert other.report.device == "cpu"
    assert "the GPU was not used" in device_note(MarkTerms(config=replace(kept, device="cuda")), other)[0]
    assert device_note(MarkTerms(config=kept), one) == device_note(MarkTerms(), one) == []


def test_what_gsplat_would_draw_otherwise_is_left_to_the_cpu(gsplat: StandIn) -> None:
    whole = replace(dense(900), antialiased=True)
    made = marked(whole, replace(ON_GPU, prune=PruneConfig(budget_db=30.0)))
    assert not gsplat.calls
    assert made.report.device == "cpu"


def test_a_gpu_that_is_not_there_is_missed_before_any_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    with pytest.raises(InputError, match="torch finds none"):
        marked(dense(900), ON_GPU)
    for wanted in ({"device": "cuda"}, {"knobs": ["device=cuda"]}):
        with pytest.raises(InputError, match="torch finds none"):
            compose("auto", **wanted)
    assert compose("fast", device="auto") == compose("fast", knobs=["device=cpu"]) == compose("fast")
    with pytest.raises(InputError, match="auto, cpu, cuda, got 'gpu'"):
        EmbedConfig(device="gpu")
