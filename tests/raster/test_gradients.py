"""All gradients: against float64 differences, autograd of the twin, and through the torch operation."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import torch

from engine.errors import InputError
from engine.lab.raster.autograd import rasterize
from engine.model import Camera, GaussianModel
from engine.raster import Gradients, RasterSettings, backward, draw
from engine.raster.parameter_gradients import CHUNK, chunks_of
from tests.raster.scenes import TOLERANCE, camera, random_model, relative
from tests.reference import raster as twin

NAMES = ("means", "quats", "log_scales", "opacity_logits", "sh", "viewmat", "K")


def cotangents(view_from: Camera, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    shape = (view_from.height, view_from.width)
    return rng.normal(size=(*shape, 3)).astype(np.float32), rng.normal(size=shape).astype(np.float32)


def twin_loss(p: dict[str, torch.Tensor], view_from: Camera, of_image, of_alpha, **options) -> torch.Tensor:
    image, alpha, _ = twin.rasterize(p, view_from.width, view_from.height, **options)
    return (image * torch.tensor(of_image)).sum() + (alpha * torch.tensor(of_alpha)).sum()


@pytest.mark.parametrize(("count", "coefficients"), [(200, 16), (200, 9), (60, 4), (9, 1)])
def test_against_autograd_of_the_twin(count: int, coefficients: int) -> None:
    model, view_from = random_model(count, 30 + count, coefficients), camera()
    of_image, of_alpha = cotangents(view_from)
    p = twin.parameters(model, view_from)
    twin_loss(p, view_from, of_image, of_alpha, background=0.4).backward()
    gradients = backward(draw(model, view_from, 0.4), of_image, of_alpha)
    for name in NAMES:
        assert p[name].grad is not None
        assert np.abs(p[name].grad.numpy()).max() > 0.1
        assert relative(getattr(gradients, name), p[name].grad.numpy()) <= TOLERANCE["typical gradient"], name


@pytest.mark.parametrize("count", [200, 9])
def test_projected_centres(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the projected shapes held, as densification wants it."""
    kept = []

    def project(*args, **options):
        centres, *rest = original(*args, **options)
        centres.retain_grad()
        kept.append(centres)
        return centres, *rest

    original = twin.project
    monkeypatch.setattr(twin, "project", project)
    model, view_from = random_model(count, 50, 4), camera()
    of_image, of_alpha = cotangents(view_from)
    twin_loss(twin.parameters(model, view_from), view_from, of_image, of_alpha, background=0.4).backward()
    expected = kept[0].grad.numpy().T
    gradients = backward(draw(model, view_from, 0.4), of_image, of_alpha)
    assert gradients.centers.shape == (2, count)
    assert np.abs(expected).max() > 0.1
    assert relative(gradients.centers, expected) <= TOLERANCE["typical gradient"]


def test_where_thresholds_hold() -> None:
    """Opaque Gaussians: alpha is clamped, pixels end."""
    rng = np.random.default_rng(0)
    model = random_model(150, 40, 4).with_(opacity_logits=rng.normal(5.0, 3.0, 150).astype(np.float32))
    settings = RasterSettings(alpha_clamp=0.9)
    of_image, of_alpha = cotangents(camera())
    p = twin.parameters(model, camera())
    twin_loss(p, camera(), of_image, of_alpha, settings=settings).backward()
    gradients = backward(draw(model, camera(), settings=settings), of_image, of_alpha)
    for name in NAMES:
        assert relative(getattr(gradients, name), p[name].grad.numpy()) <= TOLERANCE["gradient"], name


def test_against_finite_differences() -> None:
    """Central differences of the twin in float64, every parameter of three Gaussians and the camera."""
    model, view_from = random_model(3, 1, 4), camera(24, 20, 25.0)
    model = model.with_(opacity_logits=np.zeros(3, np.float32), log_scales=model.log_scales * 0.2 - 0.6)
    of_image, of_alpha = cotangents(view_from)
    settings = RasterSettings(alpha_skip=1e-7)  # so that no pixel crosses the threshold on the way
    gradients = backward(draw(model, view_from, 0.2, settings), of_image, of_alpha)
    p = {k: v.detach() for k, v in twin.parameters(model, view_from).items()}

    def loss() -> float:
        return float(twin_loss(p, view_from, of_image, of_alpha, background=0.2, settings=settings))

    for name in NAMES:
        flat, step = p[name].reshape(-1), 1e-5
        result = np.asarray(getattr(gradients, name), np.float64).ravel()
        entries = range(len(flat))
        if name == "viewmat":
            entries = range(12)
        if name == "K":
            entries = (0, 2, 4, 5)
        expected = np.zeros(len(flat))
        for k in entries:
            old = float(flat[k])
            flat[k] = old + step
            above = loss()
            flat[k] = old - step
            expected[k] = (above - loss()) / (2 * step)
            flat[k] = old
        assert relative(result, expected) <= TOLERANCE["finite difference"], name


