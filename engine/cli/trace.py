"""`mark3dgs trace`: which recipients' copies does this suspect derive from?"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from engine.cli.console import Console
from engine.cli.failures import MARKED, NOT_MARKED
from engine.cli.kernel_progress import prepare_kernels
from engine.cli.options import Json, Key
from engine.errors import InputError
from engine.present.numerals import PLAIN
from engine.usecases.suspect import SuspectFiles

if TYPE_CHECKING:
    from engine.flows.trace.tracing import Tracing
    from engine.usecases.suspect import ReadSuspect

SHOWN = 10
"""Copies listed; all that are named where these are more."""


def trace(
    suspects: Annotated[
        list[Path], typer.Argument(metavar="MODEL|PICTURE...", help="One model, or one or more pictures of one model.")
    ],
    records: Annotated[
        list[Path], typer.Option("--records", help="Folder of records (*.record), or a record; repeatable.")
    ],
    key: Key,
    cameras: Annotated[
        Path | None, typer.Option("--cameras", help="Cameras of the pictures; found by search if left out.")
    ] = None,
    false_claim_rate: Annotated[
        float,
        typer.Option(
            "--false-claim-rate", metavar="P", help="Largest acceptable chance that any innocent copy is named."
        ),
    ] = 1e-9,
    json: Json = False,
) -> int:
    """Traitor tracing: identify the recipients whose copies the suspect derives from.

    Several recipients are named if several copies were combined. The bound on
    naming an innocent recipient is corrected for every record that was tested.

    Exit codes: 0 some copy is named, 3 none is, 2 wrong key or input.

    Examples:

      mark3dgs trace suspect.ply --records sold/ --key owner.key
      mark3dgs trace a.png b.png --records sold/ --key owner.key --json
    """
    console = Console(json)
    began = time.perf_counter()
    source, files = SuspectFiles.sort_out(suspects, cameras), _files(records)

    from engine.flows.verify.search import VerifyConfig
    from engine.usecases.trace import TraceRequest
    from engine.usecases.trace import trace as trace_copies
    from engine.watermark.keys import OwnerKey

    config = VerifyConfig(false_claim_rate=false_claim_rate)
    request = TraceRequest(suspect=source, records=files, key=OwnerKey.read(key), config=config)
    with console.progress() as progress:

        def prepare(read: ReadSuspect) -> None:
            console.note_repairs(read.repairs)
            prepare_kernels(console, progress, "pictures" if source.pictures else "model")

        found = trace_copies(request, progress, prepare).tracing
    report = found.to_json() | {
        "suspects": [str(path) for path in source.paths],
        "seconds": time.perf_counter() - began,
    }
    console.say(*_lines(found))
    console.emit(report)
    return MARKED if found.named else NOT_MARKED


def _files(places: list[Path]) -> list[Path]:
    files: list[Path] = []
    for place in places:
        inside = sorted(place.glob("*.record")) if place.is_dir() else [place]
        if not inside:
            raise InputError(f"{place}: no file in this folder ends in .record")
        files += inside
    return files


def _lines(found: Tracing) -> list[str]:
    findings, named = found.findings, len(found.named)
    tested = f"{len(findings)} {'copy' if len(findings) == 1 else 'copies'} tested"
    names = ", ".join(repr(finding.copy) for finding in found.named)
    lines = [f"NAMED: {names}; {tested}." if named else f"NONE NAMED; {tested}.", ""]
    lines.append(f"{'copy':<28}{'z':>8}  {'false claim':<21}  {'asset found':>11}  record")
    for finding in findings[: max(SHOWN, named)]:
        share = finding.derived_fraction
        lines.append(
            f"{finding.copy[:27]:<28}{finding.z:>8.1f}  {PLAIN.odds(finding.log10_false_claim):<21}  "
            f"{'' if share is None else f'{100 * share:.0f} %':>11}  {finding.record_id}"
        )
    if len(findings) > max(SHOWN, named):
        lines.append(f"... and {len(findings) - max(SHOWN, named)} more, all below")
    tried = f"{found.tries:,} {'hypothesis' if found.tries == 1 else 'hypotheses'}"
    lines += ["", f"A copy is named from z = {found.z_threshold:.2f} on: the chance that any innocent one"]
    lines.append(f"reaches it is at most {PLAIN.rate(found.false_claim_rate)}, corrected for {tried}.")
    return lines + list(found.notes)
