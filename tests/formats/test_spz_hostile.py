"""SPZ against bytes that are cut, changed, or lie about their sizes."""

from __future__ import annotations

import gzip
import struct
import zlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats import zstd
from engine.formats.spz.stream import read_spz, write_spz
from tests.formats.damage import MUTATIONS, little_memory, mutated, survives
from tests.formats.spz_scenes import as_version_4, gzipped, head, plain, random_model, random_sections


@pytest.mark.parametrize("version", [3, 4])
def test_every_cut_and_every_tail_is_refused_by_name(version):
    data = write_spz(random_model(1, n=20))
    data = as_version_4(data) if version == 4 else data
    for length in range(len(data)):
        with pytest.raises(FormatError, match=r"^scan\.spz"):
            read_spz(data[:length], file="scan.spz")
    zeros = (b"\0", bytes(100)) if version == 4 else ()  # behind gzip they are padding
    for tail in (b"\1", data, bytes(100) + b"\1", *zeros):
        with pytest.raises(FormatError, match=r"^scan\.spz"):
            read_spz(data + tail, file="scan.spz")


def test_a_plain_stream_is_as_long_as_its_header_says():
    sections = random_sections(3, 1, 10, seed=0)
    data = plain(3, 10, 1, sections)
    for wrong in (*(data[:length] for length in range(len(data))), data + b"\0", plain(3, 1 << 30, 1, sections)):
        with pytest.raises(FormatError, match=r"^scan\.spz"):
            read_spz(wrong, file="scan.spz")


def test_counts_that_lie_are_refused():
    sections = random_sections(3, 0, 10, seed=0)
    for n in (0, 9, 11, 2**31, 2**32 - 1):
        with pytest.raises(FormatError):
            read_spz(gzipped(3, n, 0, sections), file="x")
    with pytest.raises(FormatError, match="holds 0 Gaussians"):
        read_spz(gzipped(3, 0, 0, [b""]), file="x")
    with pytest.raises(FormatError, match="or bytes follow"):
        read_spz(gzipped(3, 10, 0, sections) + b"more", file="x")
    with pytest.raises(FormatError, match="more than the 200 bytes"):
        read_spz(gzipped(3, 10, 0, sections) * 2, file="x")  # several members are one stream
    with pytest.raises(FormatError, match="more than the 200 bytes"):
        read_spz(gzipped(3, 10, 0, sections, bytes(8)), file="x")
    with pytest.raises(FormatError, match="claims 9 bytes"):
        read_spz(gzipped(3, 10, 0, sections, struct.pack("<II", 1, 9) + bytes(8), flags=2), file="x")
    with pytest.raises(FormatError, match="fractional bits"):
        read_spz(gzip.compress(head(3, 10, 0, bits=25) + b"".join(sections)), file="x")


@pytest.mark.parametrize(
    ("header", "what"),
    [
        (head(0, 10, 0), "version 0, read are 1 to 3"),
        (head(4, 10, 0), "version 4, read are 1 to 3, in gzip or plain"),
        (head(5, 10, 0), "version 5, read are 1 to 3"),
        (head(3, 10, 5), "degree 5, read are 0 to 4"),
        (head(3, 10, 0, flags=0x80), "levels of detail"),
    ],
)
def test_what_is_not_read_is_named(header, what):
    with pytest.raises(UnsupportedFormatError, match=what):
        read_spz(gzip.compress(header + bytes(1000)), file="x")


def test_other_files_are_no_spz():
    for data in (b"", b"ply\n", b"NGSP", gzip.compress(b"hello"), gzip.compress(b"PK" + bytes(1000)), b"\x1f\x8b"):
        with pytest.raises(FormatError):
            read_spz(data, file="x")


def test_gzip_bomb_costs_no_memory():
    """64 MB behind a header of 10 Gaussians, or of 200 M Gaussians: nothing of it is unpacked."""
    for n in (10, 200_000_000):
        bomb = gzip.compress(head(3, n, 0) + bytes(64 << 20), 9)
        assert len(bomb) < 100_000
        with little_memory(1 << 20), pytest.raises(FormatError):
            read_spz(bomb, file="x")


def packed(section: bytes) -> bytes:
    return zstd.compress(section, level=3)


def v4(n: int, sections: list[bytes], toc: list[tuple[int, int]] | None = None) -> bytes:
    entries = toc or [(len(packed(s)), len(s)) for s in sections]
    header = struct.pack("<IIIBBBBI12x", 0x5053474E, 4, n, 0, 12, 0, 5, 32)
    return header + b"".join(struct.pack("<QQ", *e) for e in entries) + b"".join(map(packed, sections))


def test_zstd_streams_that_lie_are_refused():
    n = 10
    sections = random_sections(4, 0, n, seed=0)[:5]
    assert len(read_spz(v4(n, sections), file="x")[0]) == n
    true = [(len(packed(s)), len(s)) for s in sections]
    longer = [*sections[:4], sections[4] + b"\0"]
    bomb = [*sections[:4], bytes(256 << 20)]
    shifted = [(true[0][0] - 1, true[0][1]), (true[1][0] + 1, true[1][1]), *true[2:]]
    for data in (
        v4(n + 1, sections),
        v4(n, longer),
        v4(n, longer, [*true[:4], (len(packed(longer[4])), true[4][1])]),
        v4(n, bomb, [*true[:4], (len(packed(bomb[4])), true[4][1])]),
        v4(n, sections, shifted),
        v4(n, sections, [(2**63, true[0][1]), *true[1:]]),
        v4(100_000_000, sections, [(a, b * 10_000_000) for a, b in true]),
    ):
        with little_memory(1 << 20), pytest.raises(FormatError):
            read_spz(data, file="x")


PLAIN = zlib.decompress(write_spz(random_model(1, n=12)), 31)
PACKED = {3: write_spz(random_model(1, n=12)), 4: as_version_4(write_spz(random_model(1, n=12)))}


@settings(max_examples=300)
@given(MUTATIONS, st.sampled_from(["gzip", "inside gzip", "zstd", "header", "zstd header"]))
def test_damaged_bytes_give_a_format_error_or_a_valid_model(mutations, where):
    if where == "inside gzip":
        data = gzip.compress(mutated(PLAIN, mutations), 1)
    elif where == "header":
        data = gzip.compress(mutated(PLAIN[:16], mutations) + PLAIN[16:], 1)
    elif where == "zstd header":
        data = mutated(PACKED[4][:140], mutations) + PACKED[4][140:]
    else:
        data = mutated(PACKED[3 if where == "gzip" else 4], mutations)
    survives(read_spz, data)
