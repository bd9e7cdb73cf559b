from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.errors import InputError, WrongKeyError
from engine.flows.embed.embedding import embed
from engine.flows.embed.layer_strengths import add_dc
from engine.flows.embed.profiles import profile
from engine.flows.records.opened_record import open_record
from engine.flows.verify.search import VerifyConfig, verify_images, verify_model
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.bench.truth import forge
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key
from engine.lab.evaluate.marked_subjects import picture_of
from engine.lab.evaluate.null.null_rates import LOG10_THRESHOLDS, count_wrong_keys
from engine.lab.sim.adversaries.retraining import fine_tune
from engine.lab.sim.attacks import image_attack, model_attack
from engine.model import GaussianModel
from engine.raster import render
from engine.watermark.claim import LINEAR
from engine.watermark.grain import roughen
from engine.watermark.rates import DRAWS, OWNER, Attested, Condition, ConditionKind
from tests.parameters import few

pytestmark = pytest.mark.slow

MODEL_ATTACKS = [
    ("similarity", 10.0),
    pytest.param("shuffle", 1.0, marks=pytest.mark.long),
    pytest.param("clone", 0.5, marks=pytest.mark.long),
    ("prune_random", 0.9),
    ("crop", 0.1),
    ("noise_all", 0.1),
    ("convert", "splat"),
    ("convert", "spz"),
    pytest.param("merge_into", 1.0, marks=pytest.mark.long),
]


@pytest.mark.parametrize(("name", "strength"), MODEL_ATTACKS, ids=lambda value: str(value))
def test_model_attacks_leave_every_bit(scene: MarkedScene, name: str, strength: float | str) -> None:
    suspect = model_attack(name).apply(scene.marked, strength, rng=3)
    claim = verify_model(suspect, scene.opened).claim
    assert claim.bit_accuracy == 1.0
    assert claim.verdict.value == "marked"
    assert claim.log10_false_claim < -100
    assert claim.meets_dishonest_claimant_rate


def test_unmarked_and_foreign_models_never_claim(scene: MarkedScene) -> None:
    claim = verify_model(scene.original, scene.opened).claim
    assert claim.verdict.value == "not_marked"
    assert claim.derivation.derived
    assert claim.derivation.exactness is not None
    assert claim.derivation.exactness < 0.01
    assert claim.change is not None
    assert claim.change < 0.1
    rng = np.random.default_rng(0)
    foreign = scene.marked.with_(
        means=rng.uniform(-1, 1, scene.marked.means.shape),
        log_scales=rng.uniform(-7, -3, scene.marked.means.shape),
        opacity_logits=rng.standard_normal(len(scene.marked)),
        sh=rng.standard_normal(scene.marked.sh.shape),
    )
    claim = verify_model(foreign, scene.opened, VerifyConfig(route="model")).claim
    assert claim.verdict.value == "inconclusive"
    assert not claim.derivation.derived
    assert "alignments were weighed" in claim.notes[0]


def test_wrong_keys_stay_below_the_stated_bound(scene: MarkedScene) -> None:
    camera = scene.opened.cameras[0]
    of_picture = verify_images([picture_of(scene.marked, camera)], scene.opened, cameras=[camera])
    for result in (verify_model(scene.marked, scene.opened, VerifyConfig(route="model")), of_picture):
        row = count_wrong_keys(result.evidence.y, result.evidence.weights, 20_000, result.claim.route)
        assert row["hits"][-1] == 0, "claims at 1e-9"
        for log10, hits in zip(LOG10_THRESHOLDS, row["hits"], strict=True):
            assert hits <= 20_000 * 10.0**log10 + 5 * np.sqrt(20_000 * 10.0**log10)


def test_another_key_cannot_open_the_record(small_plant: object) -> None:
    from engine.flows.embed.embedding import embed

    key, other = bench_key(1), bench_key(2)
    result = embed(
        small_plant,
        key,
        original_sha256="22" * 32,  # type: ignore[arg-type]
        config=profile("fast", landmark_views=0, views=3, view_size=128),
    )
    with pytest.raises(WrongKeyError):
        open_record(result.record.to_bytes(key), other)


def test_a_forged_original_makes_no_claim(scene: MarkedScene) -> None:
    row = forge(scene, profile("fast", landmark_views=0, views=3, view_size=256))
    assert row["verdict"] != "marked"
    assert row["log10_false_claim"] > -6


