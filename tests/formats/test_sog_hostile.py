"""SOG against archives, images and a meta.json that are damaged or lie."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.sog.bundle import read_sog, write_sog
from tests.formats.damage import MUTATIONS, mutated, survives
from tests.formats.sog_scenes import bundle, png, random_model, unbundle, webp, with_meta, with_parts, zip64

SCENE = write_sog(random_model(1))

LIES = {
    "count": [None, 0, -1, 1.5, True, "300", 301 * 4, 10**9, 10**400],
    "version": [0, 3, "2", True, [2]],
    "means": [None, [], 7],
    "means.files": [None, ["means_l.webp"], ["../means_l.webp", "means_u.webp"], ["means_l.webp", 5]],
    "quats.files": [["/etc/passwd"], ["a/b.webp"], [".."], [""], ["missing.webp"], ["meta.json"], ["q\\q.webp"]],
    "means.mins": [[0, 0], [0, 0, "0"], [0, 0, float("nan")], [0, 0, 1e40], 0, [0, 0, True]],
    "means.maxs": [[0, 0, -1e3]],
    "scales.codebook": [None, [], [0.0] * 257, ["a"] * 256, [None] * 256, [float("inf")] * 256],
    "shN": [7, {}],
    "shN.bands": [None, 2, 4, 1.0],
    "shN.count": [None, 0, 65537, 6400],
}


@pytest.mark.parametrize("member", LIES)
def test_a_meta_that_lies_is_refused_by_name(member):
    for lie in LIES[member]:
        with pytest.raises(FormatError, match=r"^scan\.sog"):
            read_sog(with_meta(SCENE, **{member: lie}), file="scan.sog")


def test_meta_must_be_json():
    parts = unbundle(SCENE)
    for text in (b"", b"[]", b"\xff", b"{", b"[" * 100_000, b'"x"', b"1" * 5000, b" " * (2 << 20)):
        with pytest.raises(FormatError):
            read_sog(bundle({**parts, "meta.json": text}), file="x")


def test_images_that_do_not_fit_are_refused():
    gray = np.zeros((20, 16, 4), dtype=np.uint8)
    huge = webp(np.zeros((4000, 4000, 3), dtype=np.uint8))
    assert len(huge) < 100_000
    good = unbundle(SCENE)["quats.webp"]
    for parts in (
        {"quats": None},
        {"quats": webp(gray[:10])},  # too few pixels
        {"quats": webp(np.zeros((40, 40, 4), dtype=np.uint8))},  # another size than the rest
        {"quats": huge},
        {"means_l": huge},
        {"shN_centroids": webp(np.zeros((4, 190, 3), dtype=np.uint8))},
        {"shN_centroids": webp(np.zeros((1, 192, 3), dtype=np.uint8))},
        {"shN_centroids": webp(np.zeros((1025, 192, 3), dtype=np.uint8))},
        {"shN_centroids": huge},
        {"sh0": b"\x89PNG"},
        {"sh0": png(gray)[:30]},
        {"sh0": png(gray)[:-30]},
        {"sh0": b""},
        {"sh0": good[:100]},
        {"sh0": good[:30] + bytes(len(good) - 30)},
    ):
        with pytest.raises(FormatError):
            read_sog(with_parts(SCENE, **parts), file="x")
    with pytest.raises(UnsupportedFormatError, match="16 bits"):
        read_sog(with_parts(SCENE, sh0=png(gray[..., 0].astype(np.uint16))), file="x")
    with pytest.raises(UnsupportedFormatError, match="lossy"):
        read_sog(with_parts(SCENE, sh0=webp(gray, lossless=False)), file="x")


def test_archives_that_lie_are_refused():
    parts = unbundle(SCENE)
    several = bundle({f"junk{i:04d}": b"" for i in range(2000)} | parts)
    twice = io.BytesIO()
    with zipfile.ZipFile(twice, "w") as archive:
        archive.writestr("meta.json", parts["meta.json"])
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("meta.json", parts["meta.json"])
    encrypted = bytearray(SCENE)
    for signature, offset in ((b"PK\x01\x02", 8), (b"PK\x03\x04", 6)):
        encrypted[encrypted.index(signature) + offset] |= 1
    for data in (
        b"",
        b"PK",
        bundle({}),
        bundle({f"{folder}/{name}": part for folder in "ab" for name, part in parts.items()}),  # which of the two?
        zip64(bundle({f"junk{i:04d}": b"" for i in range(2000)} | parts)),
        zip64(SCENE)[:-98] + zip64(SCENE)[-42:],  # without the record that its locator names
        several,
        twice.getvalue(),
        bytes(encrypted),
        SCENE[:-1],
        SCENE[: len(SCENE) // 2],
        SCENE[100:],
    ):
        with pytest.raises(FormatError):
            read_sog(data, file="x")


def test_foreign_entries_are_never_unpacked():
    """Names with paths and bombs next to the scene do no harm: they are never read."""
    extra = {"../../evil": b"x", "/etc/evil": b"x", "__MACOSX/._meta.json": b"x", "bomb": bytes(16 << 20)}
    data = bundle({**unbundle(SCENE), **extra}, zipfile.ZIP_DEFLATED)
    model, _ = read_sog(data, file="x")
    assert len(model) == 300


def test_zip_bomb_is_not_unpacked():
    parts = unbundle(SCENE)
    for name in ("meta.json", "sh0.webp"):
        bomb = bundle({**parts, name: parts[name] + bytes(32 << 20)}, zipfile.ZIP_DEFLATED)
        assert len(bomb) < 200_000
        with pytest.raises(FormatError, match=f"{name}.*at most"):
            read_sog(bomb, file="x")
        lying = bytearray(bomb)  # the directory claims less than the stream holds
        at = lying.index(b"PK\x01\x02", lying.index(name.encode()))
        while lying[at + 46 : at + 46 + len(name)] != name.encode():
            at = lying.index(b"PK\x01\x02", at + 4)
        lying[at + 24 : at + 28] = (1000).to_bytes(4, "little")
        with pytest.raises(FormatError):
            read_sog(bytes(lying), file="x")


SMALL = write_sog(random_model(1, n=20))
SMALL_PARTS = unbundle(SMALL)


@settings(max_examples=250)
@given(MUTATIONS, st.sampled_from(["archive", *sorted(SMALL_PARTS)]))
def test_damaged_bytes_give_a_format_error_or_a_valid_model(places, where):
    if where == "archive":
        survives(read_sog, mutated(SMALL, places))
    else:
        survives(read_sog, bundle({**SMALL_PARTS, where: mutated(SMALL_PARTS[where], places)}))


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)
MEMBERS = [
    "version",
    "count",
    "means",
    "means.mins",
    "means.maxs",
    "means.files",
    "scales",
    "scales.codebook",
    "quats",
    "quats.files",
    "sh0.codebook",
    "sh0.files",
    "shN",
    "shN.count",
    "shN.bands",
    "shN.codebook",
]


@settings(max_examples=150)
@given(st.sampled_from(MEMBERS), JSON)
def test_any_member_of_meta_may_be_anything(member, value):
    survives(read_sog, with_meta(SMALL, **{member: value}))


def _reencoded(scene: bytes, change: Callable[[Image.Image], bytes]) -> bytes:
    parts = unbundle(scene)
    images = {name: Image.open(io.BytesIO(part)).convert("RGBA") for name, part in parts.items() if name != "meta.json"}
    return bundle(parts | {name: change(image) for name, image in images.items()})


def _saved(image: Image.Image, kind: str = "PNG", **options: object) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


@pytest.mark.parametrize("factor", [0.5, 1.5, 2, 3])
@pytest.mark.parametrize("method", [Image.Resampling.NEAREST, Image.Resampling.BILINEAR])
def test_images_that_were_resized_are_refused_with_the_cause(factor: float, method: Image.Resampling) -> None:
    for n in (300, 3000):
        resized = _reencoded(
            write_sog(random_model(0, n)),
            lambda image: _saved(image.resize((int(image.width * factor), int(image.height * factor)), method)),
        )
        with pytest.raises(FormatError, match=r"resizing.*destroys.*export the scene again"):
            read_sog(resized, file="x")


@pytest.mark.parametrize("kind", ["JPEG", "WEBP", "lossy, then PNG", "palette", "near-lossless 80", "near-lossless 60"])
def test_images_that_were_packed_with_loss_are_refused_with_the_cause(kind: str) -> None:
    def pack(image: Image.Image) -> bytes:
        if kind == "palette":
            return _saved(image.quantize(256))
        if kind.startswith("near"):  # libwebp's rounding of what is not smooth, of 1 or 2 bits
            bits, values = (1 if "80" in kind else 2), np.asarray(image).astype(int)
            rounded = values + (1 << bits - 1) - 1 + (values >> bits & 1) >> bits << bits
            return _saved(Image.fromarray(np.minimum(rounded, 255).astype(np.uint8)))
        if kind == "lossy, then PNG":
            return _saved(Image.open(io.BytesIO(_saved(image, "WEBP", quality=95))))
        return _saved(image.convert("RGB"), kind)

    with pytest.raises(FormatError, match=r"with loss.*destroys.*export the scene again"):
        read_sog(_reencoded(write_sog(random_model(1, 3000)), pack), file="x")


def test_images_that_lost_their_transparency_are_refused() -> None:
    opaque = _reencoded(write_sog(random_model(1, 300)), lambda image: _saved(image.convert("RGB")))
    with pytest.raises(FormatError, match=r"transparency.*is gone"):
        read_sog(opaque, file="x")


def test_a_count_beyond_the_rotations_is_refused() -> None:
    scene = write_sog(random_model(0, 3000))
    with pytest.raises(FormatError, match=r"meta\.json counts too many"):
        read_sog(with_meta(scene, count=3100), file="x")
    with pytest.raises(FormatError, match=r"beyond the 500 Gaussians of meta\.json"):
        read_sog(with_meta(scene, count=500), file="x")


def test_images_packed_without_loss_are_read() -> None:
    scene = write_sog(random_model(1, 3000))
    again, _ = read_sog(_reencoded(scene, lambda image: _saved(image, optimize=True)), file="x")
    np.testing.assert_array_equal(again.means, read_sog(scene, file="x")[0].means)
