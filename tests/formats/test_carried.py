"""What a PLY holds besides its Gaussians goes from PLY to PLY, and beside a mark only where it tells nothing of it."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import plyfile
import pytest

from engine.formats import FORMATS, encode_model, read_model
from engine.formats.file_writing import loss_note
from engine.model import SH_C0, Carried, GaussianModel
from engine.scenes.carried import revealing, without
from engine.usecases.mark import MarkOutput, MarkRequest, mark
from engine.watermark.keys import OwnerKey
from tests.scenes import sparse_plant


@pytest.fixture(scope="module")
def plant() -> GaussianModel:
    return read_model(sparse_plant("ply")).model


def carrying(model: GaussianModel, *comments: str, **columns: np.ndarray) -> GaussianModel:
    table = np.empty(len(model), [(name, values.dtype.str) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    return model.with_(carried=Carried(table, comments))


def with_extras(model: GaussianModel) -> GaussianModel:
    rng = np.random.default_rng(0)
    rows = np.arange(len(model))
    return carrying(
        model,
        "made by J\u00f6rg",
        "a  comment   with blanks \u00e0 la carte",
        label=(rows % 7).astype("u1"),
        confidence=rng.random(len(model)),
        tint=rng.integers(-9, 9, len(model)).astype("<i2"),
        nx=rng.random(len(model)).astype("<f4"),
    )


@pytest.mark.parametrize(
    ("name", "drawn"),
    [
        *[(name, True) for name in ("sg_directions_0", "f_asg_12", "sb_params_3", "sv_colors_1", "roughness", "shape")],
        *[(name, False) for name in ("label", "sgd", "obj_dc_0", "shape_id", "confidence")],
    ],
)
def test_colors_that_only_their_trainer_draws_are_told(plant: GaussianModel, name: str, drawn: bool) -> None:
    model = plant.take(np.arange(50))
    loaded = read_model(encode_model(carrying(model, **{name: np.ones(50, "<f4")}), "ply"))
    told = [each.text for each in loaded.repairs if each.code == "drawn_elsewhere"]
    assert [f"'{name}'" in text and "no mark" in text for text in told] == [True] * drawn


@pytest.mark.parametrize("order", ["<", ">", "="])
def test_every_type_comes_back_bit_for_bit(plant: GaussianModel, order: str) -> None:
    model = with_extras(plant.take(np.arange(500)))
    plain = Carried(model.carried.columns, ("by hand",))  # type: ignore[union-attr]  # plyfile takes no others
    written = plyfile.PlyData.read(io.BytesIO(encode_model(model.with_(carried=plain), "ply")))
    written.byte_order, written.text = order if order != "=" else "<", order == "="
    stream = io.BytesIO()
    written.write(stream)
    loaded = read_model(stream.getvalue())
    assert [each.code for each in loaded.repairs] == ["extra_properties"]
    again = read_model(encode_model(loaded.model, "ply")).model
    assert again.carried is not None
    assert model.carried is not None
    assert again.carried.comments == plain.comments
    assert set(again.carried.names) >= set(model.carried.names)
    for name in model.carried.names:
        assert again.carried.columns.dtype[name] == model.carried.columns.dtype[name]
        np.testing.assert_array_equal(again.carried.columns[name], model.carried.columns[name])


def test_comments_keep_their_bytes(plant: GaussianModel) -> None:
    first = encode_model(with_extras(plant.take(np.arange(9))), "ply")
    data = encode_model(read_model(first).model, "ply")  # normals stand together from now on
    assert "comment a  comment   with blanks \u00e0 la carte\n".encode() in data
    assert encode_model(read_model(data).model, "ply") == data


def test_rows_that_are_left_out_take_theirs_with_them(plant: GaussianModel) -> None:
    model = with_extras(plant.take(np.arange(100)))
    means = model.means.copy()
    means[[0, 17]] = np.nan
    read = read_model(encode_model(model.with_(means=means), "ply")).model
    assert read.carried is not None
    np.testing.assert_array_equal(read.carried.columns["label"], np.delete(np.arange(100) % 7, [0, 17]))


@pytest.mark.parametrize("kind", [kind for kind in FORMATS if kind != "ply"])
def test_every_other_format_says_what_it_dropped(plant: GaussianModel, kind: str) -> None:
    model = with_extras(plant.take(np.arange(500)))
    (told,) = (note for note in loss_note(model, kind) if "no place for what is no Gaussian's" in note)
    assert "4 properties ('label', 'confidence', 'tint', 'nx')" in told
    assert ("2 comments" in told) == (kind != "compressed.ply")
    if kind == "compressed.ply":
        read = read_model(encode_model(model, kind)).model.carried
        assert read is not None
        assert read.comments == model.carried.comments  # type: ignore[union-attr]
    assert not any("no place" in note for note in loss_note(plant, kind))


def test_what_a_thief_could_use_is_found(plant: GaussianModel) -> None:
    """Copies of colors, sizes and places, in other units, types and mixtures, under names that say nothing."""
    rng = np.random.default_rng(1)
    dc, n = plant.sh[:, 0].astype(np.float64), len(plant)
    rgb = 0.5 + SH_C0 * dc
    eighth = np.clip(np.rint(rgb * 255), 0, 255).astype("<u4")
    thefts = {
        "a1": dc[:, 0],
        "a2": eighth[:, 1].astype("u1"),
        "a3": rgb @ [0.3, 0.6, 0.1],
        "a4": dc[:, 0] - dc[:, 1],
        "a5": (eighth[:, 0] << 16) | (eighth[:, 1] << 8) | eighth[:, 2],
        "a6": -np.exp(3 * rgb[:, 2]),
        "a7": np.arctan2(dc[:, 0] - dc[:, 1], dc[:, 1] - dc[:, 2]),
        "a8": 1e6 * plant.means[:, 1].astype(np.float64) + 7,
        "a9": np.linalg.norm(plant.means - plant.means.mean(axis=0), axis=1),
        "b1": plant.log_scales.max(axis=1),
        "b2": np.exp(plant.log_scales.astype(np.float64)).prod(axis=1),
        "b3": plant.opacities,
        "b4": np.clip(np.rint(rgb[:, 0] * 63), 0, 63).astype("u1"),
        "f_rest_45": rng.random(n).astype("<f4"),
        "red": rng.integers(0, 255, n).astype("u1"),
        "orig_f_dc_0": rng.random(n).astype("<f4"),
    }
    harmless = {
        "label": (plant.means[:, 0] > 0).astype("u1"),
        "part": np.digitize(plant.means[:, 2], np.quantile(plant.means[:, 2], [0.2, 0.4, 0.6, 0.8])).astype("<i4"),
        "confidence": rng.random(n),
        "steps": rng.poisson(9, n).astype("<u2"),
        "flag": np.zeros(n, "u1"),
        "few": (rng.random(n) < 0.01).astype("u1"),
    }
    found = revealing(carrying(plant, **thefts, **harmless))
    assert set(found) == set(thefts)


def test_embed_leaves_out_what_reveals_and_says_so(tmp_path: Path, plant: GaussianModel) -> None:
    model = carrying(plant, "by hand", first=plant.sh[:, 0, 0].copy(), label=(np.arange(len(plant)) % 7).astype("u1"))
    (tmp_path / "in.ply").write_bytes(encode_model(model, "ply"))
    from engine.flows.embed.profiles import profile
    from engine.flows.embed.terms import MarkTerms

    request = MarkRequest(
        model=tmp_path / "in.ply",
        key=OwnerKey(bytes(range(32))),
        outputs={"": MarkOutput(tmp_path / "m.ply", tmp_path / "m.record")},
        terms=MarkTerms(config=profile("fast", landmark_views=0)),
    )
    (answer,) = mark(request, lambda stage, fraction: None)
    assert [note for note in answer.report.notes if "1 property ('first')" in note]
    got = read_model(tmp_path / "m.ply").model.carried
    assert got is not None
    assert (got.names, got.comments) == (("label",), ("by hand",))
    np.testing.assert_array_equal(got.columns["label"], np.arange(len(plant)) % 7)


def test_without_names_nothing_changes(plant: GaussianModel) -> None:
    assert without(plant, ["label"]) is plant
    assert revealing(plant) == []


def test_a_header_that_is_full_is_not_made_longer(plant: GaussianModel) -> None:
    full = carrying(plant, *["x" * 900] * 70, label=np.zeros(len(plant), "u1"))
    loaded = read_model(encode_model(full, "ply"))
    assert [each.code for each in loaded.repairs] == ["header_too_long"]
    assert loaded.model.carried is None