def test_given_colors() -> None:
    model, view_from = random_model(100, 50, 1), camera()
    colors = np.random.default_rng(0).random((100, 3)).astype(np.float32)
    of_image, of_alpha = cotangents(view_from)
    p = twin.parameters(model, view_from)
    shades = torch.tensor(colors, dtype=torch.float64, requires_grad=True)
    twin_loss(p, view_from, of_image, of_alpha, colors=shades).backward()
    rendering = draw(model, view_from, colors=colors)
    gradients = backward(rendering, of_image, of_alpha)
    assert relative(gradients.colors, shades.grad.numpy()) <= TOLERANCE["typical gradient"]
    assert relative(gradients.means, p["means"].grad.numpy()) <= TOLERANCE["typical gradient"]
    assert gradients.sh.shape == (0, 1, 3)
    np.testing.assert_array_equal(gradients.colors, rendering.view.backward_colors(of_image))


def test_arrays_are_reused() -> None:
    model = random_model(40, 51, 4)
    rendering = draw(model, camera())
    of_image, _ = cotangents(camera())
    fresh, out = backward(rendering, of_image), Gradients.empty(model)
    for name in NAMES:
        getattr(out, name)[:] = np.nan
    assert backward(rendering, of_image, out=out) is out
    for name in NAMES:
        np.testing.assert_array_equal(getattr(out, name), getattr(fresh, name))


def test_wrong_shapes_are_refused() -> None:
    model = random_model(20, 0, 1)
    rendering = draw(model, camera())
    image = np.zeros((47, 53, 3), np.float32)
    with pytest.raises(InputError, match="cotangent "):
        backward(rendering, image[:, :, :2])
    with pytest.raises(InputError, match="cotangent_alpha"):
        backward(rendering, image, image)
    with pytest.raises(InputError, match="out"):
        backward(rendering, image, out=Gradients.empty(random_model(19, 0, 1)))
    with pytest.raises(InputError, match="colors"):
        draw(model, camera(), colors=np.zeros((20, 4), np.float32))


def tensors(model: GaussianModel, view_from: Camera, dtype: torch.dtype) -> dict[str, torch.Tensor]:
    return {k: v.detach().to(dtype).requires_grad_() for k, v in twin.parameters(model, view_from).items()}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_torch_operation(dtype: torch.dtype) -> None:
    model, view_from = random_model(80, 60, 4), camera()
    of_image, of_alpha = cotangents(view_from)
    p = tensors(model, view_from, dtype)
    image, alpha = rasterize(**p, width=53, height=47, background=0.1)
    ((image * torch.tensor(of_image)).sum() + (alpha * torch.tensor(of_alpha)).sum()).backward()
    expected = twin.parameters(model, view_from)
    twin_loss(expected, view_from, of_image, of_alpha, background=0.1).backward()
    for name in NAMES:
        assert p[name].grad.dtype == dtype
        assert relative(p[name].grad, expected[name].grad) <= 3 * TOLERANCE["typical gradient"], name


def test_torch_operation_with_colors_and_alpha_only() -> None:
    model, view_from = random_model(80, 61, 1), camera()
    p = tensors(model, view_from, torch.float32)
    del p["sh"]
    colors = torch.rand(80, 3, requires_grad=True)
    image, alpha = rasterize(**p, colors=colors, width=53, height=47)
    image.sum().backward(retain_graph=True)
    assert colors.grad is not None
    assert float(colors.grad.abs().max()) > 0
    for tensor in p.values():
        tensor.grad = None
    alpha.sum().backward()
    assert float(p["means"].grad.abs().max()) > 0
    with pytest.raises(InputError, match="either"):
        rasterize(**p, width=53, height=47)
    with torch.no_grad():
        assert not rasterize(**p, colors=colors, width=53, height=47)[0].requires_grad


def test_numpy_users_never_load_torch() -> None:
    program = (
        "import sys\nfrom engine.flows.warmup.kernel_warmup import warm_up\n"
        "warm_up('embed')\nsys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


@pytest.mark.parametrize("more", [5, 16])
def test_the_last_group_of_a_chunk_counts_once(more: int) -> None:
    """Gaussians whose number leaves a rest beyond a chunk, against the same with others that are not seen."""
    n = CHUNK + more
    model, view_from = random_model(n, 4, 4), camera(83, 61)
    model = model.with_(opacity_logits=model.opacity_logits - np.float32(4.0))  # few hide others
    hidden = random_model(100, 5, 4)
    hidden = hidden.with_(opacity_logits=np.full(100, -50.0, np.float32))
    grown = model.with_(**{name: np.concatenate([getattr(m, name) for m in (model, hidden)]) for name in NAMES[:5]})
    cotangent = np.random.default_rng(0).normal(size=(61, 83, 3)).astype(np.float32)
    few, many = (backward(draw(m, view_from), cotangent) for m in (model, grown))
    for name in NAMES[:5]:
        np.testing.assert_array_equal(getattr(few, name), getattr(many, name)[:n], err_msg=name)
    np.testing.assert_allclose(few.viewmat, many.viewmat, rtol=1e-4, atol=1e-5)


def test_no_group_reaches_into_another_threads_chunk() -> None:
    """Groups are of 16; the last one of a chunk ends with it."""
    for n in range(16, 3 * CHUNK + 32):
        assert n - (chunks_of(n) - 1) * CHUNK >= 16
