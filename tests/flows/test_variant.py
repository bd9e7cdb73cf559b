from __future__ import annotations

import numpy as np
import pytest

from engine.compress.impact import Impact
from engine.errors import InputError
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.flows.embed.variant import Variant
from engine.flows.records.opened_record import open_record
from engine.flows.verify.search import verify_model
from engine.lab.evaluate.marked_scene import bench_key
from engine.model import GaussianModel

KEY = bench_key(3)
CONFIG = profile("fast", views=3, view_size=192, landmark_views=0)


def moved(model: GaussianModel, variant: Variant, **changes: object) -> np.ndarray:
    """(N, 3) what a mark does to the DC coefficients."""
    config = profile("fast", views=3, view_size=192, landmark_views=0, **changes)
    result = embed(model, KEY, original_sha256="0" * 64, bits=16, config=config, variant=variant)
    return result.model.sh[:, 0] - model.sh[:, 0]


def test_own_codes_move_as_one(small_plant: GaussianModel) -> None:
    labels = (np.arange(len(small_plant)) % 700).astype(np.int32)
    change = moved(small_plant, Variant(labels=labels))
    for code in (0, 5, 699):
        members = change[labels == code]
        assert np.abs(members - members[0]).max() < 1e-5
    assert len(np.unique(change[:700].round(5), axis=0)) > 600


def test_emphasis_scales_the_mark(small_plant: GaussianModel) -> None:
    left = small_plant.means[:, 0] < np.median(small_plant.means[:, 0])
    plain = np.abs(moved(small_plant, Variant())).mean(axis=1)
    change = np.abs(moved(small_plant, Variant(emphasis=np.where(left, 0.25, 1.0)))).mean(axis=1)
    ratio = (change[left].mean() / change[~left].mean()) / (plain[left].mean() / plain[~left].mean())
    assert 0.2 < ratio < 0.45  # cells across the border take of both; which they are, the processor's rounding decides


def test_what_the_views_see_decides_the_strength(small_plant: GaussianModel) -> None:
    """A model of which every view shows only a part may be marked more strongly."""
    part = small_plant.opacity_logits.copy()
    part[small_plant.means[:, 1] < np.median(small_plant.means[:, 1])] = -30.0
    plain = moved(small_plant, Variant())
    seen = moved(small_plant, Variant(at_view=lambda m, k: m.with_(opacity_logits=part)))
    assert np.abs(seen).mean() > 1.15 * np.abs(plain).mean()


@pytest.mark.parametrize("free", ["centers", "sizes"])
def test_what_has_no_room_carries_no_grain(small_plant: GaussianModel, free: str) -> None:
    own = Variant(free_centers=free == "centers", free_sizes=free == "sizes")
    result = embed(small_plant, KEY, original_sha256="0" * 64, bits=16, config=CONFIG, variant=own)
    opened = open_record(result.record.to_bytes(KEY), KEY)
    assert np.array_equal(result.model.means, small_plant.means) == (free != "centers")
    assert np.array_equal(result.model.log_scales, small_plant.log_scales) == (free != "sizes")
    assert verify_model(result.model, opened).claim.layers["grain"] > 30


def test_commitments_are_kept_and_decide_the_chips(small_plant: GaussianModel) -> None:
    ids = set()
    for value in ("a", "b"):
        result = embed(
            small_plant,
            KEY,
            original_sha256="0" * 64,
            bits=16,
            config=CONFIG,
            variant=Variant(commitments={"beside": value}),
        )
        opened = open_record(result.record.to_bytes(KEY), KEY)
        assert opened.commitments == {"beside": value}
        ids.add(opened.header.record_id)
    assert len(ids) == 2


def test_what_does_not_fit_is_refused(small_plant: GaussianModel) -> None:
    n = len(small_plant)
    cases = [
        (Variant(labels=np.zeros(5, np.int32)), "labels has shape"),
        (Variant(labels=np.full(n, -1, np.int32)), "negative, got -1"),
        (Variant(emphasis=np.zeros(n)), "emphasis must lie"),
    ]
    for variant, message in cases:
        with pytest.raises(InputError, match=message):
            moved(small_plant, variant)
    with pytest.raises(InputError, match="as it is"):
        moved(small_plant, Variant(emphasis=np.ones(n)), output="compact")
    refining = profile("fast").refine.__class__(steps=5)
    with pytest.raises(InputError, match="one moment"):
        moved(small_plant, Variant(at_view=lambda m, k: m), refine=refining)


def test_a_code_that_half_the_scene_shares_is_displaced_less(small_plant: GaussianModel) -> None:
    """Else its few chips would spend the whole fidelity: more bits fit when the energies are even."""
    labels = (1 + np.arange(len(small_plant)) % 700).astype(np.int32)
    labels[small_plant.means[:, 1] > np.median(small_plant.means[:, 1])] = 0
    result = embed(small_plant, KEY, original_sha256="0" * 64, bits=16, config=CONFIG, variant=Variant(labels=labels))
    size = np.linalg.norm(result.model.sh[:, 0] - small_plant.sh[:, 0], axis=1)
    assert size[labels == 0].mean() < 0.2 * size[labels > 0].mean()


def test_amplitudes_fall_with_the_root_of_what_a_code_covers() -> None:
    """Then its energy, coverage times the amplitude's square, is everybody's."""
    labels = np.array([0, 1, 2, 3, 3, 3, 3], np.int32)
    coverage = np.ones(7)
    impact = Impact(coverage, coverage[None].astype(np.float32), coverage, coverage)
    even = Variant(labels=labels).emphasis_on(impact)
    assert even is not None
    np.testing.assert_allclose(even, [1, 1, 1, 0.5, 0.5, 0.5, 0.5])
    both = Variant(labels=labels, emphasis=np.full(7, 0.5)).emphasis_on(impact)
    np.testing.assert_allclose(both, 0.5 * even)
    assert Variant().emphasis_on(impact) is None


def test_emphasis_of_nothing_is_refused(small_plant: GaussianModel) -> None:
    partly = np.linspace(0.0, 1.0, len(small_plant))
    with pytest.raises(InputError, match="emphasis must lie"):
        Variant(emphasis=partly).check(small_plant, keeps_rows=True, refines=False)
