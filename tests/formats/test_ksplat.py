"""Files of .ksplat against what they were made of, against GaussForge, and against damage."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats import encode_model, read_model
from engine.formats.kinds.ksplat import HEADER, SECTION_HEADER, looks_like_ksplat, read_ksplat
from engine.model import GaussianModel
from tests.formats.damage import MUTATIONS, little_memory, mutated, survives
from tests.formats.gaussforge_child import gaussforge
from tests.formats.ksplat_files import BLOCK, RANGE, in_file_order, ksplat_of, section_of
from tests.formats.models import random_model


def wide(degree: int, n: int = 700, seed: int = 0) -> GaussianModel:
    """Spread over many buckets, full and not."""
    model = random_model(degree, n, seed)
    return model.with_(means=model.means * np.float32(4))


@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_every_level_and_degree(level: int, degree: int) -> None:
    model = wide(degree)
    data = ksplat_of(section_of(model, level, bucket=16), count=700, level=level)
    loaded = read_model(data)
    assert (loaded.format, loaded.repairs) == ("ksplat", ())
    expected, found = in_file_order(model, 16), loaded.model
    place = 0.51 * (BLOCK / 2) / RANGE if level else 0.0
    np.testing.assert_allclose(found.means, expected.means, rtol=0, atol=place + 1e-6 * level)
    half = 2.0**-11 if level else 2e-7
    np.testing.assert_allclose(found.scales, expected.scales, rtol=1.1 * half)
    assert (1 - np.abs(np.einsum("ni,ni->n", found.quats, expected.quats)) < 2 * half).all()
    np.testing.assert_allclose(found.opacities, expected.opacities, atol=1.01 / 255)
    np.testing.assert_allclose(found.sh[:, 0], expected.sh[:, 0], atol=1.01 / 255 / 0.282)
    steps = {0: 1e-7, 1: 2.0**-10, 2: 3.001 / 255}[level]
    np.testing.assert_allclose(found.sh[:, 1:], np.clip(expected.sh[:, 1:], -1.5, 1.5), atol=steps)


def test_sections_of_different_degrees_and_with_room_to_spare() -> None:
    one, two = wide(0, 40), wide(2, 30, seed=1)
    parts = section_of(one, 1, room=5), section_of(two, 1)
    model = read_model(ksplat_of(*parts, count=70, level=1)).model
    assert (len(model), model.sh_degree) == (70, 2)
    assert not model.sh[:40, 1:].any()
    np.testing.assert_allclose(model.sh[40:, 1:], in_file_order(two).sh[:, 1:], atol=1e-3)


def test_bounds_of_bytes_come_from_the_header() -> None:
    model = wide(1, 50)
    bounds = (-0.5, 0.75)
    data = ksplat_of(section_of(model, 2, bounds=bounds), count=50, level=2, bounds=bounds)
    found = read_ksplat(data, file="x")[0].sh[:, 1:]
    np.testing.assert_allclose(found, np.clip(in_file_order(model).sh[:, 1:], *bounds), atol=1.26 / 255)


@pytest.mark.parametrize("degree", [0, 2])
def test_agrees_with_gaussforge(degree: int) -> None:
    """Its files are read; of its harmonics the order is another one than that of the format's own project."""
    model = random_model(degree, 300)
    arguments = {"data": encode_model(model, "ply"), "in_format": "ply", "out_format": "ksplat"}
    (answer,) = gaussforge(("convert", arguments))
    found = read_model(answer, name="theirs.ksplat").model
    order, theirs = np.argsort(model.means[:, 0]), np.argsort(found.means[:, 0])
    np.testing.assert_allclose(found.means[theirs], model.means[order], atol=2e-3)
    np.testing.assert_allclose(found.scales[theirs], model.scales[order], rtol=2e-3, atol=1e-6)
    np.testing.assert_allclose(found.opacities[theirs], model.opacities[order], atol=0.006)
    np.testing.assert_allclose(found.sh[theirs, 0], model.sh[order, 0], atol=0.02)


WHOLE = ksplat_of(section_of(wide(1, 60), 1, bucket=8), count=60, level=1)


def changed(offset: int, value: int, form: str = "<I") -> bytes:
    data = bytearray(WHOLE)
    struct.pack_into(form, data, offset, value)
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (WHOLE[:100], "its header alone takes 4096"),
        (changed(0, 1, "<B"), r"version 1\.1"),
        (changed(20, 3, "<H"), "level 3"),
        (changed(4, 0), "0 sections"),
        (changed(4, 1 << 31), "2147483648 sections"),
        (changed(16, 61), "the header says 61"),
        (changed(16, 1 << 31), "claims 2147483648 Gaussians"),
        (changed(HEADER, 61), "61 Gaussians in room for 60"),
        (changed(HEADER + 4, 1 << 31), "cut off"),
        (changed(HEADER + SECTION_HEADER, 0), "have room for"),
        (changed(HEADER + 12, 0), "other buckets of 0"),
        (changed(HEADER + 20, 16, "<H"), "16 bytes each"),
        (changed(HEADER + 40, 3, "<H"), "degree 3"),
        (changed(HEADER + 16, 0), "buckets are 0.0 wide"),
        (WHOLE[:-1], "cut off"),
        (WHOLE + b"\0", "1 bytes follow"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(data: bytes, what: str) -> None:
    with little_memory(1 << 20), pytest.raises(FormatError, match=r"^scan\.ksplat.*" + what):
        read_ksplat(data, file="scan.ksplat")


def test_it_is_told_without_a_magic_and_not_written() -> None:
    assert looks_like_ksplat(WHOLE)
    assert not looks_like_ksplat(encode_model(random_model(0, 300), "splat"))
    assert not looks_like_ksplat(bytes(HEADER + SECTION_HEADER))
    with pytest.raises(FormatError, match="its header alone"):
        read_model(WHOLE[:100], name="Scene.KSPLAT")
    with pytest.raises(UnsupportedFormatError, match="is not written here"):
        encode_model(random_model(0, 10), "ksplat")


def test_every_cut_is_refused() -> None:
    for length in range(0, len(WHOLE), 37):
        with pytest.raises(FormatError):
            read_ksplat(WHOLE[:length], file="x")


@settings(max_examples=300)
@given(MUTATIONS, st.booleans())
def test_damaged_bytes_give_a_format_error_or_a_valid_model(mutations: list[tuple[int, int]], heads: bool) -> None:
    if heads:  # the few bytes that say anything
        mutations = [(at % 44 if at % 2 else HEADER + at % 42, value) for at, value in mutations]
    survives(read_ksplat, mutated(WHOLE, mutations))
