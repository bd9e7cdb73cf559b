"""Outputs that appear whole or not at all, and pictures that survive the trip."""

import stat
from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.formats.image_files import is_picture, read_picture
from engine.usecases.files import refuse_same, whole_file, write_picture, write_secret
from engine.usecases.suspect import SuspectFiles


def test_whole_file_appears_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    with whole_file(target) as part:
        part.write_text("new")
        assert not target.exists()
    assert target.read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_an_interrupted_file_leaves_nothing_and_keeps_the_old(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(error), whole_file(target) as part:  # noqa: PT012
        part.write_text("half")
        raise error
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_without_overwrite_a_late_rival_wins(tmp_path: Path) -> None:
    target = tmp_path / "r.record"
    with pytest.raises(InputError, match="--force"), whole_file(target, overwrite=False) as part:  # noqa: PT012
        part.write_text("ours")
        target.write_text("theirs")
    assert target.read_text() == "theirs"
    assert list(tmp_path.iterdir()) == [target]


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"), whole_file(tmp_path / "nowhere" / "a"):
        pass


def test_secrets_are_for_the_owner_alone(tmp_path: Path) -> None:
    write_secret(tmp_path / "s", b"x")
    assert stat.S_IMODE((tmp_path / "s").stat().st_mode) == 0o600


def test_the_input_is_never_the_output(tmp_path: Path) -> None:
    source, link = tmp_path / "a.ply", tmp_path / "b.ply"
    source.write_bytes(b"x")
    link.symlink_to(source)
    with pytest.raises(InputError, match="input itself"):
        refuse_same(source, link)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.webp"])
def test_pictures_are_known_by_content_and_survive_the_trip(tmp_path: Path, name: str) -> None:
    image = np.tile(np.linspace(0, 1, 48, dtype=np.float32)[None, :, None], (32, 1, 3))
    write_picture(image, tmp_path / "x", tmp_path / name)
    assert is_picture(tmp_path / "x")
    assert np.abs(read_picture(tmp_path / "x") - image).max() < 0.02


def test_a_folder_of_frames_stands_for_its_pictures(tmp_path: Path) -> None:
    frames, model = tmp_path / "frames", tmp_path / "unpacked"
    for folder, names in ((frames, ("0002.png", "0001.png")), (model, ("means.png", "meta.json"))):
        folder.mkdir()
        for name in names:
            (folder / name).write_bytes(b"{}" if name.endswith("json") else b"\x89PNG\r\n\x1a\n\0\0\0\0")
    for name in (".hidden", "Thumbs.db", "desktop.ini"):
        (frames / name).write_bytes(b"?")
    single = tmp_path / "a.png"
    single.write_bytes((frames / "0001.png").read_bytes())
    assert SuspectFiles.sort_out([single, frames]).paths == (single, frames / "0001.png", frames / "0002.png")
