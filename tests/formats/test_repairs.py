"""Every repair alone: what is mended, what is left alone bit for bit, what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from engine.errors import FormatError
from engine.formats import encode_model, read_model
from engine.formats.repairs import INFINITE_OPACITY_LOGIT, LOG_SCALE_RANGE, OPACITY_LOGIT_LIMIT, Repair, clean
from engine.model import GaussianModel, joined
from tests.formats.models import ATTRIBUTES, assert_same, random_model


def arrays_of(model: GaussianModel) -> dict[str, npt.NDArray[Any]]:
    return {name: getattr(model, name).copy() for name in ATTRIBUTES}


def run(arrays: dict[str, npt.NDArray[Any]]) -> tuple[GaussianModel, tuple[Repair, ...]]:
    return clean(*(arrays[name] for name in ATTRIBUTES), file="scene.ply")


def test_a_model_without_fault_keeps_every_bit_and_is_not_copied() -> None:
    arrays = arrays_of(random_model(3, 200000))
    model, repairs = run(arrays)
    assert repairs == ()
    for name in ATTRIBUTES:
        assert getattr(model, name) is arrays[name] or np.shares_memory(getattr(model, name), arrays[name])


def test_repairing_twice_changes_nothing() -> None:
    arrays = arrays_of(random_model(1, 1000))
    arrays["quats"] = arrays["quats"] * np.float32(3.7)
    arrays["opacity_logits"][::3] = np.inf
    arrays["log_scales"][::5] = 99
    model, repairs = run(arrays)
    assert {repair.code for repair in repairs} == {"quaternions_normalized", "opacities_infinite", "scales_clamped"}
    again, none = run(arrays_of(model))
    assert none == ()
    assert_same(again, model)


@pytest.mark.parametrize(
    ("attribute", "index", "value", "prop"),
    [
        ("means", (7, 1), np.nan, "y"),
        ("means", (7, 2), np.inf, "z"),
        ("means", (7, 0), -1e30, "x"),
        ("log_scales", (7, 2), np.nan, "scale_2"),
        ("log_scales", (7, 1), np.inf, "scale_1"),
        ("quats", (7, 3), np.nan, "rot_3"),
        ("quats", (7, 0), np.inf, "rot_0"),
        ("opacity_logits", (7,), np.nan, "opacity"),
        ("sh", (7, 0, 2), np.nan, "f_dc_2"),
        ("sh", (7, 2, 1), -np.inf, "f_rest_4"),  # channel 1 of 3 coefficients each, the second
        ("sh", (7, 3, 2), 1e20, "f_rest_8"),
    ],
)
def test_an_unusable_row_is_left_out_and_named(attribute: str, index: tuple[int, ...], value: float, prop: str) -> None:
    whole = random_model(1, 10)
    arrays = arrays_of(whole)
    arrays[attribute][index] = value
    model, repairs = run(arrays)
    assert_same(model, whole.take(np.delete(np.arange(10), 7)))
    assert [(repair.code, repair.count) for repair in repairs] == [("rows_dropped", 1)]
    assert "row 7" in repairs[0].text
    assert prop + " =" in repairs[0].text

    arrays = {name: array[7:8] for name, array in arrays.items()}
    with pytest.raises(FormatError, match="no Gaussian is usable") as caught:
        run(arrays)
    fault = caught.value
    assert (fault.file, fault.element, fault.row, fault.prop) == ("scene.ply", "vertex", 0, prop)


def test_opacities() -> None:
    arrays = arrays_of(random_model(0, 6))
    arrays["opacity_logits"][:] = [np.inf, -np.inf, 1e30, -1e30, 79, -12]
    model, repairs = run(arrays)
    infinite, limit = INFINITE_OPACITY_LOGIT, OPACITY_LOGIT_LIMIT
    expected = np.array([infinite, -infinite, limit, -limit, 79, -12], dtype=np.float32)
    np.testing.assert_array_equal(model.opacity_logits, expected)
    counts = {repair.code: repair.count for repair in repairs}
    assert counts == {"opacities_infinite": 2, "opacities_clamped": 2}
    np.testing.assert_allclose(model.opacities[:2], [511 / 512, 1 / 512], rtol=1e-6)
    assert np.rint(model.opacities[:2] * 255).tolist() == [255, 0]
    assert np.isfinite(model.opacities).all()


def test_scales() -> None:
    arrays = arrays_of(random_model(0, 3))
    arrays["log_scales"][0] = [-np.inf, 500, -500]
    model, repairs = run(arrays)
    low, high = LOG_SCALE_RANGE
    np.testing.assert_array_equal(model.log_scales[0], np.float32([low, high, low]))
    assert [(repair.code, repair.count) for repair in repairs] == [("scales_clamped", 1)]
    assert np.isfinite(model.scales**2).all()
    assert (model.scales**2 > np.finfo(np.float32).tiny).all()


def test_quaternions() -> None:
    arrays = arrays_of(random_model(0, 5))
    unit = arrays["quats"][0].copy()
    arrays["quats"][1] = 0
    arrays["quats"][2] = [0, -3e38, 0, 3e38]  # its squares overflow float32
    arrays["quats"][3] = [1e-30, 0, 0, 0]  # and these vanish in it
    arrays["quats"][4] *= 1 + 1e-7
    near = arrays["quats"][4].copy()
    model, repairs = run(arrays)
    half = np.sqrt(0.5)
    np.testing.assert_array_equal(model.quats[0], unit)
    np.testing.assert_array_equal(model.quats[4], near)
    np.testing.assert_allclose(model.quats[1:4], [[1, 0, 0, 0], [0, -half, 0, half], [1, 0, 0, 0]], rtol=1e-6)
    counts = {repair.code: repair.count for repair in repairs}
    assert counts == {"quaternions_zero": 1, "quaternions_normalized": 2}


def test_rows_are_counted_as_in_the_file() -> None:
    arrays = arrays_of(random_model(0, 10))
    arrays["means"][2] = np.nan
    arrays["quats"][5] = 0
    _, repairs = run(arrays)
    assert "row 2" in repairs[0].text
    assert "row 5" in repairs[1].text


def test_the_callers_arrays_are_left_alone() -> None:
    arrays = arrays_of(random_model(1, 10))
    arrays["means"][2], arrays["quats"][5], arrays["opacity_logits"][3] = np.nan, 0, np.inf
    before = {name: array.copy() for name, array in arrays.items()}
    run(arrays)
    for name in ATTRIBUTES:
        np.testing.assert_array_equal(arrays[name], before[name])


def test_doubles_beyond_float32_and_no_gaussians() -> None:
    arrays = {name: array.astype(np.float64) for name, array in arrays_of(random_model(0, 4)).items()}
    arrays["means"][1, 0] = 1e300
    assert len(run(arrays)[0]) == 3
    with pytest.raises(FormatError, match=r"scene\.ply, element 'vertex': holds no Gaussians"):
        run({name: array[:0] for name, array in arrays.items()})


@pytest.mark.parametrize("format", ["ply", "compressed.ply", "splat"])
def test_signalling_nan_is_no_warning(format: str) -> None:
    """Casting one raises the processor's invalid flag, which numpy turns into a warning."""
    data = encode_model(random_model(0, 300), format)
    start = data.index(b"end_header\n") + 11 if format != "splat" else 0
    data = data[:start] + b"\x01\x00\xa0\x7f" + data[start + 4 :]
    loaded = read_model(data.replace(b"property float x", b"property float32 x"))
    assert [repair.code for repair in loaded.repairs] == ["rows_dropped"]


def test_where_a_gaussian_stood_in_its_file_is_known_however_it_is_cut() -> None:
    model = random_model(0, 9)
    means = model.means.copy()
    means[[0, 4]] = np.nan
    holed, _ = clean(means, model.log_scales, model.quats, model.opacity_logits, model.sh, file="f")
    assert [holed.row_of(i) for i in range(7)] == [1, 2, 3, 5, 6, 7, 8]
    assert holed.take(np.array([5, 0])).row_of(0) == 7
    rows = joined([model, holed.take(holed.means[:, 0] < 99)]).file_rows
    assert rows is not None
    np.testing.assert_array_equal(rows.rows, [*range(9), 10, 11, 12, 14, 15, 16, 17])
    np.testing.assert_array_equal(rows.spread(np.ones(16, int), 0), [1] * 9 + [0, 1, 1, 1, 0, 1, 1, 1, 1])
    assert holed.with_(**{name: getattr(model, name) for name in ATTRIBUTES}).file_rows is None, "other rows"
