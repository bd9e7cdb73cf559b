"""Files appear whole or not at all."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError, UnsupportedFormatError
from engine.formats import FORMATS, encode_model, read_model, write_model
from engine.formats.file_writing import write_whole
from engine.formats.repairs import INFINITE_OPACITY_LOGIT
from tests.formats.models import random_model


@pytest.mark.parametrize("format", FORMATS)
def test_the_ending_chooses_the_format(tmp_path: Path, format: str) -> None:
    model = random_model(1, 300)
    path = tmp_path / f"scene.{format.upper()}"
    written = write_model(model, path)
    assert written == path.stat().st_size
    assert path.read_bytes() == encode_model(model, format)
    assert read_model(path).format == format
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("format", FORMATS)
def test_the_same_model_gives_the_same_bytes(format: str) -> None:
    assert encode_model(random_model(3, 500), format) == encode_model(random_model(3, 500), format)


@pytest.mark.parametrize("format", ["compressed.ply", "splat", "spz", "sog"])
def test_alpha_of_one_and_zero_become_finite_once(format: str) -> None:
    """In eight bits."""
    model = random_model(0, 4).with_(opacity_logits=np.array([20, -20, 0, 1]))
    loaded = read_model(encode_model(model, format))
    ends = np.sort(loaded.model.opacity_logits)[[0, 3]]
    np.testing.assert_allclose(ends, [-INFINITE_OPACITY_LOGIT, INFINITE_OPACITY_LOGIT])
    assert [(repair.code, repair.count) for repair in loaded.repairs] == [("opacities_infinite", 2)]
    again = read_model(encode_model(loaded.model, format)).model
    np.testing.assert_array_equal(np.sort(again.opacity_logits)[[0, 3]], ends)


def test_a_format_given_overrules_the_ending(tmp_path: Path) -> None:
    write_model(random_model(0, 10), tmp_path / "scene.out", "splat")
    assert read_model(tmp_path / "scene.out").format == "splat"
    with pytest.raises(UnsupportedFormatError, match=r"scene\.ksplat: the name ends in none of .*\.ply"):
        write_model(random_model(0, 10), tmp_path / "scene.ksplat")
    with pytest.raises(UnsupportedFormatError, match="'ksplat' is not written here"):
        encode_model(random_model(0, 10), "ksplat")


def test_an_empty_model_is_refused_and_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "scene.ply"
    path.write_bytes(b"old")
    with pytest.raises(InputError, match="no Gaussians"):
        write_model(random_model(0, 1).take([]), path)  # type: ignore[arg-type]
    assert path.read_bytes() == b"old"


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    def pieces() -> Iterator[bytes]:
        yield b"half of the new "
        raise KeyboardInterrupt

    path = tmp_path / "scene.ply"
    path.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt):
        write_whole(path, pieces())
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["scene.ply"]


def test_a_full_disk_is_told_and_leaves_nothing(tmp_path: Path) -> None:
    def pieces() -> Iterator[bytes]:
        yield b"half"
        raise OSError(28, "No space left on device")

    with pytest.raises(InputError, match=r"scene\.ply: cannot be written: No space left on device"):
        write_whole(tmp_path / "scene.ply", pieces())
    assert list(tmp_path.iterdir()) == []


def test_places_that_cannot_be_written(tmp_path: Path) -> None:
    model = random_model(0, 10)
    with pytest.raises(InputError, match="No such file or directory"):
        write_model(model, tmp_path / "absent" / "scene.ply")
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(InputError, match="is no regular file"):
        write_model(model, tmp_path / "folder.ply")
    with pytest.raises(InputError, match="is no file name"):
        write_model(model, "a\0b.ply")


def test_links_and_permissions_are_those_of_an_ordinary_file(tmp_path: Path) -> None:
    target, link = tmp_path / "target.ply", tmp_path / "link.ply"
    target.write_bytes(b"old")
    link.symlink_to(target)
    write_model(random_model(0, 10), link)
    assert link.is_symlink()
    assert len(read_model(target).model) == 10
    plain = tmp_path / "plain"
    plain.write_bytes(b"")
    assert stat.S_IMODE(os.stat(target).st_mode) == stat.S_IMODE(os.stat(plain).st_mode)
