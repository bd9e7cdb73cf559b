"""SOG against definitions, another reader of version 1, and archives that lie."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from engine.errors import FormatError, InputError
from engine.formats import read_model
from engine.formats.morton import morton_order
from engine.formats.ply.gaussians import read_ply
from engine.formats.sog.bundle import read_sog, read_sog_folder, write_sog
from engine.formats.sog.encoding import position_codes
from engine.model import GaussianModel
from tests.formats.damage import assert_valid
from tests.formats.models import assert_same
from tests.formats.sog_scenes import (
    bundle,
    pixels_of,
    png,
    random_model,
    unbundle,
    version_1,
    webp,
    with_meta,
    with_parts,
    zip64,
)
from tests.threads import with_one_and_two_threads

TRAIN = Path(__file__).parents[1] / "data" / "train_1000.ply"


@pytest.fixture(scope="module")
def train() -> GaussianModel:
    return read_ply(TRAIN.read_bytes(), file="train")[0]


def in_file_order(model: GaussianModel) -> GaussianModel:
    return model.take(morton_order(position_codes(model.means)[0].astype(np.float32)))


SCENE = write_sog(random_model(1))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_round_trip_errs_by_the_steps_of_the_format(degree):
    model = random_model(degree)
    back, repairs = read_sog(write_sog(model), file="x")
    model = in_file_order(model)
    assert repairs == ()
    assert back.sh_degree == degree
    # Half a 16-bit step of the bent range, stretched back by the slope 1 + |x|.
    bent = np.sign(model.means) * np.log1p(np.abs(model.means))
    step = (bent.max(axis=0) - bent.min(axis=0)) / 65535
    assert (np.abs(back.means - model.means) <= (1 + np.abs(model.means)) * step * 0.51 + 1e-6).all()
    assert np.abs(back.opacities - model.opacities).max() <= 1 / 510 + 1e-6
    # Each of three components errs by sqrt(2) / 510, the largest (>= 1/2) follows from them.
    q = model.quats * np.sign((model.quats * back.quats).sum(axis=1, keepdims=True))
    error = np.abs(back.quats - q)
    np.put_along_axis(error, np.abs(q).argmax(axis=1)[:, None], 0.0, axis=1)
    assert error.max() <= np.sqrt(2) / 510 + 1e-6
    # 256 values for 900: a few times a quarter of the mean gap.
    for ours, theirs in ((back.log_scales, model.log_scales), (back.sh[:, 0], model.sh[:, 0])):
        spread = theirs.max() - theirs.min()
        assert 0 < np.abs(ours - theirs).mean() < spread / 256 / 2
    if degree:
        palette_error = np.mean((back.sh[:, 1:] - model.sh[:, 1:]) ** 2)
        assert palette_error < 0.9 * model.sh[:, 1:].var()  # 256 code vectors for 300 Gaussians of pure noise


def test_pictures_of_few_colours_survive_bit_for_bit():
    """What already lies on a codebook is not moved by writing it again."""
    first, _ = read_sog(SCENE, file="x")
    second, _ = read_sog(write_sog(first), file="x")
    first = in_file_order(first)
    for name in ("log_scales", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(second, name), getattr(first, name))
    np.testing.assert_allclose(second.means, first.means, rtol=1e-5, atol=1e-5)


def test_an_empty_model_is_refused():
    with pytest.raises(InputError, match="at least one"):
        write_sog(random_model(0).take(np.arange(0)))


@pytest.mark.parametrize("n", [1, 2, 3, 17, 65])
def test_tiny_scenes(n):
    model = random_model(3, n=n)
    back, _ = read_sog(write_sog(model), file="x")
    assert len(back) == n
    assert np.abs(back.sh[:, 0] - in_file_order(model).sh[:, 0]).max() == 0  # 3 n values fit into 256


def test_same_bytes_whatever_the_thread_count_and_no_date():
    model = random_model(3, n=3000)
    one, two = with_one_and_two_threads(lambda: write_sog(model))
    assert one == two
    with zipfile.ZipFile(io.BytesIO(one)) as archive:
        for entry in archive.infolist():
            assert (entry.date_time, entry.compress_type) == ((1980, 1, 1, 0, 0, 0), zipfile.ZIP_STORED)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_version_1_is_read_as_defined(degree):
    data, expected = version_1(40, degree)
    model, repairs = read_sog(data, file="x")
    assert {r.code for r in repairs} <= {"quaternions_normalized"}  # random pixels may exceed the unit sphere
    for name, values in expected.items():
        np.testing.assert_allclose(getattr(model, name), values, rtol=2e-6, atol=2e-6, err_msg=name)


def test_a_folder_reads_as_the_bundle(tmp_path):
    for name, part in unbundle(SCENE).items():
        (tmp_path / name).write_bytes(part)
    bundled, _ = read_sog(SCENE, file="x")
    for path in (tmp_path, str(tmp_path)):
        model, _ = read_sog_folder(path)
        np.testing.assert_array_equal(model.sh, bundled.sh)
    (tmp_path / "sh0.webp").unlink()
    with pytest.raises(FormatError, match=r"sh0\.webp"):
        read_sog_folder(tmp_path)
    for other in (tmp_path / "quats.webp", tmp_path / "nowhere"):
        with pytest.raises(FormatError):
            read_sog_folder(other)


def test_gsply_reads_version_1_as_we_do(monkeypatch):
    from tests.formats.plain_gsply import sog_reader

    def load(data):
        pixels = pixels_of(data)
        # numba calculates in 64 bits, plain Python in those of the array
        return pixels.reshape(-1).astype(np.int64), pixels.shape[1], pixels.shape[0]

    monkeypatch.setattr(sog_reader, "_load_webp_image", load)  # its own decoder is an extra
    data = version_1(60, 3)[0]
    theirs = sog_reader.sogread(data)
    ours, _ = read_sog(data, file="x")
    np.testing.assert_allclose(theirs.means, ours.means, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(theirs.scales, ours.log_scales, rtol=1e-6)
    norms = np.linalg.norm(theirs.quats, axis=1, keepdims=True)
    np.testing.assert_allclose(theirs.quats / norms, ours.quats, atol=1e-6)
    np.testing.assert_allclose(theirs.sh0, ours.sh[:, 0], atol=1e-6)
    np.testing.assert_allclose(theirs.shN, ours.sh[:, 1:], atol=1e-6)
    finite = np.abs(theirs.opacities) < 10
    np.testing.assert_allclose(theirs.opacities[finite], ours.opacity_logits[finite], atol=1e-4)


def test_harmless_faults_are_mended_and_reported():
    quats = pixels_of(unbundle(SCENE)["quats.webp"]).copy()
    quats[0, :2, 3] = 251
    model, repairs = read_sog(with_parts(SCENE, quats=webp(quats)), file="x")
    assert [(r.code, r.count) for r in repairs] == [("quaternions_untagged", 2)]
    np.testing.assert_array_equal(model.quats[:2], [[1, 0, 0, 0]] * 2)

    labels = pixels_of(unbundle(SCENE)["shN_labels.webp"])[..., :3].copy()
    labels[0, 0] = (255, 255, 0)
    model, repairs = read_sog(with_parts(SCENE, shN_labels=webp(labels)), file="x")
    assert [(r.code, r.count) for r in repairs] == [("labels_beyond_palette", 1)]
    assert (model.sh[0, 1:] == 0).all()

    book = json.loads(unbundle(SCENE)["meta.json"])["sh0"]["codebook"]
    model, repairs = read_sog(with_meta(SCENE, **{"sh0.codebook": [None, *book[1:]]}), file="x")
    assert [r.code for r in repairs] == ["codebook_entry"]

    model, repairs = read_sog(with_meta(SCENE, **{"sh0.codebook": book[:-1]}), file="x")
    assert [r.code for r in repairs] == ["rows_dropped"]
    assert_valid(model)


def written_to_a_pipe(parts: dict[str, bytes]) -> bytes:
    """An archive whose sizes stand behind the parts (data descriptors), as programs write that cannot seek."""

    class Pipe(io.BytesIO):
        def seekable(self) -> bool:
            return False

        def seek(self, *where: int) -> int:
            raise io.UnsupportedOperation

    pipe = Pipe()
    with zipfile.ZipFile(pipe, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    return pipe.getvalue()


@pytest.mark.parametrize(
    "pack",
    [
        zip64,
        lambda data: bundle({f"my scene/{name}": part for name, part in unbundle(data).items()}),
        lambda data: bundle({f"a\\b\\{name}": part for name, part in unbundle(data).items()}),
        lambda data: bundle({f"./{name}": part for name, part in unbundle(data).items()}),
        lambda data: bundle({"scene/": b"", **{f"scene/{name}": part for name, part in unbundle(data).items()}}),
        lambda data: zip64(bundle({f"x/y/{name}": part for name, part in unbundle(data).items()})),
        lambda data: bundle({**unbundle(data), "backup/meta.json": b"{}"}),
        lambda data: written_to_a_pipe(unbundle(data)),
    ],
)
def test_archives_as_other_programs_write_them(pack):
    assert_same(read_sog(pack(SCENE), file="x")[0], read_sog(SCENE, file="x")[0])


def test_images_may_be_png(tmp_path):
    parts = unbundle(SCENE)
    images = {name.replace("webp", "png"): png(pixels_of(part)) for name, part in parts.items() if "webp" in name}
    meta = parts["meta.json"].replace(b".webp", b".png")
    data = bundle({"meta.json": meta, **images})
    assert_same(read_sog(data, file="x")[0], read_sog(SCENE, file="x")[0])
    mixed = {"meta.json": parts["meta.json"], **{name.replace("png", "webp"): part for name, part in images.items()}}
    assert_same(read_sog(bundle(mixed), file="x")[0], read_sog(SCENE, file="x")[0])  # told by bytes, not by name
    for name, part in unbundle(data).items():
        (tmp_path / name).write_bytes(part)
    loaded = read_model(tmp_path)
    assert_same(loaded.model, read_sog(SCENE, file="x")[0])
    assert loaded.source_bytes == sum(map(len, unbundle(data).values()))
