"""The paper's system as a profile: each of its stages runs, its own decoder reads every bit, and so does `verify`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.compress import recovery
from engine.compress.config import CONFIG
from engine.flows.embed.embedding import Embedding, embed
from engine.flows.embed.profiles import PROFILES, EmbedConfig, profile
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.flows.verify.search import VerifyConfig, verify_model
from engine.lab.evaluate.marked_scene import bench_key
from engine.model import GaussianModel
from engine.numerics.similarity import transform_model
from engine.watermark.claim import Verdict
from tests.watermark.ball import ball_model

pytestmark = pytest.mark.slow

BY_PAPER = VerifyConfig(route="model", decoder="paper")


def small(**changes: Any) -> EmbedConfig:
    """The paper's profile on few small views, with few steps and codes."""
    start = profile("paper", views=3, view_size=192, landmark_views=0)
    stages = {
        "quantize": replace(start.quantize, residual_codes=(128, 128)),
        "refine": replace(start.refine, steps=6, size=128),
        "prune": replace(start.prune, recover=False),
    }
    return replace(start, **stages | changes)


def mark(model: GaussianModel, config: EmbedConfig, bits: int = 32) -> tuple[Embedding, OpenedRecord]:
    key = bench_key(3)
    made = embed(model, key, original_sha256="33" * 32, bits=bits, config=config)
    return made, open_record(made.record.to_bytes(key), key)


@pytest.fixture(scope="module")
def model() -> GaussianModel:
    return ball_model(12_000, degree=1)


@pytest.fixture(scope="module")
def marked(model: GaussianModel) -> tuple[Embedding, OpenedRecord]:
    return mark(model, small())


def test_the_papers_decoder_reads_every_bit_and_verify_claims(marked: tuple[Embedding, OpenedRecord]) -> None:
    made, opened = marked
    claim = verify_model(made.model, opened, BY_PAPER).claim
    assert (claim.matching_bits, claim.bits, claim.verdict) == (32, 32, Verdict.MARKED)
    assert min(claim.bit_reliability) > 0.7, "each bit by most of its votes"
    ours = verify_model(made.model, opened).claim
    assert (ours.matching_bits, ours.verdict) == (32, Verdict.MARKED)
    assert ours.log10_false_claim < -38.5


def test_a_moved_copy_reads_over_all_coefficients(marked: tuple[Embedding, OpenedRecord]) -> None:
    """The suspect's harmonics are turned back before they are compared."""
    made, opened = marked
    assert opened.layout.width == 12
    turn = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    plain = verify_model(made.model, opened, BY_PAPER)
    moved = verify_model(transform_model(made.model, 2.0, turn, [1.0, 2.0, 3.0]), opened, BY_PAPER)
    assert moved.claim.matching_bits == 32
    np.testing.assert_allclose(moved.evidence.y, plain.evidence.y, atol=2e-3)
    bare = made.model.with_(sh=made.model.sh[:, :1])
    assert verify_model(bare, opened, BY_PAPER).claim.matching_bits == 32


def test_every_stage_has_run(model: GaussianModel, marked: tuple[Embedding, OpenedRecord]) -> None:
    made, opened = marked
    report = made.report
    cut = 1.0 - (report["gaussians_out"] - report["densified"]) / report["gaussians_in"]
    assert 0.6 < cut < 0.72, "the paper: 60 to 70 %"
    assert report["densified"] == round(0.05 * (len(made.model) - report["densified"]))
    assert len(opened.layout.codes) == 3
    assert not opened.grain.there
    assert opened.settings["paper"]["whole_sh"] is True
    # The model consists of its code vectors: what all members of the same three share.
    codes = np.stack(opened.layout.labels, axis=1)
    _, first, which = np.unique(codes, axis=0, return_index=True, return_inverse=True)
    shared = made.model.sh[first][which.reshape(-1)]
    np.testing.assert_allclose(made.model.sh, shared, atol=1e-5)
    moved = made.model.sh[:, 1:] - opened.reference.sh[:, 1:]
    assert np.abs(moved).max() > 5e-3, "the mark is in the harmonics, too"


@pytest.mark.long
def test_what_is_pruned_is_fitted_before_it_is_marked(
    model: GaussianModel, marked: tuple[Embedding, OpenedRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recovery, "_CONFIG", replace(CONFIG.recovery, least_work=1e9, work_each=0.0))
    made, _ = mark(model, small(prune=profile("paper").prune))
    before = marked[0].report
    assert made.report["psnr_total_worst_view"] > before["psnr_total_worst_view"] + 1.0
    assert made.report["gaussians_out"] == before["gaussians_out"]


def test_an_unmarked_model_is_not_claimed(marked: tuple[Embedding, OpenedRecord]) -> None:
    _, opened = marked
    claim = verify_model(opened.reference, opened).claim
    assert claim.verdict is not Verdict.MARKED
    assert claim.z < 5.0


def test_the_same_key_gives_the_same_bytes(model: GaussianModel, marked: tuple[Embedding, OpenedRecord]) -> None:
    again, _ = mark(model, small())
    key = bench_key(3)
    assert again.record.to_bytes(key) == marked[0].record.to_bytes(key)
    np.testing.assert_array_equal(again.model.sh, marked[0].model.sh)


@pytest.mark.parametrize(
    "off",
    [
        {"tau_base": 0.0},
        {"densify": 0.0},
        {"frequency": False},
        {"tau_unc": 0.0},
        {"public_codes": False},
        {"whole_sh": False},
        {"codes": 0.0},
    ],
    ids=lambda off: next(iter(off)),
)
def test_each_stage_does_something_and_can_be_left_out(
    off: dict[str, Any], model: GaussianModel, marked: tuple[Embedding, OpenedRecord]
) -> None:
    config = small()
    made, opened = mark(model, replace(config, paper=replace(config.paper, **off)))
    assert verify_model(made.model, opened, BY_PAPER).claim.matching_bits == 32
    same = made.model.sh.shape == marked[0].model.sh.shape and np.array_equal(made.model.sh, marked[0].model.sh)
    assert not same


def test_the_presets_are_the_papers() -> None:
    text, appendix = PROFILES["paper"], PROFILES["paper-appendix"]
    weights = [(c.refine.lambda_msg, c.refine.lambda_rec, c.refine.lambda_wavelet) for c in (text, appendix)]
    assert weights == [(0.4, 1.0, 0.3), (0.2, 0.5, 0.05)]
    assert (text.paper.tau_unc, appendix.paper.tau_unc) == (1.0, 1.1)
    for config in (text, appendix):
        assert (config.prune.rank, config.prune.gamma, config.quantize.decay, config.quantize.lambda_freq) == (
            "paper",
            0.2,
            0.8,
            0.1,
        )
        assert config.plan.stages == 1 + len(config.quantize.residual_codes)
        assert not config.keeps_rows


def test_records_of_our_profiles_say_nothing_of_the_paper() -> None:
    for name, config in PROFILES.items():
        assert ("paper" in config.to_json()) == name.startswith("paper")
