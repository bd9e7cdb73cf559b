from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.compress.pruning import PruneConfig
from engine.errors import CapacityError, InputError
from engine.flows.embed import landmark_bank
from engine.flows.embed.embedding import Embedding, embed, embed_copies
from engine.flows.embed.profiles import RefineConfig, profile
from engine.flows.records.opened_record import landmarks_in, open_record
from engine.flows.verify.search import VerifyConfig, verify_model
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key
from engine.model import SH_C0, Camera, GaussianModel
from engine.numerics.image_metrics import psnr, ssim
from engine.pictures.landmarks import rendered_landmarks as landmark_making
from engine.pictures.landmarks.config import CONFIG as LANDMARKS
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.raster import render
from engine.records.record import Record
from engine.watermark.grain import units
from engine.watermark.messages import message_hex, message_signs
from engine.watermark.planning import PlanConfig
from engine.watermark.secret_cells import find_masses

pytestmark = pytest.mark.slow

DIGEST = "11" * 32


def quick(model: GaussianModel, **changes: object) -> Embedding:
    options = {"landmark_views": 0, "views": 3, "view_size": 256} | changes
    bits = options.pop("bits", 32)
    message = options.pop("message", None)
    copy = options.pop("copy", "")
    earlier = options.pop("earlier", None)
    return embed(
        model,
        bench_key(1),
        original_sha256=DIGEST,
        bits=bits,
        message=message,
        copy=copy,
        earlier=earlier,
        config=profile("fast", **options),
    )


def test_fidelity_is_kept_in_the_key_views(whole_scene: MarkedScene) -> None:
    scene = whole_scene
    worst_psnr, worst_ssim = np.inf, 1.0
    for camera in scene.opened.cameras:
        plain, marked = render(scene.original, camera), render(scene.marked, camera)
        worst_psnr, worst_ssim = min(worst_psnr, psnr(plain, marked)), min(worst_ssim, ssim(plain, marked))
    assert worst_psnr == pytest.approx(scene.report["psnr_worst_view"], abs=0.02)
    assert 47.0 <= worst_psnr < 47.3 or worst_ssim < 0.9984  # both layers' losses were measured apart
    assert worst_ssim >= 0.998


def test_fidelity_changes_dc_and_by_a_grain_centres_and_sizes(scene: MarkedScene) -> None:
    for name in ("quats", "opacity_logits"):
        np.testing.assert_array_equal(getattr(scene.marked, name), getattr(scene.original, name))
    grain = scene.opened.grain
    step = np.abs(scene.marked.log_scales - scene.original.log_scales)
    assert np.sqrt(np.mean(step**2)) == pytest.approx(grain.scale, rel=0.02)
    assert 0.47 * grain.scale < step.min() < step.max() < 1.45 * grain.scale
    along = np.linalg.norm(scene.marked.means - scene.original.means, axis=1)
    reach = grain.center * np.linalg.norm(units(scene.original.log_scales), axis=1)
    assert np.sqrt(np.mean((along / reach) ** 2)) == pytest.approx(1.0, rel=0.1)
    assert (along < 1.46 * reach + 1e-6).all()
    still = find_masses(scene.original.sh[:, 0], PlanConfig().mass_share)
    moved = (scene.marked.sh[:, 0] != scene.original.sh[:, 0]).any(axis=1)
    assert not moved[still].any()
    assert moved[~still].mean() > 0.99


def test_same_input_key_and_config_give_the_same_bytes(small_plant: GaussianModel) -> None:
    first, second = quick(small_plant), quick(small_plant)
    np.testing.assert_array_equal(first.model.sh, second.model.sh)
    key = bench_key(1)
    assert first.record.to_bytes(key) == second.record.to_bytes(key)


