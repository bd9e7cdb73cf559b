"""`mark3dgs embed`: the marked model and the record that proves it."""

from __future__ import annotations

import time
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from engine.cli.console import Console
from engine.cli.kernel_progress import prepare_kernels
from engine.cli.options import Device, Key, Knobs, SpzFrame
from engine.cli.options import Json as AsJson
from engine.errors import InputError
from engine.numerics.plain import Report
from engine.usecases.files import format_for, read_bytes

if TYPE_CHECKING:
    from engine.flows.embed.auto_profile import Spent
    from engine.flows.embed.draws import Stamp
    from engine.scenes.scene_files import Loaded
    from engine.usecases.mark import MarkOutput, MarkReport

COPY = "{copy}"
"""In the name of a file: the recipient's name."""
TOLD_DB = 0.05
"""Least difference that rounding by the format makes to a PSNR that is printed."""


def embed(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL", help="Model, clip or codebook folder to mark; see docs/FORMATS.md.")
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Marked model to write; its ending names the format.")],
    key: Key,
    record: Annotated[Path, typer.Option("--record", help="Record to write (mode 0600): keep it.")],
    message: Annotated[
        str | None, typer.Option("--message", metavar="HEX", help="16 to 256 bits; drawn from the key if left out.")
    ] = None,
    bits: Annotated[
        int | None, typer.Option("--bits", metavar="N", help="Length of a drawn message (default 32).")
    ] = None,
    profile: Annotated[
        str,
        typer.Option(
            "--profile",
            metavar="P",
            help="auto: no more than the scene needs; fast, balanced, strong; paper, paper-appendix: as published.",
        ),
    ] = "auto",
    survive: Annotated[
        str | None,
        typer.Option(
            "--survive",
            metavar="model|pictures|worst",
            help="auto: what must still show the mark; one JPEG-10 picture (default), the worst one, or models alone.",
        ),
    ] = None,
    psnr: Annotated[
        float | None, typer.Option("--psnr", metavar="DB", help="Least PSNR of the mark (47; auto: down to 45).")
    ] = None,
    budget: Annotated[
        str,
        typer.Option(
            "--budget",
            metavar="DB|none",
            help="Prune to this PSNR against the original; auto: spend that loss as it pays; none: keep all.",
        ),
    ] = "none",
    output: Annotated[
        str | None,
        typer.Option("--output", metavar="fidelity|compact", help="Keep each Gaussian's residual, or drop it."),
    ] = None,
    cameras: Annotated[
        Path | None,
        typer.Option("--cameras", help="cameras.json, transforms.json or COLMAP folder; else views are generated."),
    ] = None,
    copy: Annotated[
        list[str] | None,
        typer.Option("--copy", metavar="NAME", help="Recipient, whom trace names. Repeatable, see below."),
    ] = None,
    earlier: Annotated[
        Path | None,
        typer.Option("--earlier", metavar="RECORD", help="Record of another copy of this model: faster, see below."),
    ] = None,
    registered_at: Annotated[
        str, typer.Option("--registered-at", metavar="TEXT", help="Self-declared time of registration, or 'now'.")
    ] = "",
    tsa: Annotated[
        str | None,
        typer.Option("--tsa", metavar="URL", help="Time-stamping service (RFC 3161) that draws a part, see below."),
    ] = None,
    device: Device = "cpu",
    knobs: Knobs = None,
    spz_frame: SpzFrame = "auto",
    force: Annotated[bool, typer.Option("--force", help="Replace an existing record.")] = False,
    json: AsJson = False,
) -> int:
    """Hide a mark in a model.

    Writes the marked model, which looks the same, and a record, which proves
    the mark later, together with the key. Publish the model; keep the original,
    the record and the key. Same model, key and settings: same files, unless a GPU
    fits (--device): then mark all copies in one command.

    Examples:

      mark3dgs embed scene.ply marked.ply --key owner.key --record my.record
      mark3dgs embed scene.ply small.sog --key owner.key --record my.record \\
        --output compact --budget 40
      mark3dgs embed scene.ply acme.spz --key owner.key --record acme.record \\
        --copy acme --message c0ffee42

    Of several copies each further one takes a fraction of the first one's time;
    {copy} in both names stands for the recipient's. --json lists them under
    "copies":

      mark3dgs embed scene.ply '{copy}.ply' --key owner.key \\
        --record '{copy}.record' --copy acme --copy globex

    A copy made later takes what copies share from an earlier one's record; the
    files are the same as without:

      mark3dgs embed scene.ply initech.ply --key owner.key --copy initech \
        --record initech.record --earlier acme.record

    With --tsa a part of the watermark follows from a time stamp, so that records
    can hardly be tried out: a claim then counts 2^20 requests to that service
    and needs 1 in 10^9 instead of 1 in 2^128, where verify gets the service's
    certificate (--tsa-certificates). Only a digest is sent. Each run draws
    another watermark: mark further copies with --earlier, or comparing the files
    reveals both.
    """
    console = Console(json)
    began = time.perf_counter()
    if message is not None and bits is not None:
        raise InputError("give --message or --bits, not both: a message has a length of its own")

    from engine.flows.embed.profiles import compose
    from engine.flows.embed.terms import MarkTerms
    from engine.formats import read_cameras
    from engine.records.record import Record
    from engine.usecases.mark import MarkRequest, mark
    from engine.watermark.keys import OwnerKey
    from engine.watermark.messages import message_signs

    owner = OwnerKey.read(key)
    request = MarkRequest(
        model=model,
        key=owner,
        outputs=_outputs(copy or [""], out, record),
        terms=MarkTerms(
            config=compose(
                profile,
                psnr_db=psnr,
                output=output,
                budget_db=_decibels(budget),
                survive=survive,
                device=device,
                knobs=knobs or (),
            ),
            message=message_signs(message) if message is not None else None,
            bits=bits or 32,
            cameras=read_cameras(cameras) if cameras is not None else None,
            registered_at=datetime.now(UTC).isoformat(timespec="seconds") if registered_at == "now" else registered_at,
            stamp=_service(tsa) if tsa is not None else None,
            earlier=Record.from_bytes(read_bytes(earlier, "record"), owner) if earlier is not None else None,
        ),
        profile=profile,
        format=format_for(out, model),
        spz_frame=spz_frame,
        overwrite=force,
    )
    reports: list[CopyReport] = []
    compiling = 0.0
    with console.progress() as progress:

        def prepare(_: Loaded) -> None:
            nonlocal compiling
            compiling = prepare_kernels(console, progress)

        for made in mark(request, progress, prepare):
            once = {} if reports else {"compile": compiling}
            reports.append(
                CopyReport(
                    made.report,
                    out=str(made.output.model),
                    record=str(made.output.record),
                    seconds=time.perf_counter() - began,
                    seconds_by_stage=once | made.report.seconds_by_stage,
                )
            )
            began = time.perf_counter()
    console.note_repairs(reports[0].mark.repairs)
    for report in reports:
        _say(console, report, model)
    if tsa is not None and earlier is None:
        console.say(
            f"Mark further copies of this model with --earlier {reports[0].record}: otherwise another watermark is"
            " drawn, and anyone who compares the files can find both."
        )
    console.emit(reports[0] if len(reports) == 1 else {"copies": reports})
    return 0


