"""`mark3dgs sim`: play a scenario and verify the marks after each step."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from engine.cli.console import Console
from engine.cli.kernel_progress import prepare_kernels
from engine.cli.options import Json
from engine.errors import InputError
from engine.present.numerals import PLAIN
from engine.usecases.files import whole_file

if TYPE_CHECKING:
    from engine.lab.sim.scenario import Run, StepResult
    from engine.lab.sim.scenario.state import Finding

COLUMNS = f"{'step':<44} {'object':<14} {'verdict':<12} {'bits':>7} {'z':>7} {'false claim':<21} {'PSNR':>6}"


def _list_steps(console: Console) -> int:
    """All kinds of steps, one line each."""
    from engine.lab.sim.scenario import KINDS

    for word, kind in KINDS.items():
        console.say(f"  {word:<12} {kind.summary}")
    console.emit({"steps": [{"step": word, "summary": kind.summary} for word, kind in KINDS.items()]})
    return 0


def sim(
    scenario: Annotated[
        Path | None, typer.Argument(metavar="SCENARIO.toml", help="What happens, in order.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for table, pictures and film; made if missing.")
    ] = None,
    keep_model: Annotated[
        bool, typer.Option("--keep-model", help="Also write the model as it is at the end (model.ply).")
    ] = False,
    steps: Annotated[bool, typer.Option("--steps", "--list", help="List all kinds of steps, one line each.")] = False,
    json: Json = False,
) -> int:
    """Play a scenario: edits, physics, attacks; verify every mark after each step.

    The scenario is a TOML file: tables of objects (models, marked at the start)
    and of steps; docs/SIMULATOR.md explains it, docs/scenarios has
    examples. Writes report.json, report.md, a picture a step, and film.webp.

    Examples:

      mark3dgs sim --steps
      mark3dgs sim docs/scenarios/theft.toml --out theft
    """
    console = Console(json)
    if steps:
        return _list_steps(console)
    if scenario is None or out is None:
        raise InputError("name a SCENARIO.toml and, with --out, the folder to write; --steps lists all steps")
    from engine.lab.sim.scenario import read_scenario, run_scenario

    plan = read_scenario(scenario)
    if out.exists() and not out.is_dir():
        raise InputError(f"{str(out)!r} is a file; --out names a folder")
    out.mkdir(parents=True, exist_ok=True)
    console.say(plan.title)
    console.say(COLUMNS)

    def show(result: StepResult) -> None:
        for line in table_lines(result):
            console.say(line)

    with console.progress() as progress:
        prepare_kernels(console, progress, "model")
        run = run_scenario(plan, progress, show)
        progress("write", 0.0)
        report = _write(run, out, keep_model)
    console.say(f"\nwritten to {out}: {', '.join(report['files'])}")
    console.emit(report)
    return 0


def table_lines(result: StepResult) -> list[str]:
    """The rows of one step, as text."""
    lines = []
    for k, found in enumerate(result.findings):
        cost = found.psnr_cost
        lines.append(
            f"{result.label[:44] if k == 0 else '':<44} {found.object[:14]:<14} {found.verdict:<12}"
            f" {found.matching_bits:>3}/{found.bits:<3} {found.z:>7.1f} {PLAIN.odds(found.log10_false_claim):<21}"
            f" {'' if cost is None or not math.isfinite(cost) else f'{cost:.1f}':>6}"
        )
    return lines or [f"{result.label[:44]:<44} (no marked object)"]


def cost_text(found: Finding) -> str:
    """What the step cost the look, in words; empty where it is no attack."""
    psnr, coverage, covered = found.psnr_cost, found.coverage, found.covered_psnr
    if psnr is None or coverage is None:
        return ""
    if not math.isfinite(psnr):
        return "none"
    if coverage > 0.9 or covered is None:
        return f"{psnr:.1f} dB"
    return f"{100 * coverage:.0f} % is left" + (f", at {covered:.1f} dB" if math.isfinite(covered) else "")


def _write(run: Run, out: Path, keep_model: bool) -> dict[str, Any]:
    """All files of a run, each whole or not there."""
    import json

    from PIL import Image

    from engine.lab.sim.scenario.film import write_movie
    from engine.numerics.plain import plain

    files = []
    for number, result in enumerate(run.results):
        name = f"step-{number:02d}.png"
        with whole_file(out / name) as part:
            Image.fromarray(result.picture).save(part, "PNG")
        files.append(name)
    if run.frames:
        with whole_file(out / "film.webp") as part:
            write_movie(part, run.frames, run.scenario.film.rate)
        files.append("film.webp")
    if keep_model:
        from engine.formats import write_model

        with whole_file(out / "model.ply") as part:
            write_model(run.model, part, "ply")
        files.append("model.ply")
    steps = [
        {"label": r.label, "seconds": r.seconds, "notes": list(r.notes), "found": [asdict(each) for each in r.findings]}
        for r in run.results
    ]
    report = {
        "title": run.scenario.title,
        "seed": run.scenario.seed,
        "steps": steps,
        "files": [*files, "report.json", "report.md"],
    }
    with whole_file(out / "report.json") as part:
        part.write_text(json.dumps(plain(report), indent=1, allow_nan=False) + "\n")
    with whole_file(out / "report.md") as part:
        part.write_text(_markdown(run))
    return report


def _markdown(run: Run) -> str:
    """The table as Markdown, with the pictures."""
    lines = [
        f"# {run.scenario.title}",
        "",
        "Reading is informed: it uses the owner's record, which holds the unmarked original.",
        "",
        "| step | object | verdict | bits | z | chance of a false claim | cost to the look | seconds |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for result in run.results:
        for found in result.findings:
            lines.append(
                f"| {result.label} | {found.object} | {found.verdict.replace('_', ' ')}"
                f" | {found.matching_bits} of {found.bits} | {found.z:.1f}"
                f" | {PLAIN.odds(found.log10_false_claim)} | {cost_text(found)} | {found.seconds:.1f} |"
            )
    lines += [""] + [f"- {result.label}: {note}" for result in run.results for note in result.notes]
    lines += ["", "![film](film.webp)", ""] if run.frames else [""]
    lines += [f"![{r.label}](step-{k:02d}.png)" for k, r in enumerate(run.results)]
    return "\n".join(lines) + "\n"
