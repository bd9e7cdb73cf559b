"""`mark3dgs verify`: does this model, or do these pictures, carry the mark?"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from engine.cli.claim_text import claim_lines
from engine.cli.console import Console
from engine.cli.failures import VERDICT_CODES
from engine.cli.files import are_pictures, read_bytes
from engine.cli.kernels import prepare_kernels
from engine.cli.models import load_suspect, repair_entries
from engine.cli.options import Json, Key, SpzFrame

if TYPE_CHECKING:
    from engine.pipeline.sealing import OpenedRecord
    from engine.pipeline.verification import Verification


def verify(
    suspects: Annotated[
        list[Path], typer.Argument(metavar="MODEL|PICTURE...", help="One model, or one or more pictures of one model.")
    ],
    record: Annotated[Path, typer.Option("--record", help="Record of the embedding.")],
    key: Key,
    cameras: Annotated[
        Path | None,
        typer.Option("--cameras", help="Cameras of the pictures, in their order; found by search if left out."),
    ] = None,
    false_claim_rate: Annotated[
        float, typer.Option("--false-claim-rate", metavar="P", help="Largest acceptable chance of a false claim.")
    ] = 1e-9,
    route: Annotated[
        str,
        typer.Option(
            "--route", metavar="auto|model|render|image", help="Evidence: the Gaussians, their renders, or pictures."
        ),
    ] = "auto",
    decoder: Annotated[
        str, typer.Option("--decoder", metavar="ours|paper", help="How bits are read; the claim is the same.")
    ] = "ours",
    spz_frame: SpzFrame = "auto",
    json: Json = False,
) -> int:
    """Search a suspect for a mark, and say how sure the answer is.

    The suspect may have been moved, cropped, thinned, converted or put into
    another scene; of a picture, neither camera nor focal length need be known.
    Several pictures are read together.

    Exit codes: 0 marked, 3 not marked, 4 inconclusive, 2 wrong key or input.

    Examples:

      mark3dgs verify suspect.ply --record my.record --key owner.key
      mark3dgs verify a.png b.jpg --record my.record --key owner.key
      mark3dgs verify suspect.spz --record my.record --key owner.key --json
    """
    console = Console(json)
    began = time.perf_counter()
    pictures = are_pictures(suspects, cameras)

    from engine.pipeline.sealing import open_record
    from engine.pipeline.searching import verify as search_for
    from engine.pipeline.verification import VerifyConfig
    from engine.watermark.keys import OwnerKey

    config = VerifyConfig(false_claim_rate=false_claim_rate, route=route, decoder=decoder)
    owner = OwnerKey.read(key)
    with console.progress() as progress:
        started = time.perf_counter()
        progress("open record", 0.0)
        opened = open_record(read_bytes(record, "record"), owner)
        open_seconds = time.perf_counter() - started
        compile_seconds = prepare_kernels(console, progress, "pictures" if pictures else "model")
        started = time.perf_counter()
        suspect, repairs = load_suspect(console, suspects, cameras, progress, spz_frame)
        read_seconds = time.perf_counter() - started
        found = search_for(suspect, opened, config, progress)
    report = claim_report(found, opened) | {
        "suspects": [str(path) for path in suspects],
        "repairs": repair_entries(repairs),
        "seconds": time.perf_counter() - began,
    }
    report["seconds_by_stage"] = {
        "open record": open_seconds,
        "compile": compile_seconds,
        "read": read_seconds,
        **found.seconds_by_stage,
    }
    for line in claim_lines(report, ", ".join(report["suspects"])):
        console.say(line)
    console.emit(report)
    return VERDICT_CODES[report["verdict"]]


def claim_report(found: Verification, opened: OpenedRecord) -> dict[str, Any]:
    """Keys of `verify --json`: the claim, and the record it speaks of."""
    header = opened.header
    return found.report() | {
        "record_id": header.record_id,
        "owner": header.owner,
        "registered_at": header.registered_at,
        "original_sha256": header.original_digest,
    }
