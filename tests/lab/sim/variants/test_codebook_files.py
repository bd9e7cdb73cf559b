from __future__ import annotations

import io
import os
import pickle
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from engine.errors import FormatError, InputError, UnsupportedFormatError
from engine.lab.sim.variants.codebooks import make_codebook
from engine.model import GaussianModel
from engine.scenes.codebook_files import read_codebook, write_codebook
from engine.scenes.codebook_model import CodebookModel
from tests.reference.codebook_files import load_trusting

PLY, CENTERS, INDICES, ARGS = "point_cloud.ply", "kmeans_centers.pth", "kmeans_inds.bin", "kmeans_args.npy"


@pytest.fixture(scope="module")
def compressed() -> CodebookModel:
    rng = np.random.default_rng(5)
    n = 50
    model = GaussianModel(
        rng.standard_normal((n, 3)),
        rng.uniform(-5, -2, (n, 3)),
        rng.standard_normal((n, 4)),
        rng.standard_normal(n),
        rng.standard_normal((n, 9, 3)),
    )
    return make_codebook(model, {"dc": 12, "sh": 9, "scale": 5, "rot": 7})


@pytest.fixture(scope="module")
def written(compressed: CodebookModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("codebook")
    write_codebook(compressed, folder)
    return folder


@pytest.fixture
def folder(written: Path, tmp_path: Path) -> Path:
    """A copy that a test may spoil."""
    return Path(shutil.copytree(written, tmp_path / "copy"))


def test_what_is_written_reads_back(compressed: CodebookModel, written: Path) -> None:
    back = read_codebook(written)
    assert list(back.centers) == list(compressed.centers)
    for name in compressed.centers:
        np.testing.assert_array_equal(back.centers[name], compressed.centers[name])
        np.testing.assert_array_equal(back.indices[name], compressed.indices[name])
    for name in compressed.plain:
        np.testing.assert_array_equal(back.plain[name], compressed.plain[name])
    np.testing.assert_array_equal(back.decode().sh, compressed.decode().sh)


def test_the_public_loader_reads_the_same(compressed: CodebookModel, written: Path) -> None:
    for name, values in load_trusting(written).items():
        np.testing.assert_array_equal(values, compressed.centers[name][compressed.indices[name]])


def test_plain_groups_go_through_the_ply(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    model = GaussianModel(
        rng.standard_normal((30, 3)),
        rng.uniform(-5, -2, (30, 3)),
        np.tile([1, 0, 0, 0], (30, 1)),
        rng.standard_normal(30),
        rng.standard_normal((30, 4, 3)),
    )
    write_codebook(make_codebook(model, {"scale": 4}), tmp_path)
    back = read_codebook(tmp_path).decode()
    np.testing.assert_array_equal(back.sh, model.sh)
    np.testing.assert_array_equal(back.quats, model.quats)


def test_the_public_code_wastes_bits_and_is_read(compressed: CodebookModel, tmp_path: Path) -> None:
    """It takes the bits of an index from the number of Gaussians, not of codes."""
    wide = replace(compressed, index_bits=17)
    write_codebook(wide, tmp_path)
    back = read_codebook(tmp_path)
    assert back.index_bits == 17
    np.testing.assert_array_equal(back.indices["rot"], compressed.indices["rot"])


def test_the_same_model_gives_the_same_bytes(compressed: CodebookModel, written: Path, tmp_path: Path) -> None:
    size = write_codebook(compressed, tmp_path)
    assert size == sum(path.stat().st_size for path in tmp_path.iterdir())
    for name in (PLY, CENTERS, INDICES, ARGS):
        assert (tmp_path / name).read_bytes() == (written / name).read_bytes()


def test_a_marked_codebook_is_no_larger(compressed: CodebookModel, written: Path, tmp_path: Path) -> None:
    write_codebook(compressed.with_codes("dc", compressed.centers["dc"] + np.float32(0.01)), tmp_path)
    for path in written.iterdir():
        assert (tmp_path / path.name).stat().st_size == path.stat().st_size


class Bomb:
    """Runs something when unpickled by a trusting loader."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[str], Any], tuple[str]]:
        return (os.mkdir, (str(self.path),))


def save_args(folder: Path, value: object) -> None:
    stream = io.BytesIO()
    np.save(stream, np.array(value, dtype=object), allow_pickle=True)
    (folder / ARGS).write_bytes(stream.getvalue())


def test_nothing_in_the_pickle_is_run(folder: Path, tmp_path: Path) -> None:
    save_args(folder, {"params": Bomb(tmp_path / "ran"), "n_bits": 4, "total_len": 800})
    with pytest.raises(FormatError, match="mkdir"):
        read_codebook(folder)
    assert not (tmp_path / "ran").exists()
    np.load(folder / ARGS, allow_pickle=True)  # the bomb is a real one
    assert (tmp_path / "ran").exists()


def test_nothing_in_the_archive_is_run(folder: Path, tmp_path: Path) -> None:
    torch.save({"dc": Bomb(tmp_path / "ran")}, folder / CENTERS)
    with pytest.raises(FormatError, match="archive of tensors"):
        read_codebook(folder)
    assert not (tmp_path / "ran").exists()


def test_a_packed_archive_is_refused(folder: Path) -> None:
    source = zipfile.ZipFile(io.BytesIO((folder / CENTERS).read_bytes()))
    with zipfile.ZipFile(folder / CENTERS, "w", zipfile.ZIP_DEFLATED) as packed:
        for entry in source.infolist():
            packed.writestr(entry.filename, source.read(entry))
    with pytest.raises(FormatError, match="compressed archive"):
        read_codebook(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"params": ["dc", "dc", "scale", "rot"]}, "twice"),
        ({"params": "dc"}, "list"),
        ({"params": []}, "list"),
        ({"n_bits": 0}, "n_bits.*cannot be an index"),
        ({"n_bits": 99}, "n_bits"),
        ({"n_bits": "4"}, "n_bits"),
        ({"n_bits": 5}, "announces 800 bits"),
        ({"total_len": 10**12}, "announces"),
        ({"total_len": None}, "total_len"),
    ],
)
def test_arguments_that_do_not_fit_are_named(folder: Path, change: dict[str, object], message: str) -> None:
    save_args(folder, {"params": ["dc", "sh", "scale", "rot"], "n_bits": 4, "total_len": 800, **change})
    with pytest.raises(FormatError, match=message):
        read_codebook(folder)


def test_a_group_that_is_not_read_is_named(folder: Path) -> None:
    save_args(folder, {"params": ["scale_rot"], "n_bits": 4, "total_len": 200})
    with pytest.raises(UnsupportedFormatError, match="scale_rot"):
        read_codebook(folder)


@pytest.mark.parametrize("data", [b"", b"\x93NUMPY", pickle.dumps({}), b"\x93NUMPY\x01\x00\x10\x00{'descr':'|O'}  "])
def test_arguments_that_are_no_npy(folder: Path, data: bytes) -> None:
    (folder / ARGS).write_bytes(data)
    with pytest.raises(FormatError, match="cannot be read"):
        read_codebook(folder)


def test_an_index_outside_its_codebook_is_found(folder: Path) -> None:
    data = bytearray((folder / INDICES).read_bytes())
    data[0] |= 0xF0  # Gaussian 0 of "dc" now says 15 of 12
    (folder / INDICES).write_bytes(data)
    with pytest.raises(FormatError, match="element 'dc', row 0: index 15 points outside its 12 codes"):
        read_codebook(folder)


@pytest.mark.parametrize("name", [PLY, CENTERS, INDICES, ARGS])
def test_every_file_is_refused_when_cut_off(folder: Path, name: str) -> None:
    data = (folder / name).read_bytes()
    for length in range(0, len(data), max(1, len(data) // 23)):
        (folder / name).write_bytes(data[:length])
        with pytest.raises(FormatError):
            read_codebook(folder)


def test_a_centre_that_is_no_number_is_found(folder: Path) -> None:
    centers = torch.load(folder / CENTERS, weights_only=True)
    centers["rot"][3, 1] = float("nan")
    torch.save(centers, folder / CENTERS)
    with pytest.raises(FormatError, match="element 'rot', row 3"):
        read_codebook(folder)
    torch.save({name: t for name, t in centers.items() if name != "sh"}, folder / CENTERS)
    with pytest.raises(FormatError, match="element 'sh'"):
        read_codebook(folder)


def test_tensors_that_claim_more_than_they_hold_are_refused(folder: Path) -> None:
    centers = torch.load(folder / CENTERS, weights_only=True)
    centers["dc"] = torch.zeros(1).as_strided((10**9, 3), (0, 0))
    torch.save(centers, folder / CENTERS)
    with pytest.raises(FormatError, match=r"element 'dc'.*shape"):
        read_codebook(folder)


def test_missing_files_and_properties(folder: Path) -> None:
    data = (folder / PLY).read_bytes()
    (folder / PLY).write_bytes(data.replace(b"float opacity", b"float opaqueX"))
    with pytest.raises(FormatError, match="opacity"):
        read_codebook(folder)
    (folder / PLY).unlink()
    with pytest.raises(InputError, match="no such file"):
        read_codebook(folder)
