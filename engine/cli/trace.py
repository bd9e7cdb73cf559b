"""`mark3dgs trace`: which of the copies I gave away took part in this suspect?"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from engine.cli.console import Console
from engine.cli.failures import MARKED, NOT_MARKED
from engine.cli.kernel_progress import prepare_kernels
from engine.cli.models import load_suspect
from engine.cli.options import Json, Key
from engine.errors import InputError
from engine.usecases.files import are_pictures, pictures_within, read_bytes

if TYPE_CHECKING:
    from engine.flows.records.opened_record import OpenedRecord

SHOWN = 10
"""Copies listed beside those named."""


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
    """Name the copies behind a suspect: one reading, every record of a folder.

    Several are named when several buyers put their copies together. The bound on
    naming an innocent one counts every record that was asked about.

    Exit codes: 0 some copy is named, 3 none is, 2 wrong key or input.

    Examples:

      mark3dgs trace suspect.ply --records sold/ --key owner.key
      mark3dgs trace a.png b.png --records sold/ --key owner.key --json
    """
    console = Console(json)
    began = time.perf_counter()
    suspects = pictures_within(suspects)
    pictures = are_pictures(suspects, cameras)
    files = _files(records)

    from engine.flows.records.opened_record import open_record
    from engine.flows.trace.tracing import trace as search_for_copies
    from engine.flows.verify.verification import VerifyConfig
    from engine.watermark.keys import OwnerKey

    config, owner = VerifyConfig(false_claim_rate=false_claim_rate), OwnerKey.read(key)

    class Opened:
        """The records, opened one at a time, as often as they are asked for."""

        def __iter__(self) -> Iterator[OpenedRecord]:
            return (open_record(read_bytes(file, "record"), owner) for file in files)

    with console.progress() as progress:
        prepare_kernels(console, progress, "pictures" if pictures else "model")
        suspect, _ = load_suspect(console, suspects, cameras, progress)
        found = search_for_copies(suspect, Opened(), config, progress)
    report: dict[str, Any] = found.to_json() | {
        "suspects": [str(path) for path in suspects],
        "seconds": time.perf_counter() - began,
    }
    for line in _lines(report):
        console.say(line)
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


def _lines(report: dict[str, Any]) -> list[str]:
    findings, named = report["findings"], len(report["named"])
    asked = f"{len(findings)} {'copy' if len(findings) == 1 else 'copies'} asked about"
    names = ", ".join(repr(name) for name in report["named"])
    lines = [f"NAMED: {names}; {asked}." if named else f"NOBODY NAMED; {asked}.", ""]
    lines.append(f"{'copy':<28}{'z':>8}  {'false claim':>12}  {'asset found':>11}  record")
    for finding in findings[: max(SHOWN, named)]:
        share = finding["derived_fraction"]
        lines.append(
            f"{finding['copy'][:27]:<28}{finding['z']:>8.1f}  {_bound(finding['log10_false_claim']):>12}  "
            f"{'' if share is None else f'{100 * share:.0f} %':>11}  {finding['record_id']}"
        )
    if len(findings) > max(SHOWN, named):
        lines.append(f"... and {len(findings) - max(SHOWN, named)} more, all below")
    lines += ["", f"A copy is named from z = {report['z_threshold']:.2f} on: the chance that any innocent one"]
    lines.append(f"reaches it is at most {report['false_claim_rate']:g}, all {report['tries']} tries counted.")
    return lines + list(report["notes"])


def _bound(log10: float) -> str:
    return "no better" if log10 >= 0 else f"1e{log10:.0f}"
