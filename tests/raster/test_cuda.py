"""The GPU path: what is handed to gsplat, and the same image where a GPU is."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from engine.errors import InputError
from engine.lab.raster.autograd import rasterize
from engine.raster import Gradients, RasterSettings, backward, cuda, draw, prepare_view, render, sh_colors
from engine.raster.cuda import CudaView, draws_alike, find_device, missing
from tests.gsplat_stand_in import StandIn, install
from tests.raster.scenes import TOLERANCE, camera, random_model, relative
from tests.reference import raster as twin

MODEL = random_model(100, 80, 9)


def tensors(device: str) -> dict[str, torch.Tensor]:
    p = twin.parameters(MODEL, camera())
    return {k: v.detach().float().to(device).requires_grad_() for k, v in p.items()}


@pytest.fixture
def gsplat(monkeypatch: pytest.MonkeyPatch) -> StandIn:
    return install(monkeypatch)


def through_gsplat(p: dict[str, torch.Tensor], background: float, settings: RasterSettings) -> Any:
    return cuda.rasterize(**p, width=53, height=47, colors=None, background=background, settings=settings)


def test_what_gsplat_is_given(gsplat: StandIn) -> None:
    p = tensors("cpu")
    settings = RasterSettings(eps2d=0.1, near=0.2)
    image, alpha = through_gsplat(p, 0.5, settings)
    assert image.shape == (47, 53, 3)
    assert alpha.shape == (47, 53)
    (means, _, scales, opacities, colors, viewmats, Ks, width, height), options = gsplat.calls[0]
    assert (width, height) == (53, 47)
    assert colors.shape == (100, 9, 3)
    assert options["sh_degree"] == 2
    assert (options["eps2d"], options["near_plane"]) == (0.1, 0.2)
    torch.testing.assert_close(means, p["means"])
    torch.testing.assert_close(scales, p["log_scales"].exp())
    torch.testing.assert_close(opacities, p["opacity_logits"].sigmoid())
    assert viewmats.shape == (1, 4, 4)
    assert Ks.shape == (1, 3, 3)
    assert options["backgrounds"].tolist() == [[0.5, 0.5, 0.5]]


def test_settings_that_gsplat_cannot_honour(gsplat: StandIn) -> None:
    with pytest.raises(InputError, match="gsplat"):
        through_gsplat(tensors("cpu"), 0.0, RasterSettings(alpha_clamp=0.99))
    assert not gsplat.calls


def test_a_view_on_the_gpu_is_the_cpus(gsplat: StandIn) -> None:
    """Pictures of any colours, their gradients by colours, and those by what recovery moves."""
    view, other, rng = CudaView(MODEL, camera()), prepare_view(MODEL, camera()), np.random.default_rng(1)
    colors = sh_colors(MODEL.sh, MODEL.means, camera().position.astype(np.float32))
    cotangent = rng.standard_normal((47, 53, 3)).astype(np.float32)
    for ours, theirs in zip(view.render(colors), other.render(colors), strict=True):
        assert np.abs(ours - theirs).max() <= TOLERANCE["pixel"]
    pulled = torch.from_numpy(view.backward_colors(cotangent))
    assert relative(pulled, torch.from_numpy(other.backward_colors(cotangent))) <= TOLERANCE["gradient"]
    found, rendering = Gradients.empty(MODEL, with_sh=False), draw(MODEL, camera(), colors=colors)
    view.gradients(colors, lambda image: image * cotangent, found)
    wanted = backward(rendering, rendering.image * cotangent)
    for name in ("means", "quats", "log_scales", "opacity_logits"):
        ours, theirs = (torch.from_numpy(getattr(each, name)) for each in (found, wanted))
        assert relative(ours, theirs) <= TOLERANCE["gradient"], name
    assert len(gsplat.calls) == 3


def test_what_gsplat_would_draw_otherwise() -> None:
    """Discs, antialiased models, and lenses with skew."""
    thin = MODEL.log_scales.copy()
    thin[:, 2] = thin[:, :2].min(axis=1) + np.log(1e-6)
    skewed = camera().K.copy()
    skewed[0, 1] = 1.0
    assert draws_alike(MODEL, [camera()])
    assert not draws_alike(MODEL.with_(log_scales=thin))
    assert not draws_alike(replace(MODEL, antialiased=True))
    assert not draws_alike(MODEL, [camera(), replace(camera(), K=skewed)])


def breaks(*_: Any, **__: Any) -> None:
    raise AttributeError("no kernels: nvcc was not found")


FAULTS = {
    "torch, which is not installed: pip install 'mark3dgs[cuda]'": lambda patch: patch.setitem(
        sys.modules, "torch", None
    ),
    "gsplat, which is not installed: pip install 'mark3dgs[cuda]'": lambda patch: patch.setitem(
        sys.modules, "gsplat", None
    ),
    "needs an NVIDIA GPU, and torch finds none": lambda patch: patch.setattr(torch.cuda, "is_available", lambda: False),
    "AttributeError: no kernels: nvcc was not found": lambda patch: patch.setattr(
        sys.modules["gsplat"], "rasterization", breaks
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_missing_is_named(fault: str, gsplat: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    assert (find_device("cuda"), find_device("auto"), find_device("cpu")) == ("cuda", "cuda", "cpu")
    FAULTS[fault](monkeypatch)
    assert (find_device("auto"), find_device("cpu")) == ("cpu", "cpu")
    with pytest.raises(InputError) as refused:
        find_device("cuda")
    assert fault in str(refused.value)


def test_what_gsplat_says_does_not_get_into_an_answer(
    gsplat: StandIn, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It prints that it compiles; stdout may be JSON."""
    drawing = gsplat.rasterization

    def compiling(*args: Any, **options: Any) -> Any:
        sys.stdout.write("compiling\n")
        return drawing(*args, **options)

    monkeypatch.setattr(gsplat, "rasterization", compiling)
    assert missing() is None
    assert capsys.readouterr() == ("", "compiling\n")


