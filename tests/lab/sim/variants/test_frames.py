from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.embed.terms import MarkTerms
from engine.flows.records.opened_record import open_record
from engine.formats import write_model
from engine.lab.sim.variants.synthetic import SwayingScene
from engine.model import GaussianModel
from engine.numerics.similarity import quaternion_to_rotation
from engine.scenes.clip_marking import embed_moving, verify_moment
from engine.scenes.frame_folders import FrameSequence, read_frames
from engine.watermark.claim import Verdict
from engine.watermark.keys import OwnerKey


@pytest.fixture(scope="module")
def sequence(swaying: SwayingScene) -> FrameSequence:
    times = [0.0, 0.5, 1.0]
    return FrameSequence([swaying.at(t) for t in times], times)


def test_a_folder_reads_in_the_order_of_names(sequence: FrameSequence, tmp_path: Path) -> None:
    for number, frame in enumerate(sequence.frames):
        write_model(frame, tmp_path / f"time_{number:05d}.ply")
    back = read_frames(tmp_path)
    assert list(back.times) == [0.0, 0.5, 1.0]
    for a, b in zip(sequence.frames, back.frames, strict=True):
        np.testing.assert_array_equal(a.means, b.means)


def test_the_nearest_frame_is_shown(sequence: FrameSequence) -> None:
    np.testing.assert_array_equal(sequence.at(0.3).means, sequence.frames[1].means)
    np.testing.assert_array_equal(sequence.canonical().means, sequence.frames[1].means)
    assert sequence.span == (0.0, 1.0)


def test_one_record_verifies_every_frame(sequence: FrameSequence, key: OwnerKey, config) -> None:  # type: ignore[no-untyped-def]
    marked, result = embed_moving(sequence, key, MarkTerms(bits=16, config=config))
    opened = open_record(result.record.to_bytes(key), key)
    for time in sequence.times:
        claim = verify_moment(marked.at(time), opened, sequence, time).claim
        assert claim.verdict is Verdict.MARKED
        assert claim.bit_accuracy == 1.0
        assert claim.layers["grain"] > 140
        assert verify_moment(sequence.at(time), opened, sequence, time).claim.verdict is not Verdict.MARKED


def test_displaced_frames_follow_their_gaussians(sequence: FrameSequence) -> None:
    """What lies half a size along an axis of the canonical model lies there in every frame, however it is turned."""
    still = sequence.canonical()
    turned = sequence.frames[0].with_(log_scales=still.log_scales + np.float32(0.7))
    clip = FrameSequence([turned, *sequence.frames[1:]], sequence.times)

    def axis(model: GaussianModel) -> np.ndarray:
        length = np.exp(model.log_scales[:, 1:2].astype(np.float64))
        return np.asarray(0.5 * length * quaternion_to_rotation(model.quats)[:, :, 1])

    like = still.with_(
        means=(still.means + axis(still)).astype(np.float32),
        log_scales=still.log_scales - np.float32(0.1),
        sh=still.sh + np.float32(0.2),
    )
    moved = clip.displaced(like)
    for before, after in zip(clip.frames, moved.frames, strict=True):
        np.testing.assert_allclose(after.means - before.means, axis(before), atol=1e-5)
        np.testing.assert_allclose(after.log_scales - before.log_scales, -0.1, atol=1e-5)
        np.testing.assert_allclose(after.sh - before.sh, 0.2, atol=1e-5)
    np.testing.assert_array_equal(clip.at(0.0, like).means, moved.frames[0].means)


def test_frames_that_do_not_belong_together_are_refused(sequence: FrameSequence, tmp_path: Path) -> None:
    a, b, _ = sequence.frames
    with pytest.raises(InputError, match="same ones"):
        FrameSequence([a, b.take(np.arange(5))], [0, 1])
    with pytest.raises(InputError, match="of frame 1 differ"):
        FrameSequence([a, b.with_(sh=b.sh + 0.1)], [0, 1])
    with pytest.raises(InputError, match="ascending"):
        FrameSequence([a, b], [1, 0])
    with pytest.raises(InputError, match="2 frames but 1 times"):
        FrameSequence([a, b], [1])
    with pytest.raises(InputError, match=r"no \.ply"):
        read_frames(tmp_path)
    with pytest.raises(InputError, match="no folder"):
        read_frames(tmp_path / "nowhere")


def test_digest_sees_times_and_geometry(sequence: FrameSequence) -> None:
    a, b, c = sequence.frames
    moved = b.with_(means=b.means + 1e-3)
    others = [FrameSequence([a, b, c], [0.0, 0.4, 1.0]), FrameSequence([a, moved, c], [0.0, 0.5, 1.0])]
    assert len({sequence.digest(), *(other.digest() for other in others)}) == 3
