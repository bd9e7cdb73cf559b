"""`mark3dgs embed`: the marked model and the record that proves it."""

from __future__ import annotations

import time
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from engine.cli.console import Console
from engine.cli.files import check_target, read_bytes, refuse_same, whole_file, write_secret
from engine.cli.kernel_progress import prepare_kernels
from engine.cli.models import check_output, format_for, say_repairs, whole_output
from engine.cli.options import Json, Key, Knobs, SpzFrame
from engine.cli.read_ahead import Ahead
from engine.errors import InputError

COPY = "{copy}"
"""In the name of a file: the recipient's name."""


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
            help="fast, balanced, strong; auto: no more than the scene needs; paper, paper-appendix: as published.",
        ),
    ] = "balanced",
    psnr: Annotated[
        float | None, typer.Option("--psnr", metavar="DB", help="Least PSNR of the mark, worst key view (default 47).")
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
        typer.Option("--copy", metavar="NAME", help="Recipient: each has a mark of its own. Repeatable, see below."),
    ] = None,
    earlier: Annotated[
        Path | None,
        typer.Option("--earlier", metavar="RECORD", help="Of another copy of this model: saves time, see below."),
    ] = None,
    registered_at: Annotated[
        str, typer.Option("--registered-at", metavar="TEXT", help="Self-declared time of registration, or 'now'.")
    ] = "",
    knobs: Knobs = None,
    spz_frame: SpzFrame = "auto",
    force: Annotated[bool, typer.Option("--force", help="Replace an existing record.")] = False,
    json: Json = False,
) -> int:
    """Hide a mark in a model.

    Writes the marked model, which looks the same, and a record, which proves
    the mark later, together with the key. Publish the model; keep the original,
    the record and the key. Same model, key and settings: same files.

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
    """
    console = Console(json)
    began = time.perf_counter()
    targets, kind = _targets(copy or [""], out, record), format_for(out, model)
    for marked, kept in targets.values():
        refuse_same(model, marked)
        check_output(marked, kind)
        check_target(kept, overwrite=force)
        if marked.absolute() == kept.absolute():
            raise InputError("the marked model and the record need different names")
    if message is not None and bits is not None:
        raise InputError("give --message or --bits, not both: a message has a length of its own")
    from engine.scenes.scene_files import read_scene

    reading = Ahead(read_scene, model, spz_frame=spz_frame)

    from engine.flows.embed.embedding import embed_copies
    from engine.flows.embed.profiles import compose, delivered_as
    from engine.formats import read_cameras
    from engine.model import GaussianModel
    from engine.records.record import Record
    from engine.scenes.scene_files import notes_of, write_scene, written_as
    from engine.scenes.scene_marking import embed_variant
    from engine.watermark.keys import OwnerKey
    from engine.watermark.messages import check_bits, message_signs

    config = compose(profile, psnr_db=psnr, output=output, budget_db=_decibels(budget), knobs=knobs or ())
    signs = message_signs(message) if message is not None else None
    check_bits(bits or 32)
    owner = OwnerKey.read(key)
    when = datetime.now(UTC).isoformat(timespec="seconds") if registered_at == "now" else registered_at
    views = read_cameras(cameras) if cameras is not None else None
    before = Record.from_bytes(read_bytes(earlier, "record"), owner) if earlier is not None else None

    with console.progress() as progress:
        started = time.perf_counter()
        progress("read", 0.0)
        loaded = reading.result()
        kind = written_as(loaded, kind)
        read_seconds = time.perf_counter() - started
        compile_seconds = prepare_kernels(console, progress)
        request: dict[str, Any] = {
            "original_sha256": loaded.sha256,
            "message": signs,
            "bits": bits or 32,
            "config": delivered_as(config, kind),
            "cameras": views,
            "registered_at": when,
            "progress": progress,
            "earlier": before,
        }
        marks = (
            ((made.model, made) for made in embed_copies(loaded.scene, owner, list(targets), **request))
            if isinstance(loaded.scene, GaussianModel)
            else embed_variant(loaded, owner, list(targets), **request)
        )
        reports: list[dict[str, Any]] = []
        for (scene, made), (marked, kept) in zip(marks, targets.values(), strict=True):
            started = time.perf_counter()
            progress("write", 0.0)
            sealed = made.record.to_bytes(owner)
            # The record comes first: a record without its model is harmless, a marked model without it is lost.
            with whole_output(marked, kind) as model_part:
                bytes_out = write_scene(scene, model_part, kind)
                with whole_file(kept, overwrite=force) as record_part:
                    write_secret(record_part, sealed)
            once = {"compile": compile_seconds, "read": read_seconds} if not reports else {}
            reports.append(
                {
                    **made.report,
                    "out": str(marked),
                    "record": str(kept),
                    "bytes_in": loaded.source_bytes,
                    "bytes_out": bytes_out,
                    "record_bytes": len(sealed),
                    "format_in": loaded.format,
                    "format_out": kind,
                    "profile": profile,
                    "repairs": [asdict(repair) for repair in loaded.repairs],
                    "notes": notes_of(scene, kind),
                    "seconds": time.perf_counter() - began,
                    "seconds_by_stage": once
                    | made.report["seconds_by_stage"]
                    | {"write": time.perf_counter() - started},
                }
            )
            began = time.perf_counter()

    say_repairs(console, loaded.repairs)
    for report in reports:
        _say(console, report, model)
    console.emit(reports[0] if len(reports) == 1 else {"copies": reports})
    return 0