def test_a_device_is_one_of_three() -> None:
    with pytest.raises(InputError, match="auto, cpu, cuda, got 'gpu'"):
        find_device("gpu")


@pytest.mark.skipif(importlib.util.find_spec("gsplat") is not None, reason="gsplat is installed")
def test_without_gsplat() -> None:
    with pytest.raises(InputError, match="mark3dgs"):
        through_gsplat(tensors("cpu"), 0.0, RasterSettings())


@pytest.mark.skipif(missing() is not None, reason=f"did not run: {missing()}")
def test_same_image_and_gradients_on_the_gpu() -> None:
    p, q = tensors("cuda"), tensors("cpu")
    image, _ = rasterize(**p, width=53, height=47, background=0.2)
    again, _ = rasterize(**q, width=53, height=47, background=0.2)
    difference = np.abs(image.detach().cpu().numpy() - render(MODEL, camera(), 0.2))
    assert difference.max() <= TOLERANCE["pixel"]
    image.square().sum().backward()
    again.square().sum().backward()
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        assert relative(p[name].grad.cpu(), q[name].grad) <= 10 * TOLERANCE["gradient"], name
    assert relative(motion(p["viewmat"]), motion(q["viewmat"])) <= 10 * TOLERANCE["gradient"]


def motion(viewmat: torch.Tensor) -> torch.Tensor:
    """(6,) gradient of turning about the camera's axes and of moving it: where a matrix may also shear, the two extend
    the image differently."""
    assert viewmat.grad is not None
    gradient, matrix = viewmat.grad.cpu(), viewmat.detach().cpu()
    turn = (gradient @ matrix.T)[:3, :3]
    above = torch.triu_indices(3, 3, offset=1)
    return torch.cat([(turn - turn.T)[above[0], above[1]], gradient[:3, 3]])
