"""How a model is to be drawn: said in every format that has a word for it, and nothing lost that moves or widens it."""

from __future__ import annotations

import json
import zipfile
import zlib
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats import encode_model, read_model
from engine.formats.file_writing import loss_note
from engine.formats.modes import mode_of_comments
from engine.formats.spz.stream import read_spz, write_spz
from engine.numerics.gaussians import flatten
from tests.formats.models import assert_same, names_of, ply_of, random_model, rows_for
from tests.formats.sog_scenes import with_meta
from tests.formats.spz_scenes import as_version_4

SAID = ("ply", "compressed.ply", "spz", "sog")


@pytest.mark.parametrize(
    ("comments", "mode"),
    [
        (["SplatRenderMode: mip"], "antialiased"),
        (["SplatRenderMode: default"], None),
        (["SplatRenderMode: 2dgs"], "2dgs"),
        (["antialiased 1"], "antialiased"),
        (["antialiased 0"], None),
        (["SPLATRENDERMODE:  MIP  "], "antialiased"),
        (["Exported from Brush", "SH degree: 3"], None),
        (["SplatRenderMode: banana"], None),
        (["antialiased 1", "SplatRenderMode: default"], None),
        (["SplatRenderMode: default", "antialiased 1"], "antialiased"),
        ([], None),
    ],
)
def test_comments_as_splat_transform_reads_them(comments: list[str], mode: str | None) -> None:
    assert mode_of_comments(comments) == mode


@pytest.mark.parametrize("kind", SAID)
def test_the_tag_is_kept(kind: str) -> None:
    plain, tagged = random_model(1), replace(random_model(1), antialiased=True)
    data = encode_model(tagged, kind)
    loaded = read_model(data)
    assert loaded.model.antialiased
    assert read_model(encode_model(loaded.model, kind)).model.antialiased
    assert not read_model(encode_model(plain, kind)).model.antialiased
    assert_same(loaded.model, read_model(encode_model(plain, kind)).model)
    assert not any("antialiased" in note for note in loss_note(tagged, kind))


def test_the_tag_is_where_others_look_for_it() -> None:
    tagged = replace(random_model(1), antialiased=True)
    for kind in ("ply", "compressed.ply"):
        assert b"\ncomment SplatRenderMode: mip\n" in encode_model(tagged, kind)
        assert b"comment" not in encode_model(random_model(1), kind)
    with zipfile.ZipFile(BytesIO(encode_model(tagged, "sog"))) as archive:
        meta = json.loads(archive.read("meta.json"))
        assert (meta["model"], meta["antialias"]) == ("antialiased", True)
    with zipfile.ZipFile(BytesIO(encode_model(random_model(1), "sog"))) as archive:
        assert "model" not in json.loads(archive.read("meta.json"))
    assert zlib.decompress(write_spz(tagged), 31)[14] == 0x01
    assert read_spz(as_version_4(write_spz(tagged)), file="x")[0].antialiased


@pytest.mark.parametrize(
    ("said", "antialiased"),
    [({"antialias": True}, True), ({"antialias": False}, False), ({"antialias": 1}, False), ({}, False)],
)
def test_the_flag_of_sog_is_believed_and_kept(said: dict[str, object], antialiased: bool) -> None:
    read = read_model(with_meta(encode_model(random_model(1), "sog"), **said)).model
    assert read.antialiased is antialiased
    assert read_model(encode_model(read, "spz")).model.antialiased is antialiased


def test_what_cannot_say_it_is_noted() -> None:
    assert "SplatRenderMode: mip" in loss_note(replace(random_model(0), antialiased=True), "splat")[0]
    assert loss_note(random_model(0), "splat") == []


@pytest.mark.parametrize("kind", ["compressed.ply", "sog"])
def test_discs_stay_discs_where_the_format_has_a_word_for_them(kind: str) -> None:
    discs = flatten(random_model(1))
    back = read_model(encode_model(discs, kind)).model
    assert back.is_flat
    assert not back.antialiased
    assert not any("discs" in note for note in loss_note(discs, kind))
    assert not read_model(encode_model(random_model(1), kind)).model.is_flat


