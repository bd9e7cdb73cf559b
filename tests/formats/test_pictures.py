"""Pictures as found in the wild."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, features

from engine.errors import FormatError
from engine.formats import image_files as pictures
from engine.formats.image_files import is_picture, read_picture


def test_a_model_is_no_picture(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"ply\nformat ascii 1.0\n")
    assert not is_picture(tmp_path / "a.png")


@pytest.mark.parametrize("kind", ["png", "jpeg", "bmp", "gif", "tiff", "webp", "avif"])
def test_a_picture_is_told_by_its_bytes_and_read(kind: str, tmp_path: Path) -> None:
    if kind == "avif" and not features.check("avif"):
        pytest.skip("this Pillow was built without AVIF")
    Image.new("RGB", (32, 24), (255, 128, 0)).save(tmp_path / "a", kind)
    assert is_picture(tmp_path / "a")
    np.testing.assert_allclose(read_picture(tmp_path / "a"), np.broadcast_to([1.0, 0.5, 0.0], (24, 32, 3)), atol=0.03)


def test_transparent_parts_lie_over_black(tmp_path: Path) -> None:
    Image.new("RGBA", (4, 4), (255, 255, 255, 0)).save(tmp_path / "a.png")
    assert read_picture(tmp_path / "a.png").max() == 0.0


def test_sixteen_bit_grey(tmp_path: Path) -> None:
    Image.fromarray(np.full((4, 4), 32768, dtype=np.uint16)).save(tmp_path / "a.png")
    assert np.allclose(read_picture(tmp_path / "a.png"), 0.5, atol=1e-4)


def test_phone_pictures_are_turned_upright(tmp_path: Path) -> None:
    picture = Image.new("RGB", (40, 20))
    exif = picture.getexif()
    exif[0x0112] = 6  # turned by 90 degrees
    picture.save(tmp_path / "a.jpg", exif=exif)
    assert read_picture(tmp_path / "a.jpg").shape == (40, 20, 3)


def test_damaged_and_huge_pictures_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Image.effect_noise((64, 64), 80).save(tmp_path / "a.png")
    whole = (tmp_path / "a.png").read_bytes()
    (tmp_path / "cut.png").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FormatError, match=r"cut\.png"):
        read_picture(tmp_path / "cut.png")
    monkeypatch.setattr(pictures, "MAX_PICTURE_PIXELS", 1000)
    with pytest.raises(FormatError, match="64x64"):
        read_picture(tmp_path / "a.png")