def _targets(copies: list[str], out: Path, record: Path) -> dict[str, tuple[Path, Path]]:
    """Marked model and record of each copy."""
    places = [COPY in str(path) for path in (out, record)]
    if len(copies) > 1 and not all(places):
        raise InputError(f"several copies need {COPY} in the names of model and record, such as '{COPY}.ply'")
    targets = {}
    for copy in copies:
        if copy in targets:
            raise InputError(f"copy {copy!r} is given twice")
        if any(places) and (copy in ("", "..") or Path(copy).name != copy):
            raise InputError(f"copy {copy!r} cannot stand in a file's name: name the files yourself")
        targets[copy] = (Path(str(out).replace(COPY, copy)), Path(str(record).replace(COPY, copy)))
    return targets


def _decibels(budget: str) -> float | None:
    """A pruning budget as it is typed: a number of dB, or `none`."""
    try:
        return None if budget.lower() == "none" else float(budget)
    except ValueError:
        raise InputError(f"budget must be a number of dB or 'none', got {budget!r}") from None


def _say(console: Console, report: dict[str, Any], model: Path) -> None:
    stages = ", ".join(f"{name} {seconds:.1f}" for name, seconds in report["seconds_by_stage"].items())
    fit = f"{report['picture_bits']} fit a picture, {report['capacity_bits']} a model"
    lines = {
        "message": f"{report['message']} ({report['bits']} bits; {fit})",
        "fidelity": f"{report['psnr_worst_view']:.2f} dB, SSIM {report['ssim_worst_view']:.4f}"
        " (mark alone, worst key view)",
        "in total": f"{report['psnr_total_worst_view']:.2f} dB, with pruning and quantisation",
        "Gaussians": f"{report['gaussians_in']:,} -> {report['gaussians_out']:,}",
        "strength": f"{report['predicted_z_per_bit']:.0f} standard deviations a bit, predicted, from one bad picture",
        "files": f"model {size(report['bytes_out'])}, record {size(report['record_bytes'])}",
        "time": f"{report['seconds']:.1f} s: {stages}",
    }
    if (choice := report["choice"]) is not None:
        lines["chosen"] = (
            f"{choice['views']} views of {choice['view_size']}, {choice['psnr_db']:g} dB: z of one bad picture"
            f" {choice['predicted_z']:.0f} predicted, {choice['wanted_z']:.0f} wanted"
        )
        if (spent := choice["spent"]) is not None:
            lines["allowed"] = _spending(spent)
    if report["psnr_total_worst_view"] > report["psnr_worst_view"] - 0.1:
        del lines["in total"]
    console.say(f"Marked {model} -> {report['out']}")
    for label, text in lines.items():
        console.say(f"  {label:<11} {text}")
    for note in report["notes"]:
        console.say(f"  {'note':<11} {note}")
    console.say(
        f"Keep {report['record']} and your key: together they prove the mark. Keep the unmarked original private."
    )


def _spending(spent: dict[str, Any]) -> str:
    """On what an allowance went, for people."""
    allowed = f"{spent['allowed_db']:g} dB"
    way = next((way for way in spent["ways"] if way["sh_degree"] == spent["sh_degree"]), None)
    if way is None:
        return f"{allowed}: kept whole, since no smaller file shows the mark well enough"
    file = f"{size(way['bytes'])} instead of {size(spent['bytes_whole'])}"
    return f"{allowed}: pruned, harmonics to degree {way['sh_degree']}: {file}"


def size(count: int) -> str:
    """A number of bytes for people."""
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{count / 1e3:.1f} kB"