@dataclass(frozen=True, eq=False)
class CopyReport(Report):
    """What `embed --json` reports of one copy."""

    inlined = "mark"

    mark: MarkReport
    out: str
    record: str
    seconds: float  # of the command, its share of the first copy included
    seconds_by_stage: dict[str, float]


def _service(tsa: str) -> Stamp:
    from engine.records.timestamps import require_stamp

    return partial(require_stamp, tsa)


def _outputs(copies: list[str], out: Path, record: Path) -> dict[str, MarkOutput]:
    from engine.usecases.mark import MarkOutput

    places = [COPY in str(path) for path in (out, record)]
    if len(copies) > 1 and not all(places):
        raise InputError(f"several copies need {COPY} in the names of model and record, such as '{COPY}.ply'")
    targets = {}
    for copy in copies:
        if copy in targets:
            raise InputError(f"copy {copy!r} is given twice")
        if any(places) and (copy in ("", "..") or Path(copy).name != copy):
            raise InputError(f"copy {copy!r} cannot stand in a file's name: name the files yourself")
        targets[copy] = MarkOutput(*(Path(str(path).replace(COPY, copy)) for path in (out, record)))
    return targets


def _decibels(budget: str) -> float | None:
    """A pruning budget as it is typed: a number of dB, or `none`."""
    try:
        return None if budget.lower() == "none" else float(budget)
    except ValueError:
        raise InputError(f"budget must be a number of dB or 'none', got {budget!r}") from None