@pytest.mark.parametrize(
    ("name", "strength"),
    few(
        [("jpeg", 10), ("crop_image", 0.4), ("rotate_image", 30.0), ("brightness", 1.5)],
        [
            ("jpeg", 10),
            ("noise_image", 0.1),
            ("blur", 1.0),
            ("crop_image", 0.4),
            ("scale_image", 0.75),
            ("rotate_image", 30.0),
            ("brightness", 0.5),
            ("brightness", 1.5),
        ],
    ),
)
def test_one_attacked_picture_is_enough(scene: MarkedScene, name: str, strength: float) -> None:
    camera = scene.opened.cameras[1]
    picture = image_attack(name).apply(to_8_bit(render(scene.marked, camera)), strength, rng=2)
    claim = verify_images([to_8_bit(picture)], scene.opened, cameras=[camera]).claim
    assert claim.verdict.value == "marked"
    assert claim.bit_accuracy >= 0.96


@pytest.mark.long
def test_several_pictures_say_more_than_one(scene: MarkedScene) -> None:
    cameras = scene.opened.cameras[:3]
    pictures = [image_attack("noise_image").apply(render(scene.marked, c), 0.2, rng=k) for k, c in enumerate(cameras)]
    each = [verify_images([p], scene.opened, cameras=[c]).claim.z for p, c in zip(pictures, cameras, strict=True)]
    together = verify_images(pictures, scene.opened, cameras=cameras).claim.z
    assert together > 1.2 * max(each)


def test_unmarked_picture_makes_no_claim(scene: MarkedScene) -> None:
    camera = scene.opened.cameras[0]
    claim = verify_images([to_8_bit(render(scene.original, camera))], scene.opened, cameras=[camera]).claim
    assert claim.verdict.value != "marked"


def test_render_route_sees_the_mark_as_a_black_box(scene: MarkedScene) -> None:
    moved = model_attack("similarity").apply(scene.marked, 3.0, rng=1)
    claim = verify_model(moved, scene.opened, VerifyConfig(route="render")).claim
    assert claim.route == "render"
    assert (claim.verdict.value, claim.bit_accuracy) == ("marked", 1.0)
    retagged = verify_model(replace(moved, antialiased=True), scene.opened, VerifyConfig(route="render")).claim
    assert retagged.z == claim.z  # a suspect's word on how to draw it is nobody's evidence


def test_paper_decoder_reads_the_unharmed_model_and_only_the_bits_differ(scene: MarkedScene) -> None:
    paper = verify_model(scene.marked, scene.opened, VerifyConfig(decoder="paper")).claim
    ours = verify_model(scene.marked, scene.opened).claim
    assert paper.bit_accuracy == 1.0
    assert paper.z == ours.z


@pytest.mark.long
def test_fine_tuning_on_clean_images_keeps_every_bit(scene: MarkedScene) -> None:
    cameras = [c.resized(128, 128) for c in scene.opened.cameras[:3]]
    clean = [np.clip(render(scene.original, c), 0, 1) for c in cameras]
    tuned = fine_tune(scene.marked, cameras, clean, epochs=15)
    assert np.abs(tuned.sh - scene.marked.sh).max() > 0.01
    claim = verify_model(tuned, scene.opened).claim
    assert (claim.bit_accuracy, claim.verdict.value) == (1.0, "marked")


def test_tries_of_the_whole_question_count_in_every_bound(scene: MarkedScene) -> None:
    alone = verify_model(scene.marked, scene.opened).claim
    among = verify_model(scene.marked, scene.opened, VerifyConfig(tries=200)).claim
    assert (alone.tries, among.tries) == (9 * DRAWS, 200 * DRAWS)
    assert among.log10_false_claim == pytest.approx(alone.log10_false_claim + np.log10(200 / 9))
    assert among.z_threshold > alone.z_threshold
    with pytest.raises(InputError, match="at least one"):
        VerifyConfig(tries=0)


