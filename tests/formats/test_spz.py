"""SPZ against its slow twin, the bytes of another writer, and hostile bytes."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

import numpy as np
import pytest

from engine.errors import FormatError, InputError
from engine.formats import encode_model
from engine.formats.ply.gaussians import read_ply
from engine.formats.spz.container import unpack
from engine.formats.spz.frames import SPECIFICATION
from engine.formats.spz.stream import read_spz, write_spz
from engine.model import GaussianModel
from tests.formats.gaussforge_child import gaussforge
from tests.formats.spz_scenes import as_version_4, frame_record, gzipped, plain, random_model, random_sections, record
from tests.reference.similarity import covariance, moved_colour, moved_covariance
from tests.reference.spherical_harmonics import sh_colour
from tests.reference.spz import decode_gaussian

TRAIN = Path(__file__).parents[1] / "data" / "train_1000.ply"


@pytest.fixture(scope="module")
def train() -> GaussianModel:
    return read_ply(TRAIN.read_bytes(), file="train")[0]


def angles(a: GaussianModel, b: GaussianModel) -> np.ndarray:
    """Degrees between the orientations; the small-angle form, as arccos has no precision near 1."""
    q, r = a.quats.astype(float), b.quats.astype(float)
    r = r * np.where((q * r).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
    return np.degrees(4 * np.arcsin(np.minimum(np.linalg.norm(q - r, axis=1) / 2, 1.0)))


@pytest.mark.parametrize("container", [gzipped, plain])
@pytest.mark.parametrize("version", [1, 2, 3])
@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4])
def test_reader_is_its_slow_twin_on_any_bytes(container, version, degree):
    n, rest = 50, (degree + 1) ** 2 - 1
    sections = random_sections(version, degree, n, seed=degree)
    sections[1] = bytes(range(1, n + 1))  # no infinite logit
    if version == 1:  # one random half float in 32 is infinite or none
        sections[0] = np.random.default_rng(degree).normal(0, 9, 3 * n).astype("<f2").tobytes()
    model, repairs = read_spz(container(version, n, degree, sections), file="x", frame="ply")
    assert len(model) == n
    assert model.sh_degree == min(degree, 3)
    reported = {r.code for r in repairs} - {"quaternions_normalized"}  # random bits may exceed the unit sphere
    assert reported == ({"degree_dropped"} if degree == 4 else set())
    for i in range(n):
        twin = decode_gaussian(sections, i, version, 12, rest)
        np.testing.assert_array_equal(model.means[i], twin["means"].astype(np.float32))
        np.testing.assert_array_equal(model.log_scales[i], twin["log_scales"].astype(np.float32))
        np.testing.assert_allclose(model.opacities[i], twin["alpha"], rtol=1e-6)
        np.testing.assert_allclose(model.sh[i, 0], twin["dc"], rtol=1e-6, atol=1e-7)
        np.testing.assert_array_equal(model.sh[i, 1:], twin["rest"][:15].astype(np.float32))
        np.testing.assert_allclose(model.quats[i], twin["quats"], atol=1e-6)


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_round_trip_errs_by_half_a_step(version, degree):
    model = random_model(degree)
    data = write_spz(model)
    back, repairs = read_spz(as_version_4(data) if version == 4 else data, file="x")
    assert repairs == ()
    step = 2.0 ** -max(12, 17 - int(np.floor(np.log2(np.abs(model.means).max()))))
    assert np.abs(back.means - model.means).max() <= step / 2 + 1e-7
    assert np.abs(back.log_scales - model.log_scales).max() <= 1 / 32 + 1e-6
    assert np.abs(back.opacities - model.opacities).max() <= 1 / 510 + 1e-6
    assert np.abs(back.sh[:, 0] - model.sh[:, 0]).max() <= 1 / 76.5 + 1e-6
    if degree:
        assert np.abs(back.sh[:, 1:] - model.sh[:, 1:]).max() <= 1 / 256 + 1e-6
    # Three components off by sqrt(1/2) / 1022 each, and the largest follows: under 0.25 degrees.
    assert 0 < angles(back, model).max() < 0.25


def test_it_holds_no_date():
    assert write_spz(random_model(2))[:8] == b"\x1f\x8b\x08\x00" + bytes(4)


def test_writer_has_the_bytes_of_gaussforge(train):
    """Same quantisation, step for step, once the frame is taken out of the comparison; GaussForge rounds harmonics to 5
    and 4 bits, and positions to 12 binary places, as this writer does with a scene of 32 units."""
    train = train.with_(means=4 * train.means, log_scales=train.log_scales + np.float32(np.log(4)))
    assert 32 < np.abs(train.means).max() < 64
    means, quats, sh = train.means.copy(), train.quats.copy(), train.sh.copy()
    SPECIFICATION.apply_signs(means, quats, sh)  # our writer will turn it back, GaussForge never turned it
    flipped = train.with_(means=means, quats=quats, sh=sh)
    ours = unpack(write_spz(flipped), file="x")
    (foreign,) = gaussforge(
        ("convert", {"data": encode_model(train, "ply"), "in_format": "ply", "out_format": "spz", "spz_version": 3})
    )
    theirs = unpack(foreign, file="x")
    assert ours.header == theirs.header
    for name, a, b in zip("pacsrh", ours.sections, theirs.sections, strict=True):
        steps = np.frombuffer(a, np.uint8).astype(int)
        if name == "h":
            buckets = np.repeat([8] * 3 + [16] * 12, 3)
            steps = np.clip((steps.reshape(-1, 45) + buckets // 2) // buckets * buckets, 0, 255).reshape(-1)
        different = steps != np.frombuffer(b, np.uint8)
        assert different.mean() < 1e-3, name  # halves may round either way


AXES = {"L": (-1, 0, 0), "R": (1, 0, 0), "D": (0, 1, 0), "U": (0, -1, 0), "F": (0, 0, 1), "B": (0, 0, -1)}
FRAMES = (
    "LDB",
    "RDB",
    "LUB",
    "RUB",
    "LDF",
    "RDF",
    "LUF",
    "RUF",
    "LFD",
    "RFD",
    "LFU",
    "RFU",
    "LBD",
    "RBD",
    "LBU",
    "RBU",
)


@pytest.mark.parametrize("number", range(1, 17))
def test_every_declared_frame_moves_geometry_and_colours_alike(number):
    """Covariances and colours of the result are those of the file, seen in PLY's axes; mirrors included."""
    n = 6
    sections = random_sections(3, 3, n, seed=number)
    sections[1] = bytes([128] * n)
    data = gzipped(3, n, 3, sections, frame_record(number), flags=2)
    raw, _ = read_spz(data, file="x", frame="ply")
    model, _ = read_spz(data, file="x")
    to_ply = np.array([AXES[a] for a in FRAMES[number - 1]], dtype=float).T
    np.testing.assert_allclose(model.means, raw.means @ to_ply.T, rtol=1e-6)
    direction = np.array([0.48, -0.6, 0.64])
    for i in range(n):
        expected = moved_covariance(raw, i, 1.0, to_ply)
        np.testing.assert_allclose(covariance(model, i), expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())
        colour = sh_colour(model.sh[i].astype(float), direction)
        np.testing.assert_allclose(colour, moved_colour(raw, i, to_ply, direction), atol=1e-5)