def _say(console: Console, report: CopyReport, model: Path) -> None:
    stages = ", ".join(f"{name} {seconds:.1f}" for name, seconds in report.seconds_by_stage.items())
    made = report.mark.embedding
    capacity = f"capacity: {made.picture_bits:,} per image, {made.capacity_bits:,} per model"
    before, written = made.psnr_total_worst_view, report.mark.psnr_as_written
    told = f"{made.psnr_worst_view:.2f} dB, SSIM {made.ssim_worst_view:.4f} (watermark alone, worst key view)"
    rounded = f"; as .{report.mark.format_out} {written:.2f} dB" if abs(written - before) >= TOLD_DB else ""
    lines = {
        "payload": f"{made.message}, {made.bits} bits ({capacity})",
        "fidelity": told + rounded,
        "in total": f"{made.psnr_total_worst_view:.2f} dB, with pruning and quantization",
        "Gaussians": f"{made.gaussians_in:,} -> {made.gaussians_out:,}",
        "strength": (
            f"predicted z of a claim from one picture: {made.predicted_z_render:.0f} (own render of 800 x 800 pixels, "
            "JPEG 10); it varies with the view"
        ),
        "files": f"model {size(report.mark.bytes_out)}, record {size(report.mark.record_bytes)}",
        "time": f"{report.seconds:.1f} s: {stages}",
    }
    if (choice := made.choice) is not None:
        of = {"pictures": "one own render at JPEG 10", "worst": "the worst own render, at JPEG 10 or in noise of 0.1"}
        shown, reached = of.get(choice.survive), "" if choice.met else ", which is not reached"
        said = f"predicted z of {shown} {choice.predicted_z:.1f}, required {choice.wanted_z:.1f}{reached}"
        lines["chosen"] = (
            f"{choice.views} views of {choice.view_size}, {choice.psnr_db:g} dB: "
            f"{said if shown else 'no picture was tried'}"
        )
        if choice.spent is not None:
            lines["allowed"] = _spending(choice.spent)
        if choice.saved_seconds is not None and "choose" in report.seconds_by_stage:  # not of a further copy
            less = "less" if choice.saved_seconds > 0 else "more"
            seconds = f"about {abs(choice.saved_seconds):.1f} s {less} than balanced, by an estimate"
            lines["compared"] = f"{seconds}; as many bytes: only --budget saves some"
    if made.psnr_total_worst_view > made.psnr_worst_view - 0.1:
        del lines["in total"]
    console.say(f"Marked {model} -> {report.out}")
    noted = [*lines.items(), *(("note", note) for note in report.mark.notes)]
    console.say(*(f"  {label:<11} {text}" for label, text in noted))
    console.say(
        f"Keep {report.record} and your key: together they prove the watermark. Keep the unmarked original private."
    )


def _spending(spent: Spent) -> str:
    allowed = f"{spent.allowed_db:g} dB"
    way = next((way for way in spent.ways if way.sh_degree == spent.sh_degree), None)
    if way is None:
        return f"{allowed}: not pruned, because no smaller file keeps the watermark readable"
    file = f"{size(way.bytes)} instead of {size(spent.bytes_whole)}"
    return f"{allowed}: pruned, harmonics to degree {way.sh_degree}: {file}"


def size(count: int) -> str:
    """A number of bytes for people."""
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{count / 1e3:.1f} kB"
