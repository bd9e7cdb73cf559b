"""Rights and provenance of glTF (KHR_xmp_json_ld): written, read back, and read with care."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.cli.app import run
from engine.errors import InputError
from engine.formats import encode_model, read_model
from engine.formats.gltf.container import pack_glb, unpack
from engine.formats.gltf.metadata import MOST_CHARACTERS, Metadata, annotate_glb, read_metadata
from engine.model import ATTRIBUTES

SMALL = Path(__file__).parents[1] / "data" / "train_1000.ply"
STATED = Metadata("© 2026 Studio Acme", "https://mark.acme.example/v1/manifests/urn:c2pa:3fad1ead")


@pytest.fixture(scope="module")
def glb() -> bytes:
    return encode_model(read_model(SMALL).model, "glb")


@pytest.mark.parametrize("stated", [STATED, Metadata(rights="all"), Metadata(provenance="https://a.example")])
def test_what_is_stated_is_read_back_and_no_gaussian_changes(stated: Metadata, glb: bytes) -> None:
    made = b"".join(annotate_glb(glb, stated))
    assert read_metadata(made, file="x") == stated
    assert read_metadata(glb, file="x") is None
    before, after = read_model(glb).model, read_model(made).model
    assert all(np.array_equal(getattr(before, name), getattr(after, name)) for name in ATTRIBUTES)
    assert made == b"".join(annotate_glb(made, stated)), "stated again it is the same file"


def test_the_file_is_as_the_specification_says(glb: bytes) -> None:
    parsed = unpack(b"".join(annotate_glb(glb, STATED)), file="x").json
    (packet,) = parsed["extensions"]["KHR_xmp_json_ld"]["packets"]
    assert parsed["asset"]["extensions"]["KHR_xmp_json_ld"] == {"packet": 0}
    assert set(parsed["extensionsUsed"]) == {"KHR_gaussian_splatting", "KHR_xmp_json_ld"}
    assert packet["dc:rights"] == {"@type": "rdf:Alt", "rdf:_1": {"@language": "x-default", "@value": STATED.rights}}
    assert {name.partition(":")[0] for name in packet if name[0] != "@"} <= packet["@context"].keys()


@pytest.mark.parametrize(
    ("packet", "rights"),
    [
        ({"dc:rights": "plain"}, "plain"),
        ({"dc:rights": {"@list": ["first", "second"]}}, "first"),
        ({"dc:rights": {"@type": "rdf:Alt", "rdf:_1": {"@language": "de", "@value": "a\x1b[2Jb"}}}, "a?[2Jb"),
        ({"dc:rights": "x" * 5000}, "x" * MOST_CHARACTERS),
    ],
)
def test_others_say_it_in_other_ways(packet: dict[str, Any], rights: str, glb: bytes) -> None:
    assert read_metadata(packed(glb, [packet], 0), file="x") == Metadata(rights)


@pytest.mark.parametrize(
    ("packets", "index"),
    [([], 0), ([{}], 1), ([{}], -1), ([{}], True), ([{}], "0"), ({}, 0), ([[]], 0), ([{"dc:rights": 7}], 0), (7, 0)],
)
def test_what_says_nothing_is_nothing(packets: object, index: object, glb: bytes) -> None:
    assert read_metadata(packed(glb, packets, index), file="x") is None


def packed(glb: bytes, packets: object, index: object) -> bytes:
    asset = unpack(glb, file="x")
    own = {"asset": {"version": "2.0", "extensions": {"KHR_xmp_json_ld": {"packet": index}}}}
    parsed = {**asset.json, **own, "extensions": {"KHR_xmp_json_ld": {"packets": packets}}}
    return b"".join(pack_glb(parsed, [bytes(asset.binary)]))


@pytest.mark.parametrize("text", ["x" * (MOST_CHARACTERS + 1), "two\nlines", "half \ud800"])
def test_a_text_that_is_no_statement_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        Metadata(rights=text)


def test_the_commands_write_and_show_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "x.glb"
    assert run(["convert", str(SMALL), str(out), "--rights", STATED.rights, "--provenance", STATED.provenance]) == 0
    assert run(["inspect", str(out)]) == 0
    assert STATED.rights in capsys.readouterr().out
    assert run(["inspect", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["metadata"] == {"rights": STATED.rights, "provenance": STATED.provenance}
    assert run(["convert", str(SMALL), str(tmp_path / "x.ply"), "--rights", "mine"]) == 2
    assert not (tmp_path / "x.ply").exists()
