"""Density control: who is cloned, split and removed, and what becomes of the moments."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.capture.trainer import NAMES, CenterGradients, DensifyConfig, Parameters, densify
from tests.lab.sim.capture.scenes import shell

CONFIG = DensifyConfig(gradient=0.5, split_size=0.01, max_size=0.1)
EXTENT = 10.0  # split above 0.1, remove above 1


def prepared(count: int = 6) -> Parameters:
    """All small and opaque; moments tell who is who."""
    model = shell(count).with_(log_scales=np.full((count, 3), np.log(0.05), np.float32))
    parameters = Parameters(model)
    for name in NAMES:
        parameters.moments[name].first[:] = 1.0 + np.arange(count).reshape(
            -1, *[1] * (parameters.arrays[name].ndim - 1)
        )
    return parameters


def run(parameters: Parameters, pull: list[float], large: bool = True, config: DensifyConfig = CONFIG) -> None:
    pulls = np.array(pull, np.float32)
    densify(parameters, pulls, EXTENT, config, np.random.default_rng(0), prune_large=large)


def owners(parameters: Parameters) -> list[int]:
    """Old number of each Gaussian by its moments; -1 for a new one."""
    first = parameters.moments["opacity_logits"].first
    for name in NAMES:
        rows = parameters.moments[name].first.reshape(len(first), -1)
        assert (rows == first[:, None]).all()
        assert rows.shape[0] == len(parameters.arrays[name])
    return [int(v) - 1 for v in first]


def test_nothing_happens_without_cause() -> None:
    parameters = prepared()
    before = {name: array.copy() for name, array in parameters.arrays.items()}
    run(parameters, [0.1] * 6)
    assert owners(parameters) == [0, 1, 2, 3, 4, 5]
    assert all((parameters.arrays[name] == before[name]).all() for name in NAMES)


def test_a_small_one_is_cloned() -> None:
    parameters = prepared()
    run(parameters, [0, 0, 1, 0, 0, 0])
    assert owners(parameters) == [0, 1, 2, 3, 4, 5, -1]
    assert all((array[6] == array[2]).all() for array in parameters.arrays.values())


def test_a_large_one_is_split_inside_itself() -> None:
    parameters = prepared()
    parameters.arrays["log_scales"][3] = np.log([0.2, 0.4, 0.001])
    parameters.arrays["quats"][3] = [0, 0, 0, 3.0]  # half a turn about z, not of unit length
    center = parameters.arrays["means"][3].copy()
    run(parameters, [0, 0, 0, 1, 0, 0])
    assert owners(parameters) == [0, 1, 2, 4, 5, -1, -1]
    parts = parameters.model.take(np.array([5, 6]))
    np.testing.assert_allclose(parts.scales, np.array([[0.2, 0.4, 0.001]] * 2) / 1.6, rtol=1e-5)
    offset = parts.means - center
    assert (offset[0] != offset[1]).all()
    assert np.abs(offset / [0.2, 0.4, 0.001]).max() < 4
    assert np.abs(offset).max() > 0.01


def test_faint_and_huge_ones_go() -> None:
    parameters = prepared()
    parameters.arrays["opacity_logits"][1] = np.log(0.004)
    parameters.arrays["log_scales"][4, 2] = np.log(1.1)
    run(parameters, [0, 1, 0, 0, 0, 0], large=False)
    assert owners(parameters) == [0, 2, 3, 4, 5]  # pulled or not, the faint one has no heirs
    run(parameters, [0] * 5)
    assert owners(parameters) == [0, 2, 3, 5]


def test_the_most_pulled_come_first_when_room_is_short() -> None:
    parameters = prepared()
    run(parameters, [1, 5, 2, 9, 3, 4], config=DensifyConfig(gradient=0.5, most=8))
    assert len(parameters) == 8
    np.testing.assert_array_equal(parameters.arrays["means"][6:], parameters.arrays["means"][[1, 3]])
    run(parameters, [9] * 8, config=DensifyConfig(gradient=0.5, most=5))
    assert len(parameters) == 8


def test_a_model_never_vanishes() -> None:
    parameters = prepared()
    parameters.arrays["opacity_logits"][:] = -10
    run(parameters, [0] * 6)
    assert len(parameters) == 6


def test_pull_is_the_mean_over_the_views_that_saw() -> None:
    pull = CenterGradients(3)
    centers = np.array([[3.0, 0.0, 7.0], [4.0, 0.0, 7.0]], np.float32)
    pull.add(centers, np.array([0, 1], np.int32), 4, 2)  # half an image: 2 and 1 pixels
    pull.add(0 * centers, np.array([0], np.int32), 4, 2)
    np.testing.assert_allclose(pull.mean, [np.hypot(6, 4) / 2, 0, 0], rtol=1e-6)


def test_opacity_reset_and_degree() -> None:
    parameters = prepared()
    faint = parameters.arrays["opacity_logits"][0] = -6.0
    parameters.cap_opacity(0.01)
    np.testing.assert_allclose(parameters.model.opacities[1:], 0.01, rtol=1e-4)
    assert parameters.arrays["opacity_logits"][0] == faint
    assert not parameters.moments["opacity_logits"].first.any()
    before = parameters.arrays["sh"].copy()
    parameters.raise_degree(9)
    assert parameters.model.sh_degree == 2
    np.testing.assert_array_equal(parameters.arrays["sh"][:, :4], before)
    assert not parameters.arrays["sh"][:, 4:].any()
    assert (parameters.moments["sh"].first[1, :4] == 2).all()


@pytest.mark.parametrize(
    "options", [{"first": 0.6}, {"every": 0}, {"most": 0}, {"reset": 0}, {"gradient": 0}, {"min_opacity": 0.01}]
)
def test_refused_settings(options: dict[str, float]) -> None:
    with pytest.raises(InputError):
        DensifyConfig(**options)
