from __future__ import annotations

import doctest
from pathlib import Path

import numpy as np
import pytest

from engine.errors import CapacityError, InputError
from engine.flows.embed.profiles import EmbedConfig, profile
from engine.flows.records.opened_record import open_record
from engine.flows.verify.search import verify_model
from engine.flows.views.camera_rig import make_rig
from engine.formats import encode_model, read_model
from engine.formats.file_writing import write_whole
from engine.lab.sim.variants import generative
from engine.lab.sim.variants.generative import generate_from_views, mark_generated, marking, write_raw_ply
from engine.model import GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import render
from engine.watermark.claim import Verdict
from engine.watermark.keys import OwnerKey


@pytest.fixture
def raw(plant: GaussianModel, tmp_path: Path) -> Path:
    """A file as a generator leaves it."""
    path = tmp_path / "logs" / "object.ply"
    path.parent.mkdir()
    write_whole(path, write_raw_ply(plant.take(np.arange(0, len(plant), 2)), seed=1))
    return path


def claims(path: Path, records: Path, key: OwnerKey) -> list[Verdict]:
    suspect = read_model(path).model
    opened = [open_record(record.read_bytes(), key) for record in sorted(records.glob("*.record"))]
    return [verify_model(suspect, record).claim.verdict for record in opened]


def test_raw_quaternions_have_any_length_and_read_as_rotations(plant: GaussianModel, raw: Path) -> None:
    table = np.frombuffer(raw.read_bytes().partition(b"end_header\n")[2], "<f4").reshape(-1, 17)
    lengths = np.linalg.norm(table[:, 13:], axis=1)
    assert lengths.std() > 0.2
    loaded = read_model(raw)
    assert [r.code for r in loaded.repairs] == ["quaternions_normalized"]
    np.testing.assert_allclose(loaded.model.quats, plant.quats[::2], atol=1e-6)


def test_a_decorated_generator_returns_marked_models(
    plant: GaussianModel, key: OwnerKey, config: EmbedConfig, tmp_path: Path
) -> None:
    @marking(key, tmp_path / "records", bits=16, config=config)
    def generate(start: int, *, step: int) -> GaussianModel:
        """Takes some Gaussians."""
        return plant.take(np.arange(start, len(plant), step))

    assert generate.__name__ == "generate"
    marked = generate(0, step=2)
    plain = plant.take(np.arange(0, len(plant), 2))
    np.testing.assert_array_equal(marked.quats, plain.quats)
    assert not np.array_equal(marked.sh, plain.sh)
    (record,) = (tmp_path / "records").iterdir()
    opened = open_record(record.read_bytes(), key)
    assert record.name == f"{opened.header.record_id}.record"
    assert verify_model(marked, opened).claim.verdict is Verdict.MARKED
    assert verify_model(plain, opened).claim.verdict is Verdict.NOT_MARKED


def test_a_file_is_marked_in_place(raw: Path, key: OwnerKey, config: EmbedConfig, tmp_path: Path) -> None:
    before = read_model(raw)
    mark = marking(key, tmp_path / "records", bits=16, config=config)
    assert mark_generated(raw, key, tmp_path / "records", bits=16, config=config) == raw
    after = read_model(raw)
    assert after.format == "ply"
    assert after.sha256 != before.sha256
    assert claims(raw, tmp_path / "records", key) == [Verdict.MARKED]
    assert mark(lambda: str(raw))() == str(raw)  # marked once more: now there are two records
    assert sorted(claims(raw, tmp_path / "records", key)) == [Verdict.MARKED, Verdict.MARKED]


def test_what_cannot_carry_the_mark_is_left_as_it_was(key: OwnerKey, plant: GaussianModel, tmp_path: Path) -> None:
    path = tmp_path / "few.ply"
    path.write_bytes(encode_model(plant.take(np.arange(80)), "ply"))
    data = path.read_bytes()
    with pytest.raises(CapacityError):
        mark_generated(path, key, tmp_path / "records", bits=256, config=generative.FEW_GAUSSIANS)
    assert path.read_bytes() == data
    assert not (tmp_path / "records").exists()


def test_what_is_no_model_is_refused(key: OwnerKey, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="returned NoneType"):
        marking(key, tmp_path)(lambda: None)()  # type: ignore[type-var]


def test_the_example_in_the_docstring_runs() -> None:
    failed, tried = doctest.testmod(generative)
    assert failed == 0
    assert tried >= 8


def test_generation_comes_nearer_to_its_views(plant: GaussianModel) -> None:
    rig = make_rig(plant, 6, 96, 96)
    images = [np.clip(render(plant, camera), 0, 1) for camera in rig]
    early = generate_from_views(rig, images, points=600, steps=2)
    late = generate_from_views(rig, images, points=600, steps=60)
    assert late.sh_degree == 0

    def quality(model: GaussianModel) -> float:
        return float(np.mean([psnr(a, render(model, c)) for a, c in zip(images, rig, strict=True)]))

    assert quality(late) > quality(early) + 1


def test_few_gaussians_get_cells_of_their_own() -> None:
    assert generative.FEW_GAUSSIANS.quantize.min_members < profile("balanced").quantize.min_members
