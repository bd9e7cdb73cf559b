"""`mark3dgs verify`: does this model, or do these pictures, carry the mark?"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from engine.cli.console import Console, claim_lines
from engine.cli.failures import VERDICT_CODES
from engine.cli.kernel_progress import prepare_kernels
from engine.cli.options import From, Json, Key, SpzFrame
from engine.cli.streams import STREAM, check_kind, input_file, input_name
from engine.cli.trust_options import Jwks, TsaCertificates, read_attestation, read_trust
from engine.errors import InputError
from engine.present.numerals import number
from engine.usecases.files import check_folder, read_bytes, whole_folder
from engine.usecases.read_ahead import ahead
from engine.usecases.suspect import SuspectFiles

MOVING = "moving"
"""Name of a record's commitment to a clip, see `engine.scenes.clip_marking`."""
WITHOUT_ORIGINAL = "the record is of a scene that moves: give --original to look for single moments of it"

if TYPE_CHECKING:
    from concurrent.futures import Future

    from engine.flows.records.opened_record import OpenedRecord
    from engine.flows.regions.region_search import RegionReport
    from engine.flows.verify.search import Suspect, Verification
    from engine.records.attestation import Trust
    from engine.usecases.suspect import ReadSuspect


def verify(
    context: typer.Context,
    suspects: Annotated[
        list[Path],
        typer.Argument(
            metavar="MODEL|PICTURE...", help="One model, or one or more pictures of one model; -: one, from stdin."
        ),
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
        typer.Option("--attestation", help="Additional time stamp or log proof for the record; repeatable."),
    ] = None,
    tsa_certificates: TsaCertificates = None,
    jwks: Jwks = None,
    suspect_seen: Annotated[
        str, typer.Option("--suspect-seen", metavar="DATE", help="Since when the suspect is known, such as 2026-11-03.")
    ] = "",
    original: Annotated[
        Path | None,
        typer.Option("--original", help="Unmarked clip, for the record of a moving scene: its moments are searched."),
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
    time_budget: Annotated[
        float,
        typer.Option(
            "--time-budget",
            metavar="SECONDS",
            help="Time after which no further search step begins; of pictures, for each.",
        ),
    ] = 60.0,
    given: From = None,
    spz_frame: SpzFrame = "auto",
    json: Json = False,
) -> int:
    """Search a suspect for a mark, and bound the probability of a false claim.

    The suspect may have been moved, cropped, thinned, converted or put into
    another scene; of a picture, neither camera nor focal length need be known.
    Several pictures, or a folder of a video's frames, are read together.

    A claim needs 1 in 10^9 where a trusted time-stamping service drew a part of
    the watermark (embed --tsa; --tsa-certificates here), else 1 in 2^128.

    Exit codes: 0 marked, 3 your unmarked original, 4 inconclusive, 2 wrong key or input.

    Examples:

      mark3dgs verify suspect.ply --record my.record --key owner.key
      mark3dgs verify a.png b.jpg --record my.record --key owner.key
      mark3dgs verify suspect.spz --record my.record --key owner.key --json
      mark3dgs verify scene.ply --record my.record --key owner.key --regions where
    """
    console = Console(json)
    began = time.perf_counter()
    if suspects.count(STREAM) > 1:
        raise InputError("standard input is one suspect: '-' was given more than once")
    files = {context.with_resource(input_file(path)): path for path in suspects}
    source = SuspectFiles.sort_out(list(files), cameras, spz_frame, input_name(suspects[0], given))
    if regions is not None:
        check_folder(regions)
        if original is not None:
            raise InputError("--regions needs a static scene: leave --original out")

    from engine.flows.verify.search import VerifyConfig
    from engine.present.numerals import PLAIN
    from engine.present.wording import words_of
    from engine.usecases.verify import VerifyReport, VerifyRequest, printed
    from engine.usecases.verify import verify as verify_records
    from engine.watermark.messages import message_hex
    from engine.watermark.regions import RegionConfig

    located = RegionConfig(false_discoveries=false_discovery_rate)  # refuses an invalid rate even without --regions
    kept = _Record.of(record, key, attestation or (), read_trust(tsa_certificates, jwks))
    config = VerifyConfig(
        false_claim_rate=false_claim_rate,
        suspect_seen=suspect_seen,
        route=route,
        decoder=decoder,
        time_budget=time_budget,
    )
    request = VerifyRequest(
        suspect=source,
        candidates=(kept,),
        config=config,
        original=original,
        regions=located if regions is not None else None,
    )
    compiling = 0.0
    with console.progress() as progress:

        def prepare(read: ReadSuspect) -> None:
            nonlocal compiling
            check_kind(read.format, given, suspects[0])
            console.note_repairs(read.repairs)
            kept.open()  # a wrong key is known before kernels are compiled
            compiling = prepare_kernels(console, progress, "pictures" if source.pictures else "model")

        answer = verify_records(request, progress, prepare)
        (outcome,) = answer.search.outcomes
        if outcome.error is not None:
            raise outcome.error
        found, opened = outcome.found, outcome.opened
        assert found is not None  # it is the best one
        assert opened is not None
        if regions is not None and answer.regions is not None:
            write_regions(regions, answer.regions, answer.read.suspect, opened, found)
    report = VerifyReport.of(found, opened).to_json()
    if answer.regions is not None:
        report["regions"] = answer.regions.summary() | {"folder": str(regions)}
    if original is None and MOVING in opened.commitments and report["verdict"] != "marked":
        report["notes"] += [WITHOUT_ORIGINAL]
    report["notes"] += kept.result()[1]
    report |= {
        "suspects": [str(files.get(path, path)) for path in source.paths],
        "repairs": [asdict(repair) for repair in answer.read.repairs],
        "seconds": time.perf_counter() - began,
        "seconds_by_stage": answer.seconds_by_stage | {"compile": compiling},
    }
    pictures = len(source.paths) if source.pictures else 0
    words = words_of(report, PLAIN, suspect=", ".join(report["suspects"]), pictures=pictures)
    console.say(*claim_lines(words))
    if answer.regions is not None:
        console.say(*region_lines(answer.regions, str(regions)))
    console.emit(printed(report, message_hex(opened.message)))
    return VERDICT_CODES[report["verdict"]]


@dataclass(frozen=True, eq=False)
class _Record:
    """The record, opened once, while other things are being read."""

    opening: Future[tuple[OpenedRecord, tuple[str, ...]]]
    original = ""  # it is the only one: nothing is shared with others

    @classmethod
    def of(cls, record: Path, key: Path, attestations: Sequence[Path], trust: Trust) -> _Record:
        from engine.flows.records.opened_record import open_attested
        from engine.records.attestation import attach
        from engine.watermark.keys import OwnerKey

        more = [read_attestation(path) for path in attestations]
        owner, data = OwnerKey.read(key), read_bytes(record, "record")
        return cls(ahead(open_attested, attach(data, *more) if more else data, owner, trust))

    def result(self) -> tuple[OpenedRecord, tuple[str, ...]]:
        """The record, and what is not trusted of what it holds."""
        return self.opening.result()

    def open(self) -> OpenedRecord:
        """See `flows.trace.candidates.Candidate`."""
        return self.result()[0]


def write_regions(
    folder: Path, report: RegionReport, suspect: Suspect, opened: OpenedRecord, found: Verification
) -> None:
    """The map, the numbers and the indices, in a new folder.

    `regions.npz`: of each row of the suspect's file, `piece` and `region` (-1: nothing of the asset) and `state`; of
    each of the asset's Gaussians, in its record's order, `asset_state`; `states` names what the numbers mean.
    """
    import numpy as np

    from engine.flows.regions.region_search import describe
    from engine.present.region_maps import draw_report
    from engine.watermark.regions import State

    with whole_folder(folder) as part:
        draw_report(report, suspect, opened, found).save(part / "regions.png")
        (part / "regions.json").write_text(json.dumps(describe(report, opened), indent=1))
        piece, region, state = report.of_suspect
        if suspect.model is not None and (file_rows := suspect.model.file_rows) is not None:
            piece, region = (file_rows.spread(values, -1) for values in (piece, region))
            state = file_rows.spread(state, State.UNSEEN)
        names = np.array([each.name.lower() for each in State])
        rows = {"piece": piece, "region": region, "state": state, "asset_state": report.states, "states": names}
        np.savez_compressed(part / "regions.npz", allow_pickle=False, **rows)


def region_lines(report: RegionReport, folder: str) -> Iterator[str]:
    """Where on the asset the mark is, and each piece of it in the suspect, for people."""
    summary = report.summary()
    yield ""
    wrong = f" (at most {100 * report.false_discoveries:.2g} % of them expected not to be)" if summary["marked"] else ""
    others = ", ".join(f"{summary[name]} {name}" for name in ("altered", "unclear", "unseen"))
    yield f"Regions: {summary['marked']} marked{wrong}, {others}"
    for count, piece in enumerate(report.pieces, start=1):
        placed = piece.registration
        if placed is None:
            continue
        moved = ", ".join(number(x, 4) for x in placed.t)
        hand = ", mirrored" if placed.mirrored else ""
        yield (
            f"  piece {count}  {placed.derived_fraction:.0%} of the asset, {len(piece.rows[0]):,} Gaussians of the"
            f" suspect, z = {piece.z:.1f}, scale {number(placed.scale, 4)}, moved by ({moved}){hand}"
        )
    if not report.claimed:
        yield "  The claim is not made: regions are no proof by themselves."
    yield f"  {folder}/regions.png, regions.json, regions.npz"