def test_bad_requests_are_refused(scene: MarkedScene) -> None:
    picture = np.zeros((64, 64, 3), np.float32)
    with pytest.raises(InputError, match="route"):
        VerifyConfig(route="oracle")
    with pytest.raises(InputError, match="rate"):
        VerifyConfig(false_claim_rate=2.0)
    with pytest.raises(InputError, match="2 pictures but 1"):
        verify_images([picture] * 2, scene.opened, cameras=scene.opened.cameras[:1])
    with pytest.raises(InputError, match="landmarks"):
        verify_images([picture], scene.opened)
    with pytest.raises(InputError, match="empty"):
        verify_model(scene.marked.take(np.arange(0)), scene.opened)


def test_chips_of_the_record_follow_from_its_contents(scene: MarkedScene) -> None:
    """An opened record with one chip flipped explains the mark a little worse: the chips really are used."""
    spreading = scene.opened.spreading
    flipped = spreading.chips.copy()
    flipped[:2000] *= -1
    altered = replace(scene.opened, spreading=replace(spreading, chips=flipped))
    less, more = (verify_model(scene.marked, opened).claim for opened in (altered, scene.opened))
    assert less.layers is not None
    assert more.layers is not None
    assert less.layers["tint"] < more.layers["tint"] - 5
    assert less.layers["grain"] == more.layers["grain"]
    regrained = replace(scene.opened, grain_key=bytes(32))
    assert abs(verify_model(scene.marked, regrained).claim.layers["grain"]) < 5


def test_where_nothing_was_found_nothing_is_said(scene: MarkedScene) -> None:
    """Whether few Gaussians or many: a thief hides his model from the search in ways that no search undoes."""
    rng = np.random.default_rng(0)
    for count in (2, 200):
        few = scene.marked.take(np.arange(count)).with_(means=rng.normal(size=(count, 3)).astype(np.float32))
        claim = verify_model(few, scene.opened, VerifyConfig(route="model")).claim
        assert claim.derived_fraction == 0.0
        assert claim.verdict.value == "inconclusive"


def test_derivation_says_how_much_how_exactly_and_where(scene: MarkedScene) -> None:
    kept = np.flatnonzero(scene.marked.means[:, 1] > np.quantile(scene.marked.means[:, 1], 0.7))
    piece = scene.marked.take(kept)
    moved = model_attack("similarity").apply(piece, 4.0, rng=1)
    cases = (piece, 1.0, 0.0, 0.2), (moved, 1.0, 0.0, 0.2), (jittered(piece), 0.8, 0.2, 0.6)
    for suspect, share, least, most in cases:
        found = verify_model(suspect, scene.opened, VerifyConfig(route="model")).claim.derivation
        assert found.derived
        assert found.gaussians is not None
        assert found.gaussians > 0.99 * share * len(piece)
        assert found.share is not None
        assert 0.995 * share * len(kept) < found.share * len(scene.marked) < len(kept) + 1
        assert found.exactness is not None
        assert least <= found.exactness <= most
        assert found.where is not None
        assert found.where[0][1] == pytest.approx(np.quantile(piece.means[:, 1], 0.01), abs=5e-3)


@pytest.mark.parametrize("wrong", [0.05, 0.15, 0.3])
def test_a_mark_that_was_taken_out_by_a_guess_is_not_called_absent(scene: MarkedScene, wrong: float) -> None:
    """He guesses most signs, and all sizes, and subtracts as much as takes all of Z; where he guessed wrong he leaves
    his trace."""
    opened, tint = scene.opened, scene.opened.layout.chips
    values = opened.spreading_of(tint + opened.grain.chips(len(opened.reference))).values(opened.message)
    guess = np.where(np.random.default_rng(1).random(len(values)) < wrong, -1.0, 1.0) * values / (1 - 2 * wrong)
    step = opened.layout.displace(opened.strength * opened.layout.amplitudes * guess[:tint])
    colorless = scene.marked.with_(sh=add_dc(scene.marked.sh, -step))
    cleaned = roughen(colorless, opened.grain, -guess[tint:].reshape(-1, 6).astype(np.float32))
    claim = verify_model(cleaned, opened, VerifyConfig(route="model")).claim
    assert claim.z < 7
    assert claim.verdict.value == "inconclusive"
    assert claim.derivation.derived
    assert claim.derived_fraction == pytest.approx(1.0, abs=0.03)


def jittered(model: GaussianModel) -> GaussianModel:
    """Centres moved by a fifth of each Gaussian's size along each axis."""
    gap = 0.2 * np.exp(model.log_scales.mean(axis=1))[:, None] * np.random.default_rng(2).normal(size=(len(model), 3))
    return model.with_(means=(model.means + gap).astype(np.float32))