@pytest.mark.parametrize("kind", ["splat", "spz"])
def test_only_ply_has_the_two_scales_of_discs(kind: str) -> None:
    discs = flatten(random_model(0))
    assert loss_note(discs, "ply") == []
    note = next(note for note in loss_note(discs, kind) if "2DGS" in note)
    assert ("as thin as it allows" in note) == (kind == "spz")


def test_two_scales_outrank_a_comment() -> None:
    data = ply_of(names_of(0, scales=2), rows_for(names_of(0, scales=2), 20))
    said = data.replace(b"element", b"comment SplatRenderMode: mip\nelement", 1)
    assert read_model(said).model.is_flat
    assert not read_model(said).model.antialiased


def test_the_filter_of_mip_splatting_is_folded_in() -> None:
    """Against `create_fused_ply` of its public code, in float64: a variance each, and the root of the determinants."""
    names = [*names_of(1), "filter_3D"]
    rows = rows_for(names, 200)
    rows[:, names.index("filter_3D")] = np.abs(rows[:, names.index("filter_3D")])
    rows[0, names.index("filter_3D")] = 0.0
    loaded = read_model(ply_of(names, rows))
    scale = np.exp(rows[:, [names.index(f"scale_{i}") for i in range(3)]].astype(np.float64))
    width = rows[:, names.index("filter_3D")].astype(np.float64)
    opacity = 1 / (1 + np.exp(-rows[:, names.index("opacity")].astype(np.float64)))
    wider = np.square(scale) + np.square(width)[:, None]
    faded = opacity * np.sqrt(np.square(scale).prod(axis=1) / wider.prod(axis=1))
    np.testing.assert_allclose(loaded.model.scales, np.sqrt(wider), rtol=2e-6)
    np.testing.assert_allclose(loaded.model.opacities, faded, rtol=2e-5)
    assert loaded.model.antialiased
    assert [repair.code for repair in loaded.repairs if "filter" in repair.code] == ["filter_fused"]
    rows[:, names.index("filter_3D")] = np.nan
    with pytest.raises(FormatError):
        read_model(ply_of(names, rows))


@pytest.mark.parametrize(
    "moving",
    [
        ["trbf_center", "trbf_scale", *(f"motion_{i}" for i in range(9)), *(f"omega_{i}" for i in range(4))],
        ["t", "scale_t_0", *(f"rot_r_{i}" for i in range(4))],
        ["mu_t", "t_scale", *(f"rot_l_{i}" for i in range(4))],
        ["vx", "vy", "vz", "time", "duration"],
        ["velocity_x", "velocity_y", "velocity_z"],
        ["delta_x_t0", "delta_rot_0_t0"],
        ["f_t_0"],
    ],
)
def test_motion_is_refused_by_name(moving: list[str]) -> None:
    names = [*names_of(1), *moving]
    with pytest.raises(UnsupportedFormatError, match="the Gaussians move") as caught:
        read_model(ply_of(names, rows_for(names, 5)), name="clip.ply")
    assert all(repr(name) in str(caught.value) for name in moving[:8])


def test_harmless_extras_are_no_motion() -> None:
    names = [*names_of(1), "label", "confidence", "vertex_index", "tags", "nxx"]
    assert len(read_model(ply_of(names, rows_for(names, 5))).model) == 5


def test_indices_into_codebooks_are_refused_by_name() -> None:
    names = names_of(1)
    data = ply_of(names, rows_for(names, 5))
    changed = data.replace(b"element vertex", b"element codebook_centers 0\nproperty float a\nelement vertex", 1)
    with pytest.raises(UnsupportedFormatError, match="indices into codebooks"):
        read_model(changed)
    bare = [name for name in names if not name.startswith("f_dc")]
    with pytest.raises(FormatError, match="give the folder"):
        read_model(ply_of(bare, rows_for(bare, 5)))
