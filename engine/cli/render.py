"""`mark3dgs render`: a picture of a model."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from engine.cli.console import Console
from engine.cli.kernel_progress import prepare_kernels
from engine.cli.options import Json, SpzFrame
from engine.errors import InputError
from engine.usecases.files import check_picture_ending, check_target, refuse_same, whole_file, write_picture

if TYPE_CHECKING:
    from engine.model import Camera, GaussianModel

RIG_VIEWS = 24
"""Views of the automatic rig; --view counts around it."""

DEFAULT_SIZE = (800, 600)
MAX_SIDE = 8192


def render(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="Model in any format that is read here.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Picture to write: .png, .jpg or .webp.")],
    camera: Annotated[
        Path | None, typer.Option("--camera", help="cameras.json, transforms.json or COLMAP folder.")
    ] = None,
    view: Annotated[
        int, typer.Option("--view", min=0, help=f"Which camera of the file, or which of {RIG_VIEWS} views around.")
    ] = 0,
    size: Annotated[
        tuple[int, int] | None,
        typer.Option("--size", metavar="W H", help="Pixels (default: the camera's, or 800 600)."),
    ] = None,
    background: Annotated[
        float, typer.Option("--background", min=0.0, max=1.0, help="Grey behind the model, 0 black to 1 white.")
    ] = 0.0,
    early: Annotated[
        float | None,
        typer.Option("--early-stop", metavar="TAU", help="End pixels by impact, too, as the paper does (0.95)."),
    ] = None,
    save_camera: Annotated[
        Path | None, typer.Option("--save-camera", help="Write the camera as cameras.json, for `verify --cameras`.")
    ] = None,
    spz_frame: SpzFrame = "auto",
    json: Json = False,
) -> int:
    """Draw a model from one camera.

    Without --camera the view is one of a rig around (or inside) the model, the
    same every time.

    Examples:

      mark3dgs render scene.ply view.png --view 3 --size 800 800
      mark3dgs render scene.ply view.png --camera cameras.json --view 12
    """
    console = Console(json)
    began = time.perf_counter()
    check_target(out)
    refuse_same(model, out)
    check_picture_ending(out)
    if size is not None and not all(1 <= side <= MAX_SIDE for side in size):
        raise InputError(f"a picture has 1 to {MAX_SIDE} pixels a side, got {size[0]} x {size[1]}")
    if save_camera is not None:
        check_target(save_camera)

    import numpy as np

    from engine.flows.views.view_set import early_stop, render_early
    from engine.formats import read_model, write_cameras
    from engine.raster import render as draw

    with console.progress() as progress:
        prepare_kernels(console, progress)
        progress("read", 0.0)
        loaded = read_model(model, spz_frame=spz_frame)
        console.note_repairs(loaded.repairs)
        chosen = choose_camera(loaded.model, camera, view, size)
        stop = None if early is None else early_stop(loaded.model, early)
        started = time.perf_counter()
        if stop is None:
            image = draw(loaded.model, chosen, background)
        else:
            image = render_early(loaded.model, chosen, stop, background)
        render_ms = 1000.0 * (time.perf_counter() - started)
    with whole_file(out) as part:
        write_picture(image, part, out)
    if save_camera is not None:
        write_cameras([chosen.relative_to(np.negative(loaded.model.origin))], save_camera)
    report = {
        "out": str(out),
        "width": chosen.width,
        "height": chosen.height,
        "gaussians": len(loaded.model),
        "camera": {"viewmat": chosen.viewmat, "K": chosen.K},
        "render_ms": render_ms,
        "seconds": time.perf_counter() - began,
    }
    console.say(f"{out}: {chosen.width} x {chosen.height}, {len(loaded.model):,} Gaussians in {render_ms:.0f} ms")
    console.emit(report)
    return 0


def choose_camera(model: GaussianModel, camera_file: Path | None, view: int, size: tuple[int, int] | None) -> Camera:
    """The camera chosen: of a file, or of the rig around the model."""
    from engine.flows.views.camera_rig import make_rig
    from engine.flows.views.display_view import with_all

    if camera_file is None:
        width, height = size or DEFAULT_SIZE
        if view >= RIG_VIEWS:
            raise InputError(f"the automatic rig has views 0 to {RIG_VIEWS - 1}, got {view}")
        return with_all(model, make_rig(model, RIG_VIEWS, width, height)[view])
    from engine.formats import read_cameras

    cameras = read_cameras(camera_file)
    if view >= len(cameras):
        raise InputError(f"{str(camera_file)!r} holds {len(cameras)} cameras, counted from 0; got view {view}")
    chosen = cameras[view].relative_to(model.origin)
    return chosen if size is None else chosen.resized(*size)
