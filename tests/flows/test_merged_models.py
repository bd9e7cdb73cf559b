"""A model published in levels of detail still carries its mark: every bit, at 2^-128."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.flows.records.opened_record import open_record
from engine.flows.verify.search import Suspect, VerifyConfig, verify
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key
from engine.lab.sim.attacks import model_attack
from engine.model import GaussianModel
from engine.watermark.claim import Claim
from tests.parameters import few

MODEL_ROUTE = VerifyConfig(route="model")
DISHONEST = -38.6  # log10 of 2^-128


@pytest.fixture(scope="module")
def piece(plant: GaussianModel) -> MarkedScene:
    """30,000 Gaussians of the plant that hang together, marked with 32 bits."""
    original = model_attack("crop").apply(plant, 30_000 / len(plant), rng=1)
    key = bench_key(0)
    config = profile("fast", landmark_views=0, views=6, view_size=256)
    made = embed(original, key, original_sha256="00" * 32, bits=32, config=config)
    return MarkedScene("piece", original, made.model, open_record(made.record.to_bytes(key), key), made.report)


def claim_of(suspect: GaussianModel, scene: MarkedScene) -> Claim:
    return verify(Suspect(model=suspect), scene.opened, MODEL_ROUTE).claim


def attacked(scene: MarkedScene, *chain: tuple[str, float | str]) -> GaussianModel:
    """Merged as publishing tools do; the rest as the words say."""
    suspect = scene.marked
    for number, (name, strength) in enumerate(chain):
        reading = "as_code" if name == "merge" else "literal"
        suspect = model_attack(name).apply(suspect, strength, rng=number, reading=reading)
    return suspect


@pytest.mark.parametrize(
    ("attack", "share"), few([("merge", 0.05), ("lod", 0.25)], product(["merge", "lod"], [0.5, 0.25, 0.1, 0.05]))
)
def test_every_bit_at_every_level(piece: MarkedScene, attack: str, share: float) -> None:
    claim = claim_of(attacked(piece, (attack, share)), piece)
    assert claim.bit_accuracy == 1.0
    assert claim.log10_false_claim < DISHONEST
    assert any("mixture" in note for note in claim.notes)


@pytest.mark.parametrize(
    "chain",
    [
        [("merge", 0.5), ("crop", 0.25), ("similarity", 4.0)],
        pytest.param([("merge", 0.25), ("convert", "splat")], marks=pytest.mark.long),
        [("merge", 0.25), ("convert", "sog"), ("similarity", 4.0)],
        pytest.param([("merge", 0.1), ("similarity", 10.0), ("shuffle", 1.0)], marks=pytest.mark.long),
        pytest.param([("merge", 0.25), ("merge", 0.5)], marks=pytest.mark.long),
    ],
    ids=str,
)
def test_merged_and_more(piece: MarkedScene, chain: list[tuple[str, float | str]]) -> None:
    claim = claim_of(attacked(piece, *chain), piece)
    assert claim.bit_accuracy == 1.0
    assert claim.z > 25  # read as what it is: a mirror image of the pot gave 14
    assert not any("mirror" in note for note in claim.notes)


def test_merged_and_noisy_colours(piece: MarkedScene) -> None:
    thin = attacked(piece, ("merge", 0.25))
    noise = 0.1 * thin.sh[:, 0].std() * np.random.default_rng(0).standard_normal((len(thin), 3))
    claim = claim_of(thin.with_dc(thin.sh[:, 0] + noise), piece)
    assert claim.bit_accuracy == 1.0
    assert claim.log10_false_claim < DISHONEST


@pytest.mark.parametrize("share", [0.5, 0.1])
def test_an_unmarked_merged_model_never_claims(piece: MarkedScene, share: float) -> None:
    thin = model_attack("merge").apply(piece.original, share, reading="as_code")
    claim = claim_of(thin, piece)
    assert claim.verdict.value != "marked"
    assert abs(claim.z) < 5.0
    assert claim.derived_fraction is not None
    assert claim.derived_fraction > 0.85
