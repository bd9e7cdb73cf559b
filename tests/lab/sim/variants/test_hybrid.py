from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.errors import InputError
from engine.flows.embed.embedding import Embedding, embed
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.terms import MarkTerms
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.lab.evaluate.marked_scene import bench_key
from engine.lab.sim.variants.codebooks import make_codebook
from engine.lab.sim.variants.hybrid import HybridPart, assemble, verify_hybrid
from engine.model import GaussianModel
from engine.numerics.gaussians import flatten
from engine.numerics.umeyama import Similarity
from engine.scenes.scene_marking import embed_codebook
from engine.scenes.spacetime import SpacetimeModel
from engine.watermark.claim import Verdict
from engine.watermark.keys import OwnerKey


def place(scale: float, degrees: float, x: float) -> Similarity:
    return Similarity(scale, Rotation.from_euler("y", degrees, degrees=True).as_matrix(), np.array([x, 0.0, 0.0]))


@pytest.mark.long
def test_variants_in_one_file_are_told_apart(
    plant: GaussianModel,
    clip: SpacetimeModel,
    marked_clip: tuple[SpacetimeModel, Embedding, OpenedRecord],
    key: OwnerKey,
    config: EmbedConfig,
) -> None:
    """A still part, discs, a moment and a codebook, placed differently; a fifth record's mark is not there.

    The moment shows the whole plant, of which the others are parts: every asset is in the file twice.
    """
    x, y = (plant.means[:, axis] < np.median(plant.means[:, axis]) for axis in (0, 1))
    half, rest, left = (plant.take(np.flatnonzero(part)) for part in (x & y, ~y, ~x & y))

    def mark(model: GaussianModel, owner: OwnerKey) -> tuple[GaussianModel, OpenedRecord]:
        result = embed(model, owner, original_sha256="1" * 64, bits=16, config=config)
        return result.model, open_record(result.record.to_bytes(owner), owner)

    still, still_record = mark(half, key)
    discs, disc_record = mark(flatten(rest), key)
    squeezed, result = embed_codebook(
        make_codebook(left, {"dc": 400}), key, MarkTerms(bits=16, config=config), original_sha256="2" * 64
    )
    squeezed_record = open_record(result.record.to_bytes(key), key)
    _, absent = mark(half, bench_key(77))
    scene = assemble(
        {
            "still": HybridPart(still, place(1.0, 0.0, 0.0)),
            "discs": HybridPart(discs, place(0.7, 40.0, 3.0)),
            "moving": HybridPart(marked_clip[0], place(1.6, -70.0, 7.0), time=0.4),
            "squeezed": HybridPart(squeezed, place(2.0, 120.0, 14.0)),
        }
    )
    records = {
        "still": still_record,
        "discs": disc_record,
        "moving": marked_clip[2],
        "squeezed": squeezed_record,
        "absent": absent,
    }
    findings = verify_hybrid(scene, records, {"moving": (clip, 0.4)}, instances=2)
    marked = {f.record: f for f in findings if f.claim.verdict is Verdict.MARKED}
    assert set(marked) == {"still", "discs", "moving", "squeezed"}
    for name, finding in marked.items():
        assert finding.claim.bit_accuracy == 1.0
        assert finding.objects[0][0] == name
        assert finding.claim.tries == 60


def test_a_moving_part_needs_its_moment(clip: SpacetimeModel, marked_clip) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match="time"):
        assemble({"moving": HybridPart(clip, Similarity.identity())})
    with pytest.raises(InputError, match="'other' moves"):
        verify_hybrid(clip.at(0.5), {"moving": marked_clip[2]}, {"other": (clip, 0.5)})
