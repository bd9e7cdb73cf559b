"""A stand-in for gsplat where no GPU is: its signature, and behind it our own rasterizer's passes through autograd."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType
from typing import Any

import pytest
import torch

from engine.lab.raster.autograd import rasterize
from engine.raster import RasterSettings, cuda


class StandIn(ModuleType):
    """Keeps the arguments of each call."""

    def __init__(self) -> None:
        super().__init__("gsplat")
        self.__spec__ = importlib.util.spec_from_loader("gsplat", loader=None)
        self.calls: list[tuple[tuple[Any, ...], dict[str, Any]]] = []

    def rasterization(
        self,
        means: torch.Tensor,
        quats: torch.Tensor,
        scales: torch.Tensor,
        opacities: torch.Tensor,
        colors: torch.Tensor,
        viewmats: torch.Tensor,
        Ks: torch.Tensor,
        width: int,
        height: int,
        **options: Any,
    ) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:
        self.calls.append(((means, quats, scales, opacities, colors, viewmats, Ks, width, height), options))
        image, alpha = rasterize(
            means,
            quats,
            scales.log(),
            opacities.logit(),
            viewmats[0],
            Ks[0],
            width,
            height,
            **{"colors" if options["sh_degree"] is None else "sh": colors},
            background=tuple(options["backgrounds"][0].tolist()),
            settings=RasterSettings(eps2d=options["eps2d"], near=options["near_plane"]),
        )
        return image[None], alpha[None, ..., None], {}


def install(monkeypatch: pytest.MonkeyPatch) -> StandIn:
    """In gsplat's place, with the CPU as torch's GPU."""
    module = StandIn()
    monkeypatch.setitem(sys.modules, "gsplat", module)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(cuda, "_DEVICE", "cpu")
    return module
