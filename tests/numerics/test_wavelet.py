"""The Haar transform against its definition: one orthonormal matrix an axis and level."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from engine.numerics.wavelet import dwt2, high_frequency_energy, idwt2

SIZES = [(16, 16), (17, 23), (1, 5), (2, 1), (33, 8), (3, 3)]


def haar_matrix(n: int) -> np.ndarray:
    """Rows: low-pass filters, then high-pass filters, for even n."""
    m = np.zeros((n, n))
    for i in range(n // 2):
        m[i, 2 * i : 2 * i + 2] = np.sqrt(0.5)
        m[n // 2 + i, 2 * i : 2 * i + 2] = np.sqrt(0.5), -np.sqrt(0.5)
    return m


def test_one_level_is_the_orthonormal_matrix_on_both_axes() -> None:
    image = np.random.default_rng(0).normal(size=(6, 8))
    full = haar_matrix(6) @ image @ haar_matrix(8).T
    approx, [(lh, hl, hh)] = dwt2(image, 1)
    np.testing.assert_allclose(approx, full[:3, :4], atol=1e-12)
    np.testing.assert_allclose(lh, full[3:, :4], atol=1e-12)  # high along y
    np.testing.assert_allclose(hl, full[:3, 4:], atol=1e-12)  # high along x
    np.testing.assert_allclose(hh, full[3:, 4:], atol=1e-12)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("channels", [(), (3,)])
def test_inverse_is_exact_for_every_size(size: tuple[int, int], channels: tuple[int, ...]) -> None:
    image = np.random.default_rng(1).normal(size=size + channels)
    for levels in (0, 1, 3):
        np.testing.assert_allclose(idwt2(*dwt2(image, levels)), image, atol=1e-12)


def test_energy_is_preserved() -> None:
    image = np.random.default_rng(2).normal(size=(32, 16, 3))
    approx, details = dwt2(image, 3)
    energy = np.sum(approx**2) + sum(np.sum(band**2) for bands in details for band in bands)
    assert energy == pytest.approx(np.sum(image**2), rel=1e-12)


@pytest.mark.parametrize("size", SIZES)
def test_a_constant_has_no_details_even_at_odd_borders(size: tuple[int, int]) -> None:
    approx, details = dwt2(np.full(size, 0.3), 3)
    np.testing.assert_allclose(approx, 0.3 * 8, atol=1e-12)
    assert all(np.abs(band).max(initial=0.0) < 1e-12 for bands in details for band in bands)


@pytest.mark.parametrize("size", [(16, 16, 3), (7, 9, 2)])
def test_tensors_give_the_same_numbers_and_gradients_flow(size: tuple[int, ...]) -> None:
    image = np.random.default_rng(3).normal(size=size)
    tensor = torch.tensor(image, requires_grad=True)
    approx, details = dwt2(tensor, 2)
    expected, expected_details = dwt2(image, 2)
    np.testing.assert_allclose(approx.detach().numpy(), expected, atol=1e-12)
    for bands, expected_bands in zip(details, expected_details, strict=True):
        for band, expected_band in zip(bands, expected_bands, strict=True):
            np.testing.assert_allclose(band.detach().numpy(), expected_band, atol=1e-12)
    np.testing.assert_allclose(idwt2(approx, details).detach().numpy(), image, atol=1e-12)
    sum((band**2).sum() for bands in details for band in bands).backward()
    # Away from odd borders the details are an orthogonal projection P, so the gradient of |Px|^2 is 2 Px.
    detail = idwt2(np.zeros_like(expected), expected_details)
    inner = (slice(0, size[0] // 4 * 4), slice(0, size[1] // 4 * 4))
    assert tensor.grad is not None
    np.testing.assert_allclose(tensor.grad.numpy()[inner], 2 * detail[inner], atol=1e-12)


def test_energy_map_sums_to_the_details_and_lies_where_the_edge_is() -> None:
    image = np.zeros((32, 32, 3), dtype=np.float32)
    image[:, 17:] = 1.0  # cuts the pixel pair (16, 17)
    energy = high_frequency_energy(image, levels=2)
    _, details = dwt2(image, 2)
    total = sum(float(np.sum(band**2)) for bands in details for band in bands) / 3
    assert energy.dtype == np.float32
    assert energy.sum() == pytest.approx(total, rel=1e-5)
    assert energy[:, 16:20].min() > 0
    assert energy[:, :16].max() == 0
    assert energy[:, 20:].max() == 0


def test_energy_map_of_grey_and_odd_images() -> None:
    gray = np.random.default_rng(4).uniform(size=(13, 7)).astype(np.float32)
    colour = np.repeat(gray[:, :, None], 3, axis=2)
    np.testing.assert_allclose(high_frequency_energy(gray), high_frequency_energy(colour), rtol=1e-5)
    assert high_frequency_energy(gray).shape == (13, 7)