def test_a_later_copy_takes_the_landmarks_of_an_earlier_ones_record(
    small_plant: GaussianModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    def record(copy: str, views: int, earlier: Record | None = None) -> tuple[bytes, int]:
        made = quick(small_plant, copy=copy, landmark_views=views, earlier=earlier)
        return made.record.to_bytes(bench_key(1)), drawn.pop() if drawn else 0

    drawn: list[int] = []
    make = landmark_bank.make_landmarks

    def counted(model: GaussianModel, cameras: list[Camera], *rest: Any) -> Landmarks:
        drawn.append(len(cameras))
        return make(model, cameras, *rest)

    monkeypatch.setattr(landmark_bank, "make_landmarks", counted)
    first, views = record("a", 3)
    assert views == 3
    opened = Record.from_bytes(first, bench_key(1))
    again, views = record("b", 3, opened)
    assert views == 0
    assert (again, 3) == record("b", 3)
    half = quick(small_plant.take(np.arange(0, len(small_plant), 2)), landmark_views=3, earlier=opened)
    assert drawn == [3]  # of another model
    assert half.bank is not None


def test_copies_share_a_bank_whatever_made_it(small_plant: GaussianModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """The layer that they share follows from it: another bank would be another layer."""
    new = quick(small_plant, copy="a", landmark_views=2).record
    with monkeypatch.context() as before:
        before.setattr(landmark_making, "CONFIG", replace(LANDMARKS, detected=20))
        old = quick(small_plant, copy="a", landmark_views=2).record
    banks = [landmarks_in(record.plan_arrays) for record in (old, new)]
    assert [len(bank) <= 40 for bank in banks if bank is not None] == [True, False]
    again = quick(small_plant, copy="b", landmark_views=2, earlier=old).record
    shared = [open_record(record.to_bytes(bench_key(1)), bench_key(1)) for record in (old, again)]
    np.testing.assert_array_equal(shared[0].spreading.chips, shared[1].spreading.chips)


@pytest.mark.parametrize("change", [{"psnr_db": 44.0}, {"copy": ""}, {"landmark_views": 3}, {"message": -1}])
def test_a_second_watermark_on_one_model_is_refused(small_plant: GaussianModel, change: dict[str, Any]) -> None:
    """Whoever has files of both could tell them apart from their difference."""
    first = quick(small_plant, copy="a", landmark_views=2)
    if "message" in change:
        change = {"message": -message_signs(first.report["message"])}
    with pytest.raises(InputError, match="give each other away"):
        quick(small_plant, **{"copy": "b", "landmark_views": 2, "earlier": first.record, **change})


@pytest.mark.parametrize("bits", [16, 48, 128])
def test_every_length_reads_back(small_plant: GaussianModel, bits: int) -> None:
    result = quick(small_plant, bits=bits, psnr_db=42.0, ssim=0.98)
    opened = open_record(result.record.to_bytes(bench_key(1)), bench_key(1))
    claim = verify_model(result.model, opened).claim
    assert claim.bit_accuracy == 1.0
    assert claim.message == result.report["message"]


def test_a_given_message_is_carried(small_plant: GaussianModel) -> None:
    result = quick(small_plant, message=message_signs("c0ffee11"))
    assert result.report["message"] == "c0ffee11"
    opened = open_record(result.record.to_bytes(bench_key(1)), bench_key(1))
    assert message_hex(opened.message) == "c0ffee11"
    assert verify_model(result.model, opened).claim.message == "c0ffee11"


def test_too_long_a_message_is_refused_with_the_capacity(plant: GaussianModel) -> None:
    tiny = plant.take(np.arange(0, len(plant), 400))
    with pytest.raises(CapacityError) as caught:
        quick(tiny, bits=256)
    assert 0 <= caught.value.capacity < 256
    with pytest.raises(InputError, match="at least 64"):
        quick(plant.take(np.arange(10)))


@pytest.mark.parametrize("budget", [38.0, 30.0])
def test_pruning_meets_its_budget(plant: GaussianModel, budget: float) -> None:
    result = quick(plant, prune=PruneConfig(budget_db=budget, recover=False))
    report = result.report
    assert abs(report["psnr_pruned_worst_view"] - budget) <= 0.3
    assert report["gaussians_out"] < 0.85 * report["gaussians_in"]
    opened = open_record(result.record.to_bytes(bench_key(1)), bench_key(1))
    assert verify_model(result.model, opened).claim.bit_accuracy == 1.0


@pytest.mark.long
def test_tighter_budget_keeps_more(plant: GaussianModel) -> None:
    counts = [len(quick(plant, prune=PruneConfig(budget_db=b, recover=False)).model) for b in (42.0, 32.0)]
    assert counts[0] > 1.1 * counts[1]


def test_compact_is_the_sum_of_code_vectors_within_its_budget(small_plant: GaussianModel) -> None:
    result = quick(small_plant, output="compact")
    assert result.report["psnr_total_worst_view"] >= 40.0
    opened = open_record(result.record.to_bytes(bench_key(1)), bench_key(1))
    assert len(np.unique(opened.reference.sh[:, 0], axis=0)) < len(small_plant)
    claim = verify_model(result.model, opened).claim
    assert (claim.bit_accuracy, claim.verdict.value) == (1.0, "marked")


def test_copies_share_the_owners_layer_and_have_one_of_their_own(small_plant: GaussianModel) -> None:
    one, two = quick(small_plant, copy="studio A"), quick(small_plant, copy="studio B")
    assert one.report["message"] == two.report["message"]
    assert one.record.header.record_id != two.record.header.record_id
    opened = [open_record(r.record.to_bytes(bench_key(1)), bench_key(1)) for r in (one, two)]
    assert opened[0].copy == "studio A"
    own = verify_model(one.model, opened[0]).claim
    other = verify_model(one.model, opened[1]).claim
    assert (own.verdict.value, own.copy_named) == ("marked", True)
    assert (other.verdict.value, other.copy_named) == ("marked", False)
    assert own.z == other.z


def test_owner_cameras_are_used(small_plant: GaussianModel) -> None:
    cameras = make_rig(small_plant, 12, 1000, 500)
    result = embed(
        small_plant,
        bench_key(1),
        original_sha256=DIGEST,
        cameras=cameras,
        config=profile("fast", landmark_views=0, views=3, view_size=200),
    )
    opened = open_record(result.record.to_bytes(bench_key(1)), bench_key(1))
    poses = [camera.viewmat for camera in cameras]
    assert len(opened.cameras) == 3
    for camera in opened.cameras:
        assert (camera.width, camera.height) == (200, 100)
        assert any(np.array_equal(camera.viewmat, pose) for pose in poses)


def test_refinement_moves_the_mark_and_keeps_fidelity_and_bits(small_plant: GaussianModel) -> None:
    plain = quick(small_plant)
    refined = quick(small_plant, refine=RefineConfig(steps=6, size=96))
    assert np.abs(plain.model.sh - refined.model.sh).max() > 1e-4
    assert refined.report["psnr_worst_view"] >= 46.9
    opened = open_record(refined.record.to_bytes(bench_key(1)), bench_key(1))
    assert verify_model(refined.model, opened, VerifyConfig(route="model")).claim.bit_accuracy == 1.0


def test_progress_and_seconds_name_the_stages(small_plant: GaussianModel) -> None:
    seen: dict[str, float] = {}
    result = embed(
        small_plant,
        bench_key(1),
        original_sha256=DIGEST,
        progress=lambda stage, share: seen.update({stage: share}),
        config=profile("fast", landmark_views=0, views=3, view_size=128),
    )
    assert set(seen) == set(result.report["seconds_by_stage"]) >= {"look", "quantize", "plan", "record"}
    assert all(share == 1.0 for share in seen.values())


@pytest.mark.parametrize(
    ("factors", "words"), [((1, 0, 0), "on a line"), ((0, 0, 0), "one point")], ids=["line", "point"]
)
def test_what_no_registration_could_place_is_refused(
    small_plant: GaussianModel, factors: tuple[float, ...], words: str
) -> None:
    flat = small_plant.with_(means=small_plant.means * np.array(factors, dtype=np.float32))
    with pytest.raises(InputError, match=words):
        quick(flat)


def test_a_stray_does_not_make_a_line_of_a_model(small_plant: GaussianModel) -> None:
    means = small_plant.means.copy()
    means[7] = (1e6, 0, 0)
    assert quick(small_plant.with_(means=means)).report["psnr_worst_view"] >= 46.9
    with pytest.raises(InputError, match="on a line"):
        quick(small_plant.with_(means=means * np.array((1, 0, 0), dtype=np.float32)))


@pytest.mark.parametrize("fault", ["clear", "blinding", "away"])
def test_a_model_that_no_key_view_shows_is_refused(small_plant: GaussianModel, fault: str) -> None:
    model, cameras = small_plant, {}
    if fault == "clear":
        model = model.with_(opacity_logits=np.full(len(model), -60, np.float32))
    elif fault == "blinding":
        model = model.take(np.arange(0, len(model), 40))
        model = model.with_(log_scales=np.full((len(model), 3), 1, np.float32), sh=model.sh + np.float32(1000))
    else:
        away = np.diag([-1.0, 1.0, -1.0, 1.0])  # half a turn
        turned = [Camera(away @ c.viewmat, c.K, c.width, c.height) for c in make_rig(model, 3, 64, 64)]
        cameras = {"cameras": turned}
    with pytest.raises(InputError, match="no key view shows anything"):
        embed(model, bench_key(1), original_sha256=DIGEST, config=profile("fast", landmark_views=0, views=3), **cameras)


def test_centres_that_float32_rounds_together_are_refused(small_plant: GaussianModel) -> None:
    far = small_plant.with_(means=small_plant.means + np.float32(1e9))
    with pytest.raises(InputError, match="float32 cannot tell its centres apart"):
        quick(far)


@pytest.mark.parametrize("copy", ["", "a"])
def test_values_of_an_eight_bit_original_stay_eight_bit(small_plant: GaussianModel, copy: str) -> None:
    """Between them, the distance to the nearest would be the watermark."""
    made = quick(small_plant, copy=copy)
    for channel in range(3):
        before, after = (model.sh[:, 0, channel] for model in (small_plant, made.model))
        assert (before != after).mean() > 0.5
        levels = (after.astype(np.float64) * SH_C0 + 0.5) * 255.0
        assert np.abs(levels - np.rint(levels)).max() < 1e-3


def test_copies_with_and_without_a_name_are_not_made_together(small_plant: GaussianModel) -> None:
    with pytest.raises(InputError, match="give each other away"):
        next(embed_copies(small_plant, bench_key(1), ["", "a"], original_sha256=DIGEST))
