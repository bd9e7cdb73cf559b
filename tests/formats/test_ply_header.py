"""Hostile PLY headers: a named error in no time, or a model; nothing else."""

from __future__ import annotations

import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import FormatError
from engine.formats import encode_model, read_model
from engine.formats.ply.header import MAX_HEADER_BYTES, parse_header
from tests.formats.damage import little_memory
from tests.formats.models import header_for, names_of, ply_of, random_model, rows_for

NAMES = names_of(0)
START = "ply\nformat binary_little_endian 1.0\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ply\n", "cut off"),
        ("ply\nend_header\n", "no 'format' line"),
        (START + "end_header\n", "no element"),
        (START + "element vertex 1\nend_header\n", "element 'vertex': has no properties"),
        (START + "property float x\nend_header\n", "property 'x': announced before any element"),
        (START + "element vertex 1\nproperty float x\nproperty int x\n", "property 'x': announced twice"),
        (START + "element vertex 1\nelement vertex 1\n", "element 'vertex': announced twice"),
        (START + "element vertex -1\n", "'-1' is no number of rows"),
        (START + "element vertex 1e9\n", "'1e9' is no number of rows"),
        (START + "element vertex \u0661\n", "is no number of rows"),
        (START + f"element vertex {'9' * 60000}\n", "is no number of rows"),
        (START + "element vertex 1\nproperty quad x\n", "property 'x': unknown type 'quad'"),
        (START + "element vertex 1\nproperty list uchar quad x\n", "property 'x': unknown type 'quad'"),
        (START + "element vertex 1\nproperty float\n", "cannot read the header line 'property float'"),
        (START + "\x1b[31mred\n", r"cannot read the header line '\\x1b\[31mred'"),
        (START + "\n", "no line .end_header."),
        (START + START[4:], "two 'format' lines"),
        ("ply\nformat binary_middle_endian 1.0\n", "unknown encoding 'binary_middle_endian'"),
        ("ply\nformat ascii 2.0\n", "version '2.0' is not read here"),
        ("plyx\nformat ascii 1.0\n", "is text, no model"),
        ("ply\rformat ascii 1.0\r", "cut off"),
    ],
)
def test_every_fault_is_named(text: str, message: str) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        read_model(text.encode(), name="hostile.ply")
    assert str(caught.value).startswith("hostile.ply")
    assert len(str(caught.value)) < 300


def test_a_header_beyond_64_kilobytes_is_refused() -> None:
    data = ply_of(NAMES, rows_for(NAMES, 1))
    comment = b"comment " + b"x" * (MAX_HEADER_BYTES - 1000) + b"\n"
    assert len(read_model(data.replace(b"element", comment + b"element", 1)).model) == 1
    with pytest.raises(FormatError, match="longer than 65536 bytes"):
        read_model(data.replace(b"element", comment + comment + b"element", 1))


@pytest.mark.parametrize("line", ["property float p{}\n", "element e{} 1\nproperty char a\n", "comment {}\n"])
def test_a_crowded_header_costs_no_time(line: str) -> None:
    text = START + "element vertex 1\nproperty float x\n"
    k = 0
    while len(text) < MAX_HEADER_BYTES - 100:
        text += line.format(k)
        k += 1
    began = time.process_time()
    with pytest.raises(FormatError):
        read_model((text + "end_header\n").encode() + bytes(200000))
    assert time.process_time() - began < 2


@pytest.mark.parametrize("encoding", ["binary_little_endian", "ascii"])
@pytest.mark.parametrize("count", ["1000000000", "999999999999999"])
def test_a_count_allocates_nothing(encoding: str, count: str) -> None:
    data = header_for(NAMES, 1, encoding, count=count) + b"0 " * 1000
    with little_memory(1 << 20), pytest.raises(FormatError):
        read_model(data)


def test_offsets_and_strides() -> None:
    text = START + "element a 3\nproperty double d\nproperty uchar c\nelement b 2\nproperty short s\nend_header\n"
    header = parse_header(text.encode(), file="x")
    assert [(e.name, e.count, e.stride) for e in header.elements] == [("a", 3, 9), ("b", 2, 2)]
    assert header.size == len(text)


KEYWORDS = "ply format ascii binary_little_endian binary_big_endian 1.0 element property list end_header comment"
TYPES = "float uint uchar double"
OTHERS = "vertex chunk sh x packed_position min_x f_rest_0 0 1 3 99999999999 -1"
WORDS = st.sampled_from([*f"{KEYWORDS} {TYPES} {OTHERS}".split(), *NAMES, "\n", "\n", "\n", "\r\n", " "])


@settings(max_examples=300, deadline=5000)
@given(st.lists(WORDS, max_size=60), st.binary(max_size=200))
def test_random_headers(words: list[str], body: bytes) -> None:
    text = "ply\n" + " ".join(words) + "\nend_header\n"
    survives(text.encode() + body)


VALID = [
    ply_of(NAMES, rows_for(NAMES, 3)),
    header_for(NAMES, 2, "ascii") + (" ".join("1" for _ in NAMES) + "\n").encode() * 2,
    encode_model(random_model(1, 3), "compressed.ply"),
    header_for(names_of(1), 2, "binary_big_endian") + rows_for(names_of(1), 2).astype(">f4").tobytes(),
]


@settings(max_examples=400, deadline=5000)
@given(st.data())
def test_mutated_files(data: st.DataObject) -> None:
    """Bytes overwritten, dropped and doubled, in headers and bodies of every encoding."""
    valid = data.draw(st.sampled_from(VALID))
    content = bytearray(valid)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        kind = data.draw(st.sampled_from(["overwrite", "drop", "double"]))
        if kind == "overwrite":
            content[at] = data.draw(st.integers(0, 255))
        elif kind == "drop":
            del content[at : at + data.draw(st.integers(1, 20))]
        else:
            content[at:at] = content[at : at + data.draw(st.integers(1, 50))]
        if not content:
            break
    survives(bytes(content))


def survives(content: bytes) -> None:
    try:
        model = read_model(content, name="x.ply").model
    except FormatError as error:
        fault = str(error)
    else:
        fault = "" if len(model) else "a model without Gaussians"
    assert fault == "" or fault.startswith("x.ply")
