from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.embed.embedding import Embedding
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.terms import MarkTerms
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.flows.verify.search import verify_images, verify_model
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.marked_scene import bench_key
from engine.numerics.image_metrics import psnr
from engine.raster import render
from engine.scenes.clip_marking import (
    embed_moving,
    find_time,
    key_times,
    move_record,
    verify_moment,
    verify_moving_images,
    visible,
)
from engine.scenes.spacetime import SpacetimeModel
from engine.watermark.claim import Verdict
from engine.watermark.keys import OwnerKey

Marked = tuple[SpacetimeModel, Embedding, OpenedRecord]


def test_the_mark_changes_colors_centres_and_sizes(clip: SpacetimeModel, marked_clip: Marked) -> None:
    marked = marked_clip[0]
    for name in clip.__dataclass_fields__:
        same = np.array_equal(getattr(clip, name), getattr(marked, name))
        assert same == (name not in ("colors", "means", "log_scales"))


def test_the_4d_file_carries_the_mark(clip: SpacetimeModel, marked_clip: Marked) -> None:
    marked, _, opened = marked_clip
    claim = verify_model(marked.canonical(), opened).claim
    assert claim.verdict is Verdict.MARKED
    assert claim.bit_accuracy == 1.0
    assert claim.layers["tint"] > 30
    assert claim.layers["grain"] > 150
    assert verify_model(clip.canonical(), opened).claim.verdict is Verdict.NOT_MARKED


@pytest.mark.parametrize("time", [0.05, 0.9])
def test_an_export_of_a_moment_carries_the_mark(clip: SpacetimeModel, marked_clip: Marked, time: float) -> None:
    """As a viewer exports it: what is visible, in another order, and the owner moves the record to that moment."""
    marked, _, opened = marked_clip
    shown = visible(marked.at(time))
    assert len(shown) < len(clip)
    suspect = shown.take(np.arange(len(shown))[::-1].copy())
    moved = move_record(opened, clip, time)
    claim = verify_model(suspect, moved).claim
    assert claim.verdict is Verdict.MARKED
    assert claim.bit_accuracy == 1.0
    assert claim.layers["tint"] > 30
    assert claim.layers["grain"] > 140
    assert verify_model(visible(clip.at(time)), moved).claim.verdict is not Verdict.MARKED


def test_a_picture_of_a_moment_carries_the_mark(clip: SpacetimeModel, marked_clip: Marked) -> None:
    marked, _, opened = marked_clip
    time, camera = 0.7, make_rig(clip.canonical(), 3, 224, 224)[1]
    shown = np.clip(render(marked.at(time), camera), 0, 1)
    claim = verify_images([shown], move_record(opened, clip, time), cameras=[camera]).claim
    assert claim.verdict is Verdict.MARKED
    still = np.clip(render(clip.at(time), camera), 0, 1)
    assert verify_images([still], move_record(opened, clip, time), cameras=[camera]).claim.z < 5


def test_a_picture_of_an_unknown_moment_counts_every_moment_tried(clip: SpacetimeModel, marked_clip: Marked) -> None:
    marked, _, opened = marked_clip
    camera = make_rig(clip.canonical(), 3, 224, 224)[1]
    shown = np.clip(render(marked.at(0.5), camera), 0, 1)
    best, time = verify_moving_images([shown], opened, clip, [0.1, 0.5], cameras=[camera])
    assert time == 0.5
    assert best.claim.verdict is Verdict.MARKED
    assert best.claim.tries == 2 * 6


@pytest.mark.long
def test_the_moment_of_an_export_is_found(clip: SpacetimeModel, marked_clip: Marked) -> None:
    marked, _, opened = marked_clip
    for time in (0.31, 0.62):  # halfway between two that are tried, the wrong one may explain more, less exactly
        assert find_time(marked.at(time), opened, clip) == pytest.approx(time, abs=0.02)
    assert verify_moment(marked.at(0.31), opened, clip).claim.verdict is Verdict.MARKED


def test_another_original_is_refused(clip: SpacetimeModel, marked_clip: Marked) -> None:
    """The motion enters before the chips are drawn: a motion made up afterwards does not fit the record."""
    forged = replace(clip, motion=clip.motion + np.float32(1e-4))
    with pytest.raises(InputError, match="not the original"):
        move_record(marked_clip[2], forged, 0.5)


def test_the_motion_decides_the_chips(
    clip: SpacetimeModel, marked_clip: Marked, key: OwnerKey, config: EmbedConfig
) -> None:
    """One canonical model under one key, another motion: the record's id, hence its chips, are others."""
    _, first, _ = marked_clip
    forged = replace(clip, omega=clip.omega + np.float32(1e-6))
    _, second = embed_moving(forged, key, MarkTerms(config=config), original_sha256=clip.digest())
    assert first.record.header.reference_digest == second.record.header.reference_digest
    assert first.record.header.record_id != second.record.header.record_id


def test_wrong_keys_find_nothing(clip: SpacetimeModel, marked_clip: Marked, config: EmbedConfig) -> None:
    """Another owner's record of the very same scene, read from every kind of evidence the first one has."""
    other = bench_key(99)
    _, result = embed_moving(clip, other, MarkTerms(config=config))
    theirs = open_record(result.record.to_bytes(other), other)
    marked = marked_clip[0]
    assert verify_model(marked.canonical(), theirs).claim.verdict is Verdict.INCONCLUSIVE  # another mark lies there
    assert abs(verify_moment(marked.at(0.3), theirs, clip, 0.3).claim.z) < 5


def test_what_is_short_lived_carries_less(clip: SpacetimeModel, marked_clip: Marked) -> None:
    """By plan: what a single key draws differs by a twentieth from key to key."""
    layout = marked_clip[2].layout
    planned = np.linalg.norm(layout.split(layout.amplitudes)[0], axis=1)[layout.labels[0]]
    persistence = clip.persistence()
    assert (persistence < 0.3).any()
    assert planned[persistence < 0.3].mean() < 0.7 * planned[persistence > 0.9].mean()


def test_fidelity_holds_at_moments_that_were_not_key(clip: SpacetimeModel, marked_clip: Marked) -> None:
    marked = marked_clip[0]
    for k, time in enumerate((0.13, 0.52, 0.98)):
        camera = make_rig(clip.canonical(), 3, 256, 256)[k]
        assert psnr(render(clip.at(time), camera), render(marked.at(time), camera)) > 45


def test_key_times_are_spread(clip: SpacetimeModel) -> None:
    times = np.sort(key_times(clip, 10))
    assert 0 <= times[0] < 0.15
    assert 0.85 < times[-1] <= 1
    assert np.diff(times).max() < 0.25


def test_a_still_record_commits_to_no_motion(clip: SpacetimeModel, marked_clip: Marked) -> None:
    still = replace(marked_clip[2], commitments={})
    with pytest.raises(InputError, match="static scene"):
        move_record(still, clip, 0.5)