def test_the_rate_is_not_the_claimant_s_choice(scene: MarkedScene) -> None:
    """What nobody attests needs 2^-128, whatever is asked for; a weak picture then says what it would take."""
    plain = replace(scene.opened, attested=None)
    lax = VerifyConfig(false_claim_rate=0.5)
    assert verify_model(scene.marked, scene.opened, lax).claim.false_claim_rate == 1e-9
    claim = verify_model(scene.marked, plain, lax).claim
    assert (claim.verdict.value, claim.false_claim_rate, claim.rate_basis) == ("marked", 2.0**-128, "self_declared")
    camera = scene.opened.cameras[1]
    shot = image_attack("noise_image").apply(render(scene.marked, camera), 0.2, rng=3)
    weak = [verify_images([shot], opened, cameras=[camera]).claim for opened in (scene.opened, plain)]
    assert weak[0].z == weak[1].z
    assert 8.6 < weak[0].z < 13.3
    assert [claim.verdict.value for claim in weak] == ["marked", "inconclusive"]
    assert [claim.would_be_claim_if_attested for claim in weak] == [False, True]
    stamped = replace(scene.opened, attested=Attested("2026-03-01T00:00:00+00:00", "a time-stamping service"))
    dated = verify_images([shot], stamped, VerifyConfig(suspect_seen="2026-03-02"), cameras=[camera]).claim
    assert (dated.verdict.value, dated.rate_basis) == ("inconclusive", "dated")
    assert dated.conditions == (Condition(ConditionKind.SUSPECT_SINCE, "2026-03-02", OWNER),)


@pytest.mark.long
def test_renders_say_as_much_however_small_the_key_views_were(small_plant: GaussianModel) -> None:
    found = {}
    for size in (128, 512):
        config = profile("fast", landmark_views=0, views=3, view_size=size, psnr_db=44.0, ssim=0.99)
        made = embed(small_plant, bench_key(1), original_sha256="11" * 32, bits=16, config=config)
        opened = open_record(made.record.to_bytes(bench_key(1)), bench_key(1))
        found[size] = verify_model(made.model, opened, VerifyConfig(route="render")).claim.z
    assert found[128] > 0.85 * found[512]


def test_a_picture_whose_camera_was_given_shows_no_derivation_by_itself(scene: MarkedScene) -> None:
    """Anything bright in the same places can be laid over a view that somebody names."""
    camera = scene.opened.cameras[0]
    claim = verify_images([to_8_bit(render(scene.original, camera))], scene.opened, cameras=[camera]).claim
    assert not claim.derivation.derived
    assert claim.verdict.value == "inconclusive"


def pushed(scene: MarkedScene, share: float, steps: float, *, marked: bool) -> GaussianModel:
    """The original, but for a share of its centers and sizes, which a thief moved far, up or down by a coin."""
    rng, opened = np.random.default_rng(6), scene.opened
    far = rng.random((len(scene.original), 6)) < share
    moves = rng.choice([-steps, steps], far.shape)
    if marked:  # where he pushed, the mark is under it still
        tint = opened.layout.chips
        moves += opened.spreading_of(tint + far.size).values(opened.message)[tint:].reshape(far.shape)
    return roughen(scene.original, opened.grain, np.where(far, moves, 0.0).astype(np.float32))


def test_what_was_pushed_far_is_read_in_proportion(scene: MarkedScene) -> None:
    """Weights that fall with a displacement's size would let a push take the evidence away."""
    claim = verify_model(pushed(scene, 0.25, 12.0, marked=True), scene.opened, VerifyConfig(route="model")).claim
    assert claim.layers is not None
    assert abs(claim.layers["both"]) < 5
    assert claim.verdict.value == "marked"
    assert claim.z == pytest.approx(max(z for name, z in claim.layers.items() if name.endswith(LINEAR)), rel=1e-6)


def test_one_layer_near_the_original_does_not_acquit_the_other(scene: MarkedScene) -> None:
    claim = verify_model(pushed(scene, 0.25, 12.0, marked=False), scene.opened, VerifyConfig(route="model")).claim
    assert abs(claim.z) < 5
    assert claim.verdict.value == "inconclusive"
    assert claim.change is not None
    assert claim.change > 0.25
