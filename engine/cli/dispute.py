"""`mark3dgs dispute`: two parties claim one model. Who was first?"""

from __future__ import annotations

import textwrap
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from engine.cli.console import WIDTH, Console
from engine.cli.failures import INCONCLUSIVE, OK
from engine.cli.kernel_progress import prepare_kernels
from engine.cli.options import Json
from engine.cli.trust_options import Jwks, TsaCertificates, read_trust
from engine.errors import InputError
from engine.usecases.files import check_target, read_bytes, whole_file
from engine.usecases.suspect import SuspectFiles

if TYPE_CHECKING:
    from engine.present.dispute_text import DisputeWords


def dispute(
    record: Annotated[list[Path], typer.Option("--record", help="Record of party A, then the record of party B.")],
    key: Annotated[list[Path], typer.Option("--key", help="Owner key of party A, then the key of party B.")],
    model: Annotated[list[Path], typer.Option("--model", help="What party A published, then what party B published.")],
    tsa_certificates: TsaCertificates = None,
    jwks: Jwks = None,
    report: Annotated[Path | None, typer.Option("--report", help="Write a page to read, print and send.")] = None,
    json: Json = False,
) -> int:
    """Settle who was first, where two parties claim one model.

    A thief who marks a stolen model has a true mark in it, so both claims can
    hold. Each mark is looked for in both originals: the party whose mark is in
    the other's original came first. Dates count where a third party attests them.

    Exit codes: 0 one party came first, 4 the marks do not tell, 2 wrong input.

    Example:

      mark3dgs dispute --record a.record --key a.key --model a.ply \\
        --record b.record --key b.key --model b.ply --report dispute.html
    """
    console = Console(json)
    began = time.perf_counter()
    for name, given in (("--record", record), ("--key", key), ("--model", model)):
        if len(given) != 2:
            raise InputError(f"a dispute has two parties: give {name} twice, first of A, then of B; got {len(given)}")
    if report is not None:
        check_target(report)

    from engine.flows.dispute.dispute import Party, settle
    from engine.flows.records.opened_record import open_attested
    from engine.present.dispute_text import dispute_page, dispute_words
    from engine.present.numerals import PLAIN
    from engine.watermark.keys import OwnerKey

    trust = read_trust(tsa_certificates, jwks)
    with console.progress() as progress:
        parties = []
        for files in zip(record, key, model, strict=True):
            progress("open record", 0.0)
            opened, notes = open_attested(read_bytes(files[0], "record"), OwnerKey.read(files[1]), trust)
            for note in notes:
                console.note(f"{files[0]}: {note}")
            progress("read", 0.0)
            read = SuspectFiles((files[2],), pictures=False).read()
            console.note_repairs(read.repairs)
            published = read.suspect.model
            assert published is not None  # a dispute is about models
            parties.append(Party(opened, published))
        prepare_kernels(console, progress, "model")
        found = settle(parties[0], parties[1], progress).to_json()
    found |= {"files": [str(path) for path in (*record, *model)], "seconds": time.perf_counter() - began}
    console.say(*_lines(dispute_words(found, PLAIN)))
    if report is not None:
        with whole_file(report) as part:
            part.write_text(dispute_page(found), encoding="utf-8")
        console.say(f"The page is in {report}.")
    console.emit(found)
    return OK if found["first"] in ("a", "b") else INCONCLUSIVE


def _lines(words: DisputeWords) -> list[str]:
    lines = [*textwrap.wrap(f"{words.headline}. {words.finding}", WIDTH), ""]
    for reason in words.reasons:
        lines += textwrap.wrap(reason, WIDTH, initial_indent="  ", subsequent_indent="  ")
    lines.append("")
    for whose, place, answer in words.looks:
        text = f"mark of {whose} in {place}: {answer}"
        lines += textwrap.wrap(text, WIDTH, initial_indent="  ", subsequent_indent="      ")
    lines.append("")
    for whose, date in words.dates:
        lines += textwrap.wrap(f"{whose} registered: {date}", WIDTH, initial_indent="  ", subsequent_indent="      ")
    return [*lines, "", *(line for limit in words.limits for line in textwrap.wrap(limit, WIDTH)), ""]
