"""The CPU rasterizer: images of a Gaussian model, and their gradients."""

from engine.raster.render import render, render_depth
from engine.raster.settings import RasterSettings
from engine.raster.spherical_harmonics import sh_basis, sh_colors, sh_colors_backward
from engine.raster.view import View, prepare_view

__all__ = [
    "RasterSettings",
    "View",
    "prepare_view",
    "render",
    "render_depth",
    "sh_basis",
    "sh_colors",
    "sh_colors_backward",
]
