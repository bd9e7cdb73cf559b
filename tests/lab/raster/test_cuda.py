"""The GPU path: what is handed to gsplat, and the same image where a GPU is."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch

from engine.errors import InputError
from engine.lab.raster import cuda
from engine.lab.raster.autograd import rasterize
from engine.raster import RasterSettings, render
from tests.raster.scenes import TOLERANCE, camera, random_model, relative
from tests.reference import raster as twin

MODEL = random_model(100, 80, 9)


def tensors(device: str) -> dict[str, torch.Tensor]:
    p = twin.parameters(MODEL, camera())
    return {k: v.detach().float().to(device).requires_grad_() for k, v in p.items()}


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """A stand-in for gsplat that keeps its arguments."""
    kept: list[tuple[Any, ...]] = []

    def rasterization(*args: Any, **options: Any) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:
        kept.append((args, options))
        return torch.zeros(1, 47, 53, 3), torch.zeros(1, 47, 53, 1), {}

    module = ModuleType("gsplat")
    module.rasterization = rasterization  # type: ignore[attr-defined]
    module.__spec__ = importlib.util.spec_from_loader("gsplat", loader=None)
    monkeypatch.setitem(sys.modules, "gsplat", module)
    return kept


def through_gsplat(p: dict[str, torch.Tensor], background: float, settings: RasterSettings) -> Any:
    return cuda.rasterize(**p, width=53, height=47, colors=None, background=background, settings=settings)


def test_what_gsplat_is_given(calls: list[tuple[Any, ...]]) -> None:
    p = tensors("cpu")
    settings = RasterSettings(eps2d=0.1, near=0.2)
    image, alpha = through_gsplat(p, 0.5, settings)
    assert image.shape == (47, 53, 3)
    assert alpha.shape == (47, 53)
    (means, _, scales, opacities, colors, viewmats, Ks, width, height), options = calls[0]
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


def test_settings_that_gsplat_cannot_honour(calls: list[tuple[Any, ...]]) -> None:
    with pytest.raises(InputError, match="gsplat"):
        through_gsplat(tensors("cpu"), 0.0, RasterSettings(alpha_clamp=0.99))
    assert not calls


@pytest.mark.skipif(importlib.util.find_spec("gsplat") is not None, reason="gsplat is installed")
def test_without_gsplat() -> None:
    assert not cuda.available()
    with pytest.raises(InputError, match="mark3dgs"):
        through_gsplat(tensors("cpu"), 0.0, RasterSettings())


@pytest.mark.skipif(not cuda.available(), reason="needs a CUDA device and the gsplat package")
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
