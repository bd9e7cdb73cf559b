"""`mark3dgs evaluate`: measurements, figures and a report, resumable."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from engine.cli.console import Console
from engine.cli.kernel_progress import prepare_kernels
from engine.cli.options import Device, Json
from engine.errors import InputError, Mark3DGSError
from engine.lab.cli.shared import Seed, shipped_scene

TRIALS_HELP = (
    "Trials: screenshots (50), foreign pictures (200), views looked at (24), innocent copies (10,000), assets (1,000) "
    "or keys of a benchmark (1)."
)


def _list_suites(wanted: bool) -> None:
    if not wanted:
        return
    from engine.lab.evaluate.suites import summaries

    for name, summary in summaries().items():
        typer.echo(f"  {name:<14} {summary}")
    raise typer.Exit()


def evaluate(
    suite: Annotated[str, typer.Option("--suite", metavar="NAME", help="What to measure; see --list.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Folder for cells, figures and report; a stopped run continues. Suites that only print rows "
            "work without it.",
        ),
    ] = None,
    scene: Annotated[
        list[Path] | None, typer.Option("--scene", help="Model to measure on; repeatable (default: the shipped one).")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A few cells only: does everything run? (studies)")] = False,
    setting: Annotated[
        list[str] | None,
        typer.Option("--setting", metavar="NAME", help="A part of the suite; repeatable. (tables: table1, fig6, ...)"),
    ] = None,
    profile: Annotated[
        str | None, typer.Option("--profile", metavar="P", help="fast (default), balanced or strong. (measurements)")
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            "--method",
            metavar="NAME",
            help="What is measured: ours (default), qim, spread, dct, or a class of yours as module:Class; "
            "repeatable. (benchmark, flymark, msvs)",
        ),
    ] = None,
    trials: Annotated[int | None, typer.Option("--trials", min=1, help=TRIALS_HELP)] = None,
    lpips_weights: Annotated[
        Path | None, typer.Option("--lpips-weights", help="File with the weights of LPIPS. (perceptual)")
    ] = None,
    workers: Annotated[
        int, typer.Option("--workers", min=1, help="Local processes. Timings need 1, on an idle machine.")
    ] = 1,
    dask: Annotated[
        str | None, typer.Option("--dask", metavar="ADDRESS", help="Run on an existing Dask cluster instead.")
    ] = None,
    list_all: Annotated[
        bool, typer.Option("--list", callback=_list_suites, is_eager=True, help="List all suites.")
    ] = False,
    device: Device = "cpu",
    seed: Seed = 0,
    json: Json = False,
) -> int:
    """Measure, draw, report: results.json, figures (SVG, PNG) and report.html.

    Stop it with Ctrl-C at any time; with --out the same command continues where
    it stopped.

    Examples:

      mark3dgs evaluate --list
      mark3dgs evaluate --suite pareto --out out/pareto
      mark3dgs evaluate --suite tables --setting table2 --out out/tables
      mark3dgs evaluate --suite budgets --scene city.sog
    """
    console = Console(json)
    if out is not None and out.exists() and not out.is_dir():
        raise InputError(f"{str(out)!r} is a file; --out names a folder")
    from engine.lab.evaluate.cell_runner import run_cells
    from engine.lab.evaluate.machine import machine_info
    from engine.lab.evaluate.measurements import MEASUREMENTS
    from engine.lab.evaluate.report import cell_text, write_report
    from engine.lab.evaluate.study import Options
    from engine.lab.evaluate.suites import find_study
    from engine.raster.cuda import find_device

    study = find_study(suite)
    if out is None and suite not in MEASUREMENTS:
        raise InputError(f"the suite {suite!r} writes figures and a report: name a folder with --out")
    given = {
        "quick": quick or None,
        "settings": tuple(setting) if setting else None,
        "profile": profile,
        "trials": trials,
        "methods": tuple(method) if method else None,
        "device": None if device == "cpu" else find_device(device),
        "lpips_weights": None if lpips_weights is None else str(lpips_weights),
    }
    common = Options(_scenes(scene), seed=seed)
    options = replace(common, **_known(given, study.knows, suite))
    cells = study.cells(options)
    report: dict[str, Any] = {"suite": suite, "cells": len(cells), "machine": machine_info()}
    with console.progress() as progress, tempfile.TemporaryDirectory() as spare:
        prepare_kernels(console, progress, "everything")
        try:
            rows = run_cells(cells, (out or Path(spare)) / "cells", workers=workers, dask=dask, tell=progress)
        except InputError as error:  # of a user's own file: the cell's name says nothing more
            raise error.__cause__ if isinstance(error.__cause__, Mark3DGSError) else error from None
        progress("report", 0.0)
        if out is not None:
            report |= write_report(study, rows, options, out)
    if suite in MEASUREMENTS:
        rows = [{name: value for name, value in row.items() if name != "cell"} for row in rows]
        for row in rows:
            fields = (f"{name}={_text(value)}" for name, value in row.items() if not isinstance(value, dict))
            console.say("  ".join(fields))
        report |= MEASUREMENTS[suite].conditions(options) | {"rows": rows}
    for bar in report.get("bars", ()):
        word = {True: "met", False: "MISSED", None: "not measured"}[bar["met"]]
        console.say(f"{word:<13} {bar['what']}: {cell_text(bar['measured'])} (wanted {bar['wanted']})")
    if out is not None:
        console.say(f"\n{len(cells)} cells; report: {report['report']}")
    console.emit(report)
    return 0


def _scenes(given: list[Path] | None) -> tuple[str, ...]:
    scenes = tuple(str(path.resolve()) for path in given or [shipped_scene()])
    for path in scenes:
        if not Path(path).is_file():
            raise InputError(f"{path}: no such file")
    return scenes


def _known(given: dict[str, Any], known: frozenset[str], suite: str) -> dict[str, Any]:
    """The options that were given; InputError for one that the suite does not have."""
    found = {name: value for name, value in given.items() if value is not None}
    for name in found:
        if name not in known:
            option = {"settings": "setting", "methods": "method"}.get(name, name.replace("_", "-"))
            raise InputError(f"the suite {suite!r} has no option --{option}")
    return found


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
