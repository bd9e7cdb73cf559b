from __future__ import annotations

import io

import numpy as np
import pytest
import torch
from PIL import Image

from engine.flows.embed import distortions


def picture(size: int = 96) -> torch.Tensor:
    rng = np.random.default_rng(0)
    coarse = (rng.uniform(0.2, 0.8, (8, 8, 3)) * 255).astype(np.uint8)
    image = np.asarray(Image.fromarray(coarse).resize((size, size), Image.Resampling.BICUBIC)) / 255.0
    return torch.from_numpy(image.astype(np.float32)).permute(2, 0, 1)[None]


def test_jpeg_layer_is_close_to_the_real_encoder() -> None:
    image = picture()
    array = (image[0].permute(1, 2, 0).numpy() * 255 + 0.5).astype(np.uint8)
    for quality in (10, 50):
        buffer = io.BytesIO()
        Image.fromarray(array).save(buffer, "JPEG", quality=quality)
        real = np.asarray(Image.open(buffer)) / 255.0
        ours = distortions.jpeg(image, quality)[0].permute(1, 2, 0).numpy()
        damage = np.sqrt(np.mean((real - array / 255.0) ** 2))
        assert np.sqrt(np.mean((ours - real) ** 2)) < 0.75 * damage + 0.006


def test_soft_round_rounds_and_has_a_slope() -> None:
    x = torch.tensor([0.2, 1.49, -2.6], requires_grad=True)
    y = distortions.soft_round(x)
    assert torch.allclose(y, torch.round(x), atol=0.13)
    y.sum().backward()
    assert (x.grad > 0).all()  # type: ignore[operator]
    assert x.grad[1] > x.grad[0]  # type: ignore[index]


LAYERS = {
    "jpeg": lambda x: distortions.jpeg(x, 30),
    "blur": lambda x: distortions.blur(x, 1.0),
    "noise": lambda x: distortions.noise(x, 0.05, np.random.default_rng(0)),
    "rescale": lambda x: distortions.rescale(x, 0.5),
    "rotate": lambda x: distortions.rotate(x, 20.0),
    "crop": lambda x: distortions.crop(x, 0.5, np.random.default_rng(0)),
}


@pytest.mark.parametrize("name", sorted(LAYERS))
def test_each_layer_changes_the_picture_and_passes_a_gradient(name: str) -> None:
    image = picture().requires_grad_(True)
    out = LAYERS[name](image)
    assert out.shape == image.shape
    assert float((out - image).detach().abs().mean()) > 1e-3
    out.sum().backward()
    assert image.grad is not None
    assert float(image.grad.abs().sum()) > 0


def test_a_drawn_layer_treats_both_pictures_alike() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        layer = distortions.draw(rng)
        assert torch.equal(layer(picture()), layer(picture()))


@pytest.mark.parametrize("name", ["blur", "rescale", "rotate", "jpeg"])
def test_a_plain_surface_stays_as_it_is(name: str) -> None:
    out = LAYERS[name](torch.full((1, 3, 64, 64), 0.5))
    assert torch.allclose(out[:, :, 24:40, 24:40], torch.tensor(0.5), atol=5e-3)


def test_a_crop_keeps_its_share_of_the_area() -> None:
    kept = (distortions.crop(torch.ones(1, 3, 100, 80), 0.5, np.random.default_rng(1)) > 0).float().mean()
    assert float(kept) == pytest.approx(0.5, abs=0.02)


def test_what_is_rotated_is_rotated_back() -> None:
    image = picture()
    centre = (slice(None), slice(None), slice(32, 64), slice(32, 64))
    gap = (distortions.rotate(image, 25.0) - image)[centre].abs().mean()
    assert float(gap) < 0.2 * float((image[centre] - image[centre].mean()).abs().mean())


def test_noise_is_stored_as_pictures_are() -> None:
    out = distortions.noise(torch.full((1, 3, 64, 64), 0.98), 0.1, np.random.default_rng(0))
    assert 0.0 <= float(out.min()) < 0.9
    assert float(out.max()) == 1.0


def test_the_softer_the_jpeg_the_less_it_changes() -> None:
    gray = picture().mean(dim=1, keepdim=True).repeat(1, 3, 1, 1)
    gray = gray + 0.05 * torch.randn(1, 1, 96, 96, generator=torch.Generator().manual_seed(0))
    damage = [float((distortions.jpeg(gray, quality) - gray).abs().mean()) for quality in (10, 50, 80, 95)]
    assert damage == sorted(damage, reverse=True)
    assert damage[3] < 0.25 * damage[1]
