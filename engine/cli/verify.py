"""`mark3dgs verify`: does this model, or do these pictures, carry the mark?"""

from __future__ import annotations

import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from engine.cli.claim_text import claim_lines
from engine.cli.console import Console
from engine.cli.failures import VERDICT_CODES
from engine.cli.kernel_progress import prepare_kernels
from engine.cli.models import read_suspect, say_repairs
from engine.cli.options import Json, Key, SpzFrame
from engine.cli.regions import region_lines, write_regions
from engine.cli.trust_options import Jwks, TsaCertificates, read_attestation, read_trust
from engine.errors import InputError
from engine.usecases.files import are_pictures, check_folder, pictures_within, read_bytes
from engine.usecases.read_ahead import Ahead

MOVING = "moving"
"""Name of a record's commitment to a clip, see `engine.scenes.clip_marking`."""
WITHOUT_ORIGINAL = "the record is of a scene that moves: give --original to look for single moments of it"

if TYPE_CHECKING:
    from engine.flows.records.opened_record import OpenedRecord
    from engine.flows.verify.verification import Verification


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
        float,
        typer.Option(
            "--false-claim-rate", metavar="P", help="Largest acceptable chance of a false claim, where stricter."
        ),
    ] = 1e-9,
    route: Annotated[
        str,
        typer.Option(
            "--route", metavar="auto|model|render|image", help="Evidence: the Gaussians, their renders, or pictures."
        ),
    ] = "auto",
    attestation: Annotated[
        list[Path] | None,
        typer.Option("--attestation", help="Somebody's word on the record's date, beside those in it; repeatable."),
    ] = None,
    tsa_certificates: TsaCertificates = None,
    jwks: Jwks = None,
    suspect_seen: Annotated[
        str, typer.Option("--suspect-seen", metavar="DATE", help="Since when the suspect is known, such as 2026-11-03.")
    ] = "",
    original: Annotated[
        Path | None,
        typer.Option("--original", help="Unmarked clip, of a record of a scene that moves: moments are looked for."),
    ] = None,
    regions: Annotated[
        Path | None,
        typer.Option(
            "--regions",
            metavar="FOLDER",
            help="New folder for where the mark is: regions.png, .json (pieces, each with its transform, and regions)"
            " and .npz (piece, region and state of every Gaussian of the suspect). Keep it like the record.",
        ),
    ] = None,
    false_discovery_rate: Annotated[
        float,
        typer.Option(
            "--false-discovery-rate",
            metavar="Q",
            help="Of the regions called marked, the largest expected share that is not.",
        ),
    ] = 0.01,
    decoder: Annotated[
        str, typer.Option("--decoder", metavar="ours|paper", help="How bits are read; the claim is the same.")
    ] = "ours",
    spz_frame: SpzFrame = "auto",
    json: Json = False,
) -> int:
    """Search a suspect for a mark, and say how sure the answer is.

    The suspect may have been moved, cropped, thinned, converted or put into
    another scene; of a picture, neither camera nor focal length need be known.
    Several pictures, or a folder of a video's frames, are read together.

    A claim needs 1 in 10^9 where somebody else attests that the record is older
    than the suspect (see `mark3dgs attest`), else 1 in 2^128.

    Exit codes: 0 marked, 3 not marked, 4 inconclusive, 2 wrong key or input.

    Examples:

      mark3dgs verify suspect.ply --record my.record --key owner.key
      mark3dgs verify a.png b.jpg --record my.record --key owner.key
      mark3dgs verify suspect.spz --record my.record --key owner.key --json
      mark3dgs verify scene.ply --record my.record --key owner.key --regions where
    """
    console = Console(json)
    began = time.perf_counter()
    suspects = pictures_within(suspects)
    pictures = are_pictures(suspects, cameras)
    if regions is not None:
        check_folder(regions)
        if original is not None:
            raise InputError("--regions needs a scene that stands still: leave --original out")
    reading = Ahead(read_suspect, suspects, cameras, spz_frame)

    from engine.flows.records.attested_record import open_attested
    from engine.records.attestation import attach
    from engine.watermark.keys import OwnerKey

    trust, more = read_trust(tsa_certificates, jwks), [read_attestation(path) for path in attestation or ()]
    owner, data = OwnerKey.read(key), read_bytes(record, "record")
    opening = Ahead(open_attested, attach(data, *more) if more else data, owner, trust)

    from engine.flows.verify.search import verify as search_for
    from engine.flows.verify.verification import VerifyConfig
    from engine.scenes.clip_suspects import is_clip, verify_in_motion
    from engine.watermark.numerals import PLAIN
    from engine.watermark.regions import RegionConfig
    from engine.watermark.wording import words_of

    asked = RegionConfig(false_discoveries=false_discovery_rate)
    config = VerifyConfig(false_claim_rate=false_claim_rate, suspect_seen=suspect_seen, route=route, decoder=decoder)
    with console.progress() as progress:
        started = time.perf_counter()
        progress("open record", 0.0)
        opened, unheard = opening.result()
        open_seconds = time.perf_counter() - started
        compile_seconds = prepare_kernels(console, progress, "pictures" if pictures else "model")
        started = time.perf_counter()
        progress("read", 0.0)
        suspect, repairs = reading.result()
        say_repairs(console, repairs)
        read_seconds = time.perf_counter() - started
        if original is not None and (pictures or not is_clip(suspects[0])):
            found = verify_in_motion(suspect, opened, original, config)
        else:
            found = search_for(suspect, opened, config, progress)
        located = None
        if regions is not None:
            started = time.perf_counter()
            progress("locate", 0.0)
            from engine.flows.regions.region_search import locate_mark

            located = locate_mark(suspect, opened, found, asked)
            write_regions(regions, located, suspect, opened, found)
            found = replace(found, seconds_by_stage=found.seconds_by_stage | {"locate": time.perf_counter() - started})
    report = claim_report(found, opened)
    if located is not None:
        report["regions"] = located.summary() | {"folder": str(regions)}
    if original is None and MOVING in opened.commitments and report["verdict"] != "marked":
        report["notes"] += [WITHOUT_ORIGINAL]
    report["notes"] += unheard
    report |= {
        "suspects": [str(path) for path in suspects],
        "repairs": [asdict(repair) for repair in repairs],
        "seconds": time.perf_counter() - began,
    }
    report["seconds_by_stage"] = {
        "open record": open_seconds,
        "compile": compile_seconds,
        "read": read_seconds,
        **found.seconds_by_stage,
    }
    words = words_of(report, PLAIN, suspect=", ".join(report["suspects"]), pictures=len(suspects) if pictures else 0)
    for line in claim_lines(words):
        console.say(line)
    for line in region_lines(located, str(regions)) if located is not None else ():
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
        "attested": opened.attested.to_json() if opened.attested is not None else None,
        "original_sha256": header.original_digest,
    }
