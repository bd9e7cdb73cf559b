"""`mark3dgs evaluate`: measurements, figures and a report, resumable."""

from pathlib import Path
from typing import Annotated, Any

import typer

from engine.cli.console import Console
from engine.cli.kernel_progress import prepare_kernels
from engine.cli.models import shipped_scene
from engine.cli.options import Json, Seed
from engine.errors import InputError


def _list_suites(wanted: bool) -> None:
    if not wanted:
        return
    from engine.lab.evaluate.studies import STUDIES

    for name, (_, summary) in STUDIES.items():
        typer.echo(f"  {name:<14} {summary}")
    raise typer.Exit()


def evaluate(
    suite: Annotated[str, typer.Option("--suite", metavar="NAME", help="What to find out; see --list.")],
    out: Annotated[
        Path, typer.Option("--out", help="Folder for cells, figures and report; a run goes on where it stopped.")
    ],
    scene: Annotated[
        list[Path] | None, typer.Option("--scene", help="Model to measure on; repeatable (default: the shipped one).")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A few cells only: does everything run?")] = False,
    workers: Annotated[
        int, typer.Option("--workers", min=1, help="Local processes. Timings want 1, on a quiet machine.")
    ] = 1,
    dask: Annotated[
        str | None, typer.Option("--dask", metavar="ADDRESS", help="Run on an existing Dask cluster instead.")
    ] = None,
    lpips_weights: Annotated[
        Path | None, typer.Option("--lpips-weights", help="perceptual: file with the weights of LPIPS.")
    ] = None,
    list_all: Annotated[
        bool, typer.Option("--list", callback=_list_suites, is_eager=True, help="List all suites.")
    ] = False,
    seed: Seed = 0,
    json: Json = False,
) -> int:
    """Measure, draw, report: results.json, figures (SVG, PNG) and report.html.

    Stop it with Ctrl-C at any time; the same command goes on where it stopped.

    Examples:

      mark3dgs evaluate --list
      mark3dgs evaluate --suite pareto --out out/pareto
      mark3dgs evaluate --suite stability --out out/s --scene a.sog --scene b.ply --workers 4
    """
    console = Console(json)
    if out.exists() and not out.is_dir():
        raise InputError(f"{str(out)!r} is a file; --out names a folder")
    from engine.lab.evaluate.cell_runner import run_cells
    from engine.lab.evaluate.report import cell_text, write_report
    from engine.lab.evaluate.studies import find_study
    from engine.lab.evaluate.study import Options

    study = find_study(suite)
    scenes = tuple(str(path.resolve()) for path in scene or [shipped_scene()])
    for path in scenes:
        if not Path(path).is_file():
            raise InputError(f"{path}: no such file")
    options = Options(scenes, quick, seed, None if lpips_weights is None else str(lpips_weights))
    cells = study.cells(options)
    with console.progress() as progress:
        prepare_kernels(console, progress, "everything")
        rows = run_cells(cells, out / "cells", workers=workers, dask=dask, tell=progress)
        progress("report", 0.0)
        report: dict[str, Any] = {"suite": suite, "cells": len(cells)}
        report |= write_report(study, rows, options, out)
    for bar in report["bars"]:
        word = {True: "met", False: "MISSED", None: "not measured"}[bar["met"]]
        console.say(f"{word:<13} {bar['what']}: {cell_text(bar['measured'])} (wanted {bar['wanted']})")
    console.say(f"\n{len(cells)} cells; report: {report['report']}")
    console.emit(report)
    return 0
