from __future__ import annotations

import numpy as np
import pytest

from engine.errors import FormatError, UnsupportedFormatError
from engine.scenes.spacetime import SpacetimeModel
from engine.scenes.spacetime_ply import is_spacetime, read_spacetime_ply, write_spacetime_ply
from tests.lab.sim.variants.test_spacetime import random_clip

PUBLIC_ORDER = [
    "x",
    "y",
    "z",
    "trbf_center",
    "trbf_scale",
    "nx",
    "ny",
    "nz",
    *(f"motion_{i}" for i in range(9)),
    "f_dc_0",
    "f_dc_1",
    "f_dc_2",
    "opacity",
    "scale_0",
    "scale_1",
    "scale_2",
    "rot_0",
    "rot_1",
    "rot_2",
    "rot_3",
    "omega_0",
    "omega_1",
    "omega_2",
    "omega_3",
]


@pytest.fixture
def model() -> SpacetimeModel:
    return random_clip(6, 3)


@pytest.fixture
def data(model: SpacetimeModel) -> bytes:
    return b"".join(write_spacetime_ply(model))


def rows(data: bytes) -> tuple[int, np.ndarray]:
    start = data.index(b"end_header\n") + 11
    return start, np.frombuffer(data, "<f4", offset=start).reshape(6, 32).copy()


def test_what_is_written_reads_back_to_the_bit(model: SpacetimeModel, data: bytes) -> None:
    back, repairs = read_spacetime_ply(data, file="a.ply")
    assert repairs == ()
    for name in model.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(back, name), getattr(model, name))
    assert back.digest() == model.digest()


def test_the_file_is_laid_out_as_the_public_code_does(model: SpacetimeModel, data: bytes) -> None:
    names = [line.split()[2].decode() for line in data.split(b"\n") if line.startswith(b"property")]
    assert names == PUBLIC_ORDER
    table = rows(data)[1]
    np.testing.assert_array_equal(table[:, 17:20], model.colors)
    np.testing.assert_array_equal(table[:, 3], model.trbf_center)
    assert (table[:, 5:8] == 0).all()


def test_a_plain_ply_is_told_apart(data: bytes) -> None:
    assert is_spacetime(data)
    assert not is_spacetime(data.replace(b"trbf_center", b"some_center"))
    assert not is_spacetime(b"\x00" * 32)


def test_every_truncation_is_refused(data: bytes) -> None:
    for length in range(0, len(data), 5):
        with pytest.raises(FormatError):
            read_spacetime_ply(data[:length], file="cut.ply")
    with pytest.raises(FormatError, match="follow"):
        read_spacetime_ply(data + b"\x00", file="long.ply")


@pytest.mark.parametrize("name", ["trbf_scale", "motion_8", "omega_0", "f_dc_1", "opacity"])
def test_a_missing_property_is_named(data: bytes, name: str) -> None:
    with pytest.raises(FormatError, match=f"{name}.*missing"):
        read_spacetime_ply(data.replace(f" {name}\n".encode(), f" q{name[1:]}\n".encode(), 1), file="a.ply")


def test_a_full_model_is_refused_by_name(data: bytes) -> None:
    with pytest.raises(UnsupportedFormatError, match="network"):
        read_spacetime_ply(data.replace(b" nx\n", b" f_t_0\n").replace(b" ny\n", b" f_t_1\n"), file="full.ply")


def test_a_count_larger_than_the_file_allocates_nothing(data: bytes) -> None:
    with pytest.raises(FormatError, match="announces"):
        read_spacetime_ply(data.replace(b"vertex 6", b"vertex 999999999999"), file="bomb.ply")


def test_rows_without_numbers_are_left_out_and_reported(model: SpacetimeModel, data: bytes) -> None:
    start, table = rows(data)
    table[1, 10] = np.nan  # motion_2
    table[4, 0] = np.inf
    table[2, 20] = np.inf  # opacity of one: harmless
    table[3, 4] = 50.0  # lives for ever
    back, repairs = read_spacetime_ply(data[:start] + table.tobytes(), file="a.ply")
    np.testing.assert_array_equal(back.means, model.means[[0, 2, 3, 5]])
    assert {r.code for r in repairs} == {"rows_dropped", "opacities_infinite", "lifetimes_clamped"}
    assert back.trbf_scale[2] == 30.0
    assert np.isfinite(back.at(0.3).opacity_logits).all()


def test_nothing_usable_is_an_error(data: bytes) -> None:
    start, table = rows(data)
    table[:, 0] = np.nan
    with pytest.raises(FormatError, match="usable"):
        read_spacetime_ply(data[:start] + table.tobytes(), file="a.ply")
    empty = data[:start].replace(b"vertex 6", b"vertex 0")
    with pytest.raises(FormatError, match="no Gaussians"):
        read_spacetime_ply(empty, file="a.ply")


def test_other_properties_are_reported(model: SpacetimeModel, data: bytes) -> None:
    _, repairs = read_spacetime_ply(data.replace(b" nx\n", b" heat\n"), file="a.ply")
    assert [r.code for r in repairs] == ["extra_properties"]
    assert "heat" in repairs[0].text


def test_a_second_fault_of_a_clip_is_named_by_its_row_in_the_file(model: SpacetimeModel) -> None:
    model.means[1] = np.nan
    model.log_scales[4] = -99.0
    _, repairs = read_spacetime_ply(b"".join(write_spacetime_ply(model)), file="f")
    assert [(each.code, "row 1" in each.text, "row 4" in each.text) for each in repairs] == [
        ("rows_dropped", True, False),
        ("scales_clamped", False, True),
    ]
