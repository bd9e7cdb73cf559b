"""Severities of other papers: each does what its strength says, measured on the parameters."""

from __future__ import annotations

import numpy as np
import pytest

from engine.flows.views.camera_rig import measure_extent
from engine.lab.sim.attacks import model_attack
from engine.model import SH_C0, GaussianModel


def run(name: str, model: GaussianModel, strength: float, reading: str | None = None) -> GaussianModel:
    return model_attack(name).apply(model, strength, rng=4, reading=reading)


def untouched(before: GaussianModel, after: GaussianModel, *but: str) -> None:
    for name in {"means", "log_scales", "quats", "opacity_logits", "sh"} - set(but):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))


def test_inject_appends_gaussians_of_the_same_kind(model: GaussianModel) -> None:
    out = run("inject", model, 0.3)
    assert len(out) == 650
    untouched(model, out.take(np.arange(500)))
    new = out.take(np.arange(500, 650))
    known = {row.tobytes() for row in model.log_scales}
    assert all(row.tobytes() in known for row in new.log_scales)
    apart = np.linalg.norm(new.means[:, None] - model.means[None], axis=2).min(axis=1)
    assert 0 < np.median(apart) < 0.05 * measure_extent(model).radius


def test_dc_noise_is_in_units_of_color(model: GaussianModel) -> None:
    out = run("noise_dc", model, 0.05)
    error = SH_C0 * (out.sh[:, 0] - model.sh[:, 0])
    assert error.std() == pytest.approx(0.05, rel=0.06)
    np.testing.assert_array_equal(out.sh[:, 1:], model.sh[:, 1:])
    untouched(model, out, "sh")


def test_opacity_noise_is_in_units_of_opacity(model: GaussianModel) -> None:
    out = run("noise_opacity", model, 0.02)
    free = (model.opacities > 0.1) & (model.opacities < 0.9)
    assert (out.opacities - model.opacities)[free].std() == pytest.approx(0.02, rel=0.15)
    assert run("noise_opacity", model, 0.5).opacities.min() > 1 / 300
    untouched(model, out, "opacity_logits")


def test_position_noise_is_in_radii(model: GaussianModel) -> None:
    out = run("noise_position", model, 0.01)
    radius = measure_extent(model).radius
    assert (out.means - model.means).std() == pytest.approx(0.01 * radius, rel=0.06)
    untouched(model, out, "means")


@pytest.mark.parametrize(
    ("name", "strength", "field", "std"),
    [("translate", 1.0, "means", 1.0), ("noise_means", 0.5, "means", 0.5), ("noise_colors", 8.0, "sh", 8.0)],
)
def test_gaussian_marker_scatters(name: str, strength: float, field: str, std: float, model: GaussianModel) -> None:
    out = run(name, model, strength, "as_code")
    change = getattr(out, field) - getattr(model, field)
    change = change[:, 0] if field == "sh" else change
    assert change.std() == pytest.approx(std, rel=0.06)
    untouched(model, out, field)


def test_gaussian_marker_turns_centres_by_any_matrix(model: GaussianModel) -> None:
    out = run("rotate", model, 1.0, "as_code")
    matrix, *_ = np.linalg.lstsq(model.means.astype(float), out.means.astype(float), rcond=None)
    np.testing.assert_allclose(model.means @ matrix, out.means, atol=1e-3)
    assert np.abs(matrix @ matrix.T - np.eye(3)).max() > 0.3
    untouched(model, out, "means")


def test_gaussian_marker_drops_one_block(model: GaussianModel) -> None:
    out = run("crop", model, 0.1, "as_code")
    index = {row.tobytes(): i for i, row in enumerate(model.means)}
    kept = np.array([index[row.tobytes()] for row in out.means])
    gone = np.setdiff1d(np.arange(500), kept)
    assert len(gone) == 50
    assert gone[-1] - gone[0] == 49


def test_color_bits_leave_geometry(model: GaussianModel) -> None:
    out = run("quantize_colors", model, 3)
    assert all(len(np.unique(out.sh[:, k, c])) <= 8 for k in range(9) for c in range(3))
    untouched(model, out, "sh")


def test_ten_bits_of_mantissa_are_float16(model: GaussianModel) -> None:
    out = run("round_floats", model, 10)
    for name in ("means", "log_scales", "opacity_logits", "sh"):
        values = getattr(model, name)
        half = values.astype(np.float16).astype(np.float32)
        normal = np.abs(values) > 6.2e-5
        np.testing.assert_array_equal(getattr(out, name)[normal], half[normal])
    coarse = run("round_floats", model, 2).sh
    assert len(np.unique(np.abs(np.frexp(coarse[coarse != 0])[0]))) <= 4
