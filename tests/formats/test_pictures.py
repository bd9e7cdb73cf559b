"""Pictures as found in the wild."""

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageCms, features

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
    picture.save(tmp_path / "cut.jpg", exif=exif.tobytes()[:-8])
    with warnings.catch_warnings(action="error"):  # nothing of Pillow's on the terminal
        assert read_picture(tmp_path / "cut.jpg").shape[2] == 3


def profiled(**primaries: tuple[float, float, float]) -> bytes:
    """An ICC profile of a display with these primaries (X, Y, Z under D50) and the tone curve of sRGB."""

    def fixed(*values: float) -> bytes:
        return b"".join(struct.pack(">i", round(65536 * value)) for value in values)

    text = b"mluc\0\0\0\0" + struct.pack(">II2s2sII", 1, 12, b"en", b"US", 4, 28) + "P3".encode("utf-16-be")
    curve = b"para\0\0\0\0\0\3\0\0" + fixed(2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
    tags = {"desc": text, "cprt": text, "wtpt": b"XYZ \0\0\0\0" + fixed(0.9642, 1, 0.8249)}
    for channel, color in primaries.items():
        tags |= {f"{channel}XYZ": b"XYZ \0\0\0\0" + fixed(*color), f"{channel}TRC": curve}
    table, data = struct.pack(">I", len(tags)), b""
    for name, value in tags.items():
        table += struct.pack(">4sII", name.encode(), 132 + 12 * len(tags) + len(data), len(value))
        data += value
    head = struct.pack(">I4sI4s4s4s", 128 + len(table + data), b"lcms", 4 << 24, b"mntr", b"RGB ", b"XYZ ")
    return (head + bytes(12) + b"acsp" + bytes(28) + fixed(0.9642, 1, 0.8249)).ljust(128, b"\0") + table + data


P3 = profiled(r=(0.51512, 0.2412, -0.00105), g=(0.29198, 0.69225, 0.04189), b=(0.1571, 0.06657, 0.78407))


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "P"])
def test_a_screenshot_of_a_wide_gamut_display_is_read_as_srgb(mode: str, tmp_path: Path) -> None:
    red = Image.new("RGB", (4, 4), (234, 51, 35))  # sRGB's red
    (red.quantize(2) if mode == "P" else red.convert(mode)).save(tmp_path / "a.png", icc_profile=P3)
    read = read_picture(tmp_path / "a.png")
    np.testing.assert_allclose(read, np.broadcast_to([1.0, 0.0, 0.0], (4, 4, 3)), atol=0.04)
    unmanaged = read_picture(tmp_path / "a.png", managed=False)
    np.testing.assert_allclose(unmanaged, np.broadcast_to([234 / 255, 0.2, 35 / 255], (4, 4, 3)), atol=0.02)


def test_a_profile_leaves_transparency_and_sixteen_bits(tmp_path: Path) -> None:
    red = Image.new("RGB", (4, 4), (234, 51, 35))
    red.save(tmp_path / "keyed.png", icc_profile=P3, transparency=(234, 51, 35))
    assert read_picture(tmp_path / "keyed.png").max() == 0.0
    Image.fromarray(np.full((4, 4), 32768, dtype=np.uint16)).save(tmp_path / "deep.png", icc_profile=P3)
    assert np.allclose(read_picture(tmp_path / "deep.png"), 0.5, atol=1e-4)


@pytest.mark.parametrize("kind", ["srgb", "damaged", "gray"])
def test_a_profile_that_changes_nothing_leaves_the_values(kind: str, tmp_path: Path) -> None:
    picture = Image.effect_noise((32, 32), 80).convert("L" if kind == "gray" else "RGB")
    picture.save(tmp_path / "plain.png")
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    picture.save(tmp_path / "a.png", icc_profile=b"no profile" * 20 if kind == "damaged" else srgb)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png"), read_picture(tmp_path / "plain.png"))


def test_the_transparency_of_a_bmp_is_left_out(tmp_path: Path) -> None:
    Image.new("RGBA", (4, 4), (255, 255, 255, 0)).save(tmp_path / "a.bmp")
    assert read_picture(tmp_path / "a.bmp").min() == 1.0


def test_files_that_are_more_than_one_picture_are_refused(tmp_path: Path) -> None:
    one, other = Image.new("RGB", (32, 32)), Image.effect_noise((32, 32), 80).convert("RGB")
    for kind in ("gif", "png", "webp", "tiff"):
        one.save(tmp_path / f"a.{kind}", save_all=True, append_images=[other])
        with pytest.raises(FormatError, match=r"holds 2 pictures.*each as a PNG"):
            read_picture(tmp_path / f"a.{kind}")
    one.save(tmp_path / "phone.jpg", "MPO", save_all=True, append_images=[other])
    assert read_picture(tmp_path / "phone.jpg").max() == 0.0
    for pixels in (np.ones((4, 4), np.float32), np.ones((4, 4), np.int32)):
        Image.fromarray(pixels).save(tmp_path / "a.tif")
        with pytest.raises(FormatError, match=r"32 bits.*as PNG"):
            read_picture(tmp_path / "a.tif")
    one.save(tmp_path / "a.dng", "TIFF", tiffinfo={50706: b"\1\4\0\0"})
    with pytest.raises(FormatError, match=r"raw file.*as PNG"):
        read_picture(tmp_path / "a.dng")


def test_damaged_and_huge_pictures_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Image.effect_noise((64, 64), 80).save(tmp_path / "a.png")
    whole = (tmp_path / "a.png").read_bytes()
    (tmp_path / "cut.png").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FormatError, match=r"cut\.png"):
        read_picture(tmp_path / "cut.png")
    with pytest.raises(FormatError, match="no readable picture"):
        read_picture(b"II*\0\10\0\0\0" + bytes(6))  # Pillow's TypeError
    monkeypatch.setattr(pictures, "MAX_PICTURE_PIXELS", 1000)
    with pytest.raises(FormatError, match="64x64"):
        read_picture(tmp_path / "a.png")
