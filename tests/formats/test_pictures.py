"""Pictures as found in the wild."""

import io
import struct
import warnings
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageCms, features

from engine.errors import FormatError
from engine.formats import image_files as pictures
from engine.formats.color_coding import _PRIMARIES, Coding, coding_of
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


def png_with(values: np.ndarray, *chunks: tuple[bytes, bytes]) -> bytes:
    """A PNG of 16 bits a channel of values (H, W, 3) from 0 to 1, with chunks before its pixels."""
    levels = np.rint(np.asarray(values) * 65535).astype(">u2")
    head = struct.pack(">IIBBBBB", levels.shape[1], levels.shape[0], 16, 2, 0, 0, 0)
    body = zlib.compress(b"".join(b"\0" + row.tobytes() for row in levels))
    parts = [(b"IHDR", head), *chunks, (b"IDAT", body), (b"IEND", b"")]
    packed = (struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


# Gray of 203 (white by BT.2408), 50 and 2 cd/m2 by the tables of BT.2100, and as sRGB shows it.
PQ, HLG, SHOWN = [0.5807, 0.4403, 0.1882], [0.75, 0.4971, 0.13], [1.0, 0.5334, 0.0989]


@pytest.mark.parametrize(("transfer", "signal"), [(16, PQ), (18, HLG)])
def test_hdr_screenshots_are_read_as_srgb(transfer: int, signal: list[float], tmp_path: Path) -> None:
    gray = np.repeat(np.array(signal)[None, :, None], 3, axis=2)
    data = png_with(gray, (b"cICP", bytes([9, transfer, 0, 1])))
    np.testing.assert_allclose(read_picture(data)[0, :, 1], SHOWN, atol=0.03)
    np.testing.assert_allclose(read_picture(data, managed=False)[0, :, 1], signal, atol=0.01)
    # BT.709's red in the primaries of BT.2020, at white's luminance (BT.2087)
    red = np.array([0.6274, 0.0691, 0.0164])
    pq = ((0.8359375 + 18.8515625 * (y := (red * 0.0203) ** 0.15930176)) / (1 + 18.6875 * y)) ** 78.84375
    data = png_with(
        np.broadcast_to(pq, (2, 2, 3)), (b"cICP", bytes([9, 16, 0, 1])), (b"iCCP", b"x\0\0" + zlib.compress(P3))
    )
    np.testing.assert_allclose(read_picture(data)[0, 0], [1, 0, 0], atol=0.05)


def test_a_page_that_an_hdr_desktop_shows_brighter_is_scaled_to_white() -> None:
    signal = np.full((40, 40, 3), 0.6722)  # 480 cd/m2
    signal[:20] = 0.5400  # 137 cd/m2: 0.285 of it
    signal[39, 39] = 0.9  # one glint
    read = read_picture(png_with(signal, (b"cICP", bytes([9, 16, 0, 1]))))
    np.testing.assert_allclose([read[0, 0, 0], read[30, 0, 0]], [0.571, 1.0], atol=0.02)


def test_all_bits_of_a_picture_are_read(tmp_path: Path) -> None:
    ramp = np.linspace(0.25, 0.26, 64)[None, :, None] + np.array([0, 0.1, 0.2])  # 2.5 steps of 8 bits
    np.testing.assert_allclose(read_picture(png_with(ramp)), ramp, atol=2e-5)
    hdr = read_picture(png_with(ramp, (b"cICP", bytes([9, 16, 0, 1]))))[0, :, 2]
    assert (np.diff(hdr) > 0).all()
    for turn, expected in ((6, np.rot90(ramp, -1)), (5, ramp.swapaxes(0, 1)), (7, ramp[::-1, ::-1].swapaxes(0, 1))):
        exif = b"MM\0*\0\0\0\x08\0\1\1\x12\0\3\0\0\0\1" + struct.pack(">HHI", turn, 0, 0)
        np.testing.assert_allclose(read_picture(png_with(ramp, (b"eXIf", exif))), expected, atol=2e-5)
    # half transparent, over black
    levels = np.rint(np.dstack([ramp[..., ::-1], np.full(ramp.shape[:2], 0.5)]) * 65535).astype(np.uint16)
    (tmp_path / "a.png").write_bytes(cv2.imencode(".png", levels)[1])
    np.testing.assert_allclose(read_picture(tmp_path / "a.png"), ramp / 2, atol=3e-5)


def tiff_with(values: np.ndarray, orientation: int = 1, opacity: int = 2) -> bytes:
    """An uncompressed TIFF of 16 bits a channel of values (H, W, C) from 0 to 1; a fourth one is opacity."""
    height, width, channels = values.shape
    levels = np.rint(values * 65535).astype("<u2").tobytes()
    tags = {256: width, 257: height, 259: 1, 262: 2 if channels > 1 else 1, 274: orientation, 277: channels}
    tags |= {278: height, 279: len(levels), 284: 1} | ({338: opacity} if channels == 4 else {})
    bits_at = 8 + 2 + 12 * (len(tags) + 2) + 4
    tags |= {258: 16 if channels == 1 else bits_at, 273: bits_at + 8}
    entries = b"".join(
        struct.pack("<HHII", tag, 3 if tag == 258 else 4, channels if tag == 258 else 1, tags[tag])
        for tag in sorted(tags)
    )
    return (
        b"II*\0\x08\0\0\0" + struct.pack("<H", len(tags)) + entries + bytes(4) + struct.pack("<4H", *[16] * 4) + levels
    )


RAMP = np.linspace(0.25, 0.26, 64)[None, :, None] + np.array([0, 0.1, 0.2])  # 2.5 steps of 8 bits


def test_all_bits_of_a_tiff_are_read() -> None:
    for turn, expected in (
        (1, RAMP),
        (6, np.rot90(RAMP, -1)),
        (5, RAMP.swapaxes(0, 1)),
        (7, RAMP[::-1, ::-1].swapaxes(0, 1)),
    ):
        np.testing.assert_allclose(read_picture(tiff_with(RAMP, turn)), expected, atol=2e-5)
    clear = np.dstack([RAMP, np.full(RAMP.shape[:2], 0.5)])
    np.testing.assert_allclose(read_picture(tiff_with(clear)), RAMP / 2, atol=3e-5)
    half = np.dstack([RAMP / 2, np.full(RAMP.shape[:2], 0.5)])  # colors that are multiplied by their opacity already
    np.testing.assert_allclose(read_picture(tiff_with(half, opacity=1)), RAMP / 2, atol=2 / 255)
    np.testing.assert_allclose(read_picture(tiff_with(RAMP[..., :1]))[..., 2], RAMP[..., 0], atol=2e-5)


def test_all_bits_of_a_picture_with_a_profile_are_read() -> None:
    """By the primaries of Display P3, in closed form; sRGB's own profile changes nothing."""
    packed = zlib.compress(P3)
    read = read_picture(png_with(RAMP, (b"iCCP", b"x\0\0" + packed)))
    wanted = Coding(_PRIMARIES[12]).to_srgb(RAMP.astype(np.float32))
    np.testing.assert_allclose(read, wanted, atol=1.2 / 255)
    for channel in range(3):
        assert len(np.unique(read[0, :, channel])) > 32  # 8 bits have 4
    same = zlib.compress(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    near = zlib.compress(profiled(r=(0.4500, 0.2225, 0.0139), g=(0.3851, 0.7169, 0.0971), b=(0.1431, 0.0606, 0.7141)))
    for profile in (same, near):
        np.testing.assert_allclose(read_picture(png_with(RAMP, (b"iCCP", b"x\0\0" + profile))), RAMP, atol=2e-5)


def test_all_bits_of_a_picture_with_a_transparent_color_are_read() -> None:
    key = np.rint(RAMP[0, 5] * 65535).astype(int)
    read = read_picture(png_with(RAMP, (b"tRNS", struct.pack(">3H", *key))))
    np.testing.assert_allclose(np.delete(read, 5, axis=1), np.delete(RAMP, 5, axis=1), atol=2e-5)
    assert (read[0, 5] == 0).all()
    gray = Image.fromarray(np.array([[100, 30000, 30001]], np.uint16))
    file = io.BytesIO()
    gray.save(file, "PNG", transparency=30000)
    np.testing.assert_allclose(read_picture(file.getvalue())[0, :, 1], [100 / 65535, 0, 30001 / 65535], atol=1e-6)


@pytest.mark.parametrize("bits", [10, 12])
def test_all_bits_of_an_avif_are_read(bits: int) -> None:
    ramp = np.linspace(0.25, 0.26, 64)[None, :, None] + np.array([0, 0.1, 0.2])
    levels = np.rint(np.repeat(ramp[..., ::-1], 16, axis=0) * (2**bits - 1)).astype(np.uint16)
    try:
        made, data = cv2.imencode(".avif", levels, [cv2.IMWRITE_AVIF_DEPTH, bits, cv2.IMWRITE_AVIF_QUALITY, 100])
    except cv2.error:
        pytest.skip("this OpenCV was built without AVIF")
    assert made
    np.testing.assert_allclose(read_picture(data.tobytes())[8], ramp[0], atol=1 / 2**bits)


def test_a_color_profile_counts_before_an_avifs_own_code_points() -> None:
    head = b"colrnclx" + bytes([0, 9, 0, 16])
    assert coding_of(head, {}) is not None
    assert coding_of(head, {"icc_profile": b"some"}) is None


def test_white_stays_white_whatever_its_point() -> None:
    """Theater screens (P3-DCI) have a greener one."""
    read = coding_of(b"\0\0\0\4cICP" + bytes([11, 13, 0, 1]), {})
    assert read is not None
    np.testing.assert_allclose(read.to_srgb(np.ones((1, 1, 3), np.float32)), 1.0, atol=1e-3)
    np.testing.assert_allclose(read.to_srgb(np.full((1, 1, 3), 0.5, np.float32)), 0.5, atol=1e-3)


def test_other_codings_of_png_and_avif(tmp_path: Path) -> None:
    half = np.full((4, 4, 3), 0.5)
    for chunks, expected in (
        ([(b"gAMA", struct.pack(">I", 100_000))], 0.735),  # linear light
        ([(b"cICP", bytes([1, 8, 0, 1]))], 0.735),
        ([(b"gAMA", struct.pack(">I", 45_455))], 0.5),
        ([(b"gAMA", struct.pack(">I", 100_000)), (b"sRGB", b"\0")], 0.5),
        ([(b"cICP", bytes([1, 13, 0, 1]))], 0.5),
        ([(b"cICP", bytes([12, 13, 0, 1]))], 0.5),
        ([(b"cICP", bytes([77, 99, 0, 1]))], 0.5),
        ([(b"cICP", bytes([2, 4, 0, 1]))], 0.5 ** (2.2 / 2.4) * 1.055 - 0.055),
        ([(b"gAMA", struct.pack(">I", 0))], 0.5),
    ):
        np.testing.assert_allclose(read_picture(png_with(half, *chunks)), expected, atol=0.01, err_msg=str(chunks))
    if features.check("avif"):
        buffer = io.BytesIO()
        Image.new("RGB", (16, 16), (112, 112, 112)).save(buffer, "AVIF", quality=100)
        plain = buffer.getvalue()
        at = plain.index(b"colrnclx") + 8
        unspecified = plain[:at] + struct.pack(">HH", 2, 2) + plain[at + 4 :]
        np.testing.assert_array_equal(read_picture(unspecified), read_picture(plain))
        np.testing.assert_allclose(read_picture(plain), 0.44, atol=0.02)
        hdr = plain[:at] + struct.pack(">HH", 9, 16) + plain[at + 4 :]
        np.testing.assert_allclose(read_picture(hdr), SHOWN[1], atol=0.03)


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


def test_kinds_that_are_not_read_are_named(tmp_path: Path) -> None:
    (tmp_path / "photo.CR2").write_bytes(b"II*\0\x10\0\0\0CR\2\0" + bytes(200))
    with pytest.raises(FormatError, match=r"raw file.*as PNG"):
        read_picture(tmp_path / "photo.CR2")
    (tmp_path / "half.tif").write_bytes(b"II*\0\x10\0\0\0" + bytes(200))
    with pytest.raises(FormatError, match=r"of a kind that is not read.*as PNG"):
        read_picture(tmp_path / "half.tif")
    # 16 bits a channel, red after green after blue: of width and height 1, uncompressed
    tags = [(256, 3, 1, 1), (257, 3, 1, 1), (258, 3, 3, 134), (259, 3, 1, 1), (262, 3, 1, 2), (273, 3, 3, 140)]
    tags += [(277, 3, 1, 3), (279, 3, 3, 146), (284, 3, 1, 2), (278, 3, 1, 1)]
    rows = b"".join(struct.pack("<HHII", *tag) for tag in sorted(tags))
    body = struct.pack("<9H", 16, 16, 16, 152, 154, 156, 2, 2, 2) + bytes(6)
    with pytest.raises(FormatError, match="one after another"):
        read_picture(b"II*\0\10\0\0\0" + struct.pack("<H", len(tags)) + rows + bytes(4) + body)


@pytest.mark.skipif(not features.check("avif"), reason="this Pillow was built without AVIF")
def test_an_avif_may_name_its_kind_second(tmp_path: Path) -> None:
    Image.new("RGB", (32, 24), (255, 128, 0)).save(tmp_path / "a.avif")
    data = (tmp_path / "a.avif").read_bytes()
    (tmp_path / "b.avif").write_bytes(data[:8] + b"mif1" + data[12:])
    assert is_picture(tmp_path / "b.avif")
    assert read_picture(tmp_path / "b.avif").shape == (24, 32, 3)


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
