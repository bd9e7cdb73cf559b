"""`mark3dgs bench`: speed and robustness measured here and now, as numbers a reader can make again."""

import json as json_text
from pathlib import Path
from typing import Annotated, Any

import typer

from engine.cli.bench_jobs import BENCHES, Job
from engine.cli.console import Console
from engine.cli.files import check_target, whole_file
from engine.cli.kernels import prepare_kernels
from engine.cli.models import shipped_scene
from engine.cli.options import Json, Seed
from engine.errors import InputError
from engine.numerics.plain import plain


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
            "--trials", min=1, help="Screenshots (50), epochs (500), wrong keys (100,000) or innocent copies (10,000)."
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
    json: Json = False,
) -> int:
    """Measure on real scenes.

    raster       milliseconds forward and backward, against a plain loop
    embed        seconds by stage and peak memory
    verify       seconds for a model, a picture, a screenshot of unknown camera
    fidelity     dB, SSIM and bits for every message length, compact output and pruning budgets
    attacks      bits, z and claim after every attack of the bars
    screenshots  claims from pictures of unknown camera, and from another scene's
    finetune     claims after training on clean or own pictures, at the key views or others (Table 5)
    truth        false claims among wrong keys, against the proven bound
    suite        every attack of the simulator, with what it costs the attacker; failures first
    variants     2DGS, 4DGS, Compact3D and DreamGaussian models, made from the scene (Table 4)
    collusion    buyers who put their copies together: who is named, and whether an innocent is
    retrain      claims from fresh models trained on renders of the marked one
    life         speed of physics and of training

    Examples:

      mark3dgs bench embed --scene city.sog --repeats 5
      mark3dgs bench attacks --scene city.sog --scene plant.splat --out a.json
    """
    console = Console(json)
    scenes = scene or [shipped_scene()]
    if what not in BENCHES:
        raise InputError(f"nothing is measured under the name {what!r}; there are {', '.join(BENCHES)}")
    if out is not None:
        check_target(out)
    from engine.numerics.machine import machine_info

    with console.progress() as progress:
        prepare_kernels(console, progress, "everything")
        progress(what, 0.0)
        job = Job(
            scenes,
            profile,
            repeats,
            trials,
            size,
            seed,
            lambda fraction: progress(what, fraction),
            setting or [],
            colors_only,
        )
        found = BENCHES[what](job)
    report = {"bench": what, "machine": machine_info(), **found}
    for row in report["rows"]:
        console.say("  ".join(f"{name}={_text(value)}" for name, value in row.items() if not isinstance(value, dict)))
    if out is not None:
        with whole_file(out) as part:
            part.write_text(json_text.dumps(plain(report), indent=1) + "\n")
        console.say(f"report: {out}")
    console.emit(report)
    return 0


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
