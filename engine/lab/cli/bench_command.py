"""`mark3dgs bench`: speed and robustness measured here and now, as numbers a reader can make again."""

import json as json_text
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from engine.cli.console import Console
from engine.cli.kernel_progress import prepare_kernels
from engine.cli.models import shipped_scene
from engine.cli.options import Json, Seed
from engine.errors import InputError, Mark3DGSError
from engine.lab.evaluate.bench.benches import BENCHES
from engine.numerics.plain import plain
from engine.usecases.files import check_target, whole_file

_LIST = "\n".join(f"{name:<12} {entry.summary}" for name, entry in BENCHES.items())
HELP = f"""Measure on real scenes.

{_LIST}

Examples:

  mark3dgs bench embed --scene city.sog --repeats 5
  mark3dgs bench attacks --scene city.sog --scene plant.splat --out a.json
"""


def bench(
    what: Annotated[str, typer.Argument(metavar="WHAT", help=", ".join(BENCHES) + ".")],
    scene: Annotated[
        list[Path] | None, typer.Option("--scene", help="Model to measure on; repeatable (default: the shipped one).")
    ] = None,
    profile: Annotated[str, typer.Option("--profile", metavar="P", help="fast, balanced or strong.")] = "fast",
    repeats: Annotated[int, typer.Option("--repeats", min=1, help="Timed runs; the median is reported.")] = 3,
    trials: Annotated[
        int | None,
        typer.Option(
            "--trials",
            min=1,
            help="Screenshots (50), foreign pictures (200), epochs (500), wrong keys (100,000), "
            "innocent copies (10,000) or assets (1,000).",
        ),
    ] = None,
    size: Annotated[tuple[int, int], typer.Option("--size", metavar="W H", help="raster: pixels of the image.")] = (
        1297,
        840,
    ),
    setting: Annotated[
        list[str] | None,
        typer.Option(
            "--setting",
            metavar="NAME",
            help="finetune: clean+key, clean, key, neither; variants: 2dgs, 4dgs, compact3d, dreamgaussian; "
            "repeatable (default: all).",
        ),
    ] = None,
    colors_only: Annotated[bool, typer.Option("--colors-only", help="finetune: leave the geometry alone.")] = False,
    seed: Seed = 0,
    out: Annotated[Path | None, typer.Option("--out", help="Write the JSON report to this file, too.")] = None,
    cells: Annotated[
        Path | None, typer.Option("--cells", help="Folder that keeps what is measured; a run goes on where it stopped.")
    ] = None,
    workers: Annotated[
        int, typer.Option("--workers", min=1, help="Local processes. Timings want 1, on a quiet machine.")
    ] = 1,
    json: Json = False,
) -> int:
    """Measure one of BENCHES; the command's help is HELP."""
    console = Console(json)
    if what not in BENCHES:
        raise InputError(f"nothing is measured under the name {what!r}; there are {', '.join(BENCHES)}")
    if out is not None:
        check_target(out)
    from engine.kernels.machine import machine_info
    from engine.lab.evaluate.bench.benches import bench_cells
    from engine.lab.evaluate.cell_runner import run_cells

    asked = {"profile": profile, "repeats": repeats, "trials": trials, "size": list(size), "colors_only": colors_only}
    spare = shipped_scene()
    scenes = [str(path.absolute()) for path in scene or [spare]]
    work, told = bench_cells(what, scenes, asked, seed=seed, settings=setting or [], spare=str(spare))
    with console.progress() as progress, tempfile.TemporaryDirectory() as folder:
        prepare_kernels(console, progress, "everything")
        try:
            rows = run_cells(work, cells or Path(folder), workers=workers, tell=progress)
        except InputError as error:  # what went wrong in a cell is told as if there were none
            raise error.__cause__ if isinstance(error.__cause__, Mark3DGSError) else error from None
    for row in rows:
        del row["cell"]
        console.say("  ".join(f"{name}={_text(value)}" for name, value in row.items() if not isinstance(value, dict)))
    report = {"bench": what, "machine": machine_info(), **told, "rows": rows}
    if out is not None:
        with whole_file(out) as part:
            part.write_text(json_text.dumps(plain(report), indent=1) + "\n")
        console.say(f"report: {out}")
    console.emit(report)
    return 0


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
