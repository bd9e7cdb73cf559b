"""The CPU rasterizer: images of a Gaussian model, and their exact gradients (Eq 2 and 3).

All rooms above may import the names below: `render` for a picture; `prepare_view` for many pictures and gradients
of one view's colours; `draw` and `backward` for the gradients of everything. A newcomer starts at `geometry`, which
runs the passes in order (`projection` or `disc_projection`, `sorting`, `binning`), then reads `tiles` and `forward`;
`backward` and `moments` walk the same tiles. The `lane_*` modules are sixteen numbers as one value inside numba.
`engine.lab.raster.autograd.rasterize` is the same as a torch operation.
"""

from engine.raster.geometry import count_overlaps
from engine.raster.gradients import Gradients, Rendering, backward, draw
from engine.raster.settings import EarlyStop, RasterSettings
from engine.raster.spherical_harmonics import sh_basis, sh_colors
from engine.raster.view import View, prepare_view, render, render_depth
from engine.raster.workspace import release_memory

__all__ = [
    "EarlyStop",
    "Gradients",
    "RasterSettings",
    "Rendering",
    "View",
    "backward",
    "count_overlaps",
    "draw",
    "prepare_view",
    "release_memory",
    "render",
    "render_depth",
    "sh_basis",
    "sh_colors",
]
