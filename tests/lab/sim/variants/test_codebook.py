from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.embed.embedding import Embedding
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.terms import MarkTerms
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.flows.verify.search import verify_model
from engine.lab.sim.attacks import model_attack
from engine.lab.sim.variants.codebooks import make_codebook
from engine.model import GaussianModel
from engine.scenes.codebook_model import CodebookModel
from engine.scenes.scene_marking import embed_codebook
from engine.watermark.claim import Verdict
from engine.watermark.keys import OwnerKey

CODES = {"dc": 512, "scale": 256, "rot": 256}


@pytest.fixture(scope="module")
def compressed(plant: GaussianModel) -> CodebookModel:
    return make_codebook(plant, CODES)


@pytest.fixture(scope="module")
def marked(
    compressed: CodebookModel, key: OwnerKey, config: EmbedConfig
) -> tuple[CodebookModel, Embedding, OpenedRecord]:
    model, result = embed_codebook(compressed, key, MarkTerms(bits=16, config=config), original_sha256="0" * 64)
    return model, result, open_record(result.record.to_bytes(key), key)


def test_decoding_looks_every_index_up(compressed: CodebookModel, plant: GaussianModel) -> None:
    model = compressed.decode()
    for i in (0, 17, 5000):
        np.testing.assert_array_equal(model.sh[i, 0], compressed.centers["dc"][compressed.indices["dc"][i]])
        np.testing.assert_array_equal(model.log_scales[i], compressed.centers["scale"][compressed.indices["scale"][i]])
        quat = compressed.centers["rot"][compressed.indices["rot"][i]]
        np.testing.assert_allclose(model.quats[i], quat / np.linalg.norm(quat), atol=1e-6)
    np.testing.assert_array_equal(model.means, plant.means)
    np.testing.assert_array_equal(model.opacity_logits, plant.opacity_logits)


def test_more_codes_come_nearer(compressed: CodebookModel, plant: GaussianModel) -> None:
    def error(model: CodebookModel) -> float:
        return float(np.mean((model.decode().sh - plant.sh) ** 2))

    coarse = make_codebook(plant, {**CODES, "dc": 32})
    assert error(compressed) < 0.3 * error(coarse)
    assert error(coarse) < 0.2 * float(plant.sh.var())


def test_each_gaussian_has_its_nearest_code(compressed: CodebookModel, plant: GaussianModel) -> None:
    """All are assigned to the last but one centers, whose means the codes are: nearly nearest."""
    gap = ((plant.sh[:400, 0, None] - compressed.centers["dc"][None]) ** 2).sum(axis=2)  # (400, M)
    own = gap[np.arange(400), compressed.indices["dc"][:400]]
    assert (own <= gap.min(axis=1) + 1e-12).mean() > 0.9


def test_no_codes_but_those_of_colors_are_touched(compressed: CodebookModel, marked) -> None:  # type: ignore[no-untyped-def]
    model = marked[0]
    assert model.centers["dc"].shape == compressed.centers["dc"].shape
    assert (model.centers["dc"] != compressed.centers["dc"]).any(axis=1).mean() > 0.9
    for name in ("scale", "rot"):
        np.testing.assert_array_equal(model.centers[name], compressed.centers[name])
    for name in compressed.indices:
        np.testing.assert_array_equal(model.indices[name], compressed.indices[name])


def test_plain_centres_carry_the_grain_and_quantized_sizes_do_not(compressed: CodebookModel, marked) -> None:  # type: ignore[no-untyped-def]
    model, result, opened = marked
    assert opened.grain.center > 0.0
    assert opened.grain.scale == 0.0
    np.testing.assert_array_equal(model.decode().means, result.model.means)
    assert (model.plain["xyz"] != compressed.plain["xyz"]).any(axis=1).mean() > 0.99
    assert verify_model(model.decode(), opened).claim.layers["grain"] > 100


def test_the_codes_are_the_code_vectors(compressed: CodebookModel, marked) -> None:  # type: ignore[no-untyped-def]
    model, result, opened = marked
    np.testing.assert_array_equal(opened.layout.labels[0], compressed.indices["dc"])
    np.testing.assert_array_equal(model.decode().sh, result.model.sh)


@pytest.mark.parametrize(("attack", "strength"), [(None, 0), ("prune_random", 0.5), ("noise_colors", 0.1)])
def test_it_verifies(compressed: CodebookModel, marked, attack: str | None, strength: float) -> None:  # type: ignore[no-untyped-def]
    model, _, opened = marked
    suspect = model.decode()
    if attack is not None:
        suspect = model_attack(attack).apply(suspect, strength)
    claim = verify_model(suspect, opened).claim
    assert claim.verdict is Verdict.MARKED
    assert claim.bit_accuracy == 1.0
    assert verify_model(compressed.decode(), opened).claim.verdict is Verdict.NOT_MARKED


def test_an_unquantized_color_is_no_codebook(plant: GaussianModel, key: OwnerKey) -> None:
    plain = make_codebook(plant.take(np.arange(200)), {"scale": 16})
    with pytest.raises(InputError, match="plain model"):
        embed_codebook(plain, key, original_sha256="0" * 64)


def test_parts_that_do_not_fit(compressed: CodebookModel, plant: GaussianModel) -> None:
    parts = {
        "plain": compressed.plain,
        "centers": compressed.centers,
        "indices": compressed.indices,
        "index_bits": compressed.index_bits,
    }
    far = {**compressed.indices, "dc": compressed.indices["dc"] + 1}
    with pytest.raises(InputError, match="indices of 'dc'"):
        CodebookModel(**{**parts, "indices": far})
    with pytest.raises(InputError, match="8 bits"):
        CodebookModel(**{**parts, "index_bits": 8})
    with pytest.raises(InputError, match="'xyz' must be"):
        CodebookModel(**{**parts, "plain": {"opacity": compressed.plain["opacity"]}})
    with pytest.raises(InputError, match="cannot have shape"):
        compressed.with_codes("dc", compressed.centers["dc"][:5])
    with pytest.raises(InputError, match="'color'"):
        make_codebook(plant, {"color": 5})
