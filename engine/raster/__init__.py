"""The CPU rasterizer: images of a Gaussian model, and their gradients.

`engine.raster.autograd.rasterize` is the same as a torch operation (torch is imported only there).
"""

from engine.raster.compiling import warm_up
from engine.raster.gradients import Gradients, Rendering, backward, draw
from engine.raster.pictures import render, render_depth
from engine.raster.settings import RasterSettings
from engine.raster.spherical_harmonics import sh_basis, sh_colors, sh_colors_backward
from engine.raster.view import View, prepare_view
from engine.raster.workspace import release_memory

__all__ = [
    "Gradients",
    "RasterSettings",
    "Rendering",
    "View",
    "backward",
    "draw",
    "prepare_view",
    "release_memory",
    "render",
    "render_depth",
    "sh_basis",
    "sh_colors",
    "sh_colors_backward",
    "warm_up",
]