def test_frame_is_the_specifications_unless_the_file_or_the_caller_says_otherwise():
    model = random_model(1)
    plain, declaring = write_spz(model), as_version_4(write_spz(model))
    for data in (plain, declaring):
        auto, spec, ply = (read_spz(data, file="x", frame=f)[0] for f in ("auto", "spec", "ply"))
        np.testing.assert_array_equal(auto.means, spec.means)
        assert np.abs(auto.means - model.means).max() < 1e-3
        np.testing.assert_array_equal(ply.means, auto.means * np.array([1, -1, -1], dtype=np.float32))
    sections = random_sections(3, 0, 5, seed=1)
    in_ply_axes = gzipped(3, 5, 0, sections, record(0xADBE0002, bytes(12)) + frame_record(6), flags=2)
    np.testing.assert_array_equal(
        read_spz(in_ply_axes, file="x")[0].means, read_spz(in_ply_axes, file="x", frame="ply")[0].means
    )
    unspecified = gzipped(3, 5, 0, sections, frame_record(0), flags=2)
    np.testing.assert_array_equal(
        read_spz(unspecified, file="x")[0].means, read_spz(unspecified, file="x", frame="spec")[0].means
    )
    unknown = gzipped(3, 5, 0, sections, frame_record(17), flags=2)
    with pytest.raises(FormatError, match="declares frame 17"):
        read_spz(unknown, file="x")
    assert len(read_spz(unknown, file="x", frame="spec")[0]) == 5
    with pytest.raises(InputError, match="'rub'"):
        read_spz(plain, file="x", frame="rub")


@pytest.mark.parametrize(("reach", "bits"), [(1e-5, 24), (0.1, 21), (1.0, 17), (100.0, 12), (3000.0, 11), (1e6, 3)])
def test_fractional_bits_follow_the_size_of_the_scene(reach, bits):
    model = random_model(0)
    model = model.with_(means=model.means / np.abs(model.means).max() * reach)
    data = write_spz(model)
    assert zlib.decompress(data, 31)[13] == bits
    back, _ = read_spz(data, file="x")
    assert np.abs(back.means - model.means).max() <= 2.0**-bits / 2 * (1 + 1e-6) + reach * 1e-7


def test_writer_refuses_what_does_not_fit():
    model = random_model(0)
    far = model.with_(means=model.means * 1e9)
    with pytest.raises(InputError, match="24 bits"):
        write_spz(far)


def test_gzip_in_several_members_is_one_file():
    """As bgzip leaves it, and `cat` of parts."""
    whole = write_spz(random_model(1))
    raw = zlib.decompress(whole, 31)
    parts = b"".join(gzip.compress(raw[at : at + 5000]) for at in range(0, len(raw), 5000))
    np.testing.assert_array_equal(read_spz(parts, file="x")[0].sh, read_spz(whole, file="x")[0].sh)
    for damaged in (parts[:-20], parts + parts, parts + b"\x1f\x8bjunk"):
        with pytest.raises(FormatError):
            read_spz(damaged, file="x")


def test_extension_records_that_are_not_read_are_named() -> None:
    records = frame_record(4) + record(0xADBE0002, b"12345678")
    data = gzipped(3, 20, 0, random_sections(3, 0, 20, 0), records, flags=2)
    told = {each.code: each.text for each in read_spz(data, file="x")[1]}
    assert "0xadbe0002" in told["extra_extensions"]
