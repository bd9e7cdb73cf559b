"""`mark3dgs attest`: a third party's statement on when a record existed, put into its file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from engine.cli.console import Console
from engine.cli.options import Json
from engine.cli.trust_options import Jwks, TrustedList, TsaCertificates, read_attestation, read_trust
from engine.usecases.files import check_target, read_bytes, refuse_same, whole_file, write_secret


def attest(
    record: Annotated[Path, typer.Argument(metavar="RECORD", help="Record of an embedding.")],
    tsa: Annotated[
        str | None, typer.Option("--tsa", metavar="URL", help="Get a time stamp from this service (RFC 3161).")
    ] = None,
    query: Annotated[
        Path | None, typer.Option("--query", metavar="OUT", help="Write the query, to send it by other means.")
    ] = None,
    attestation: Annotated[
        list[Path] | None,
        typer.Option("--attestation", help="Reply of a time-stamping service, or a signed attestation; repeatable."),
    ] = None,
    tsa_certificates: TsaCertificates = None,
    trusted_list: TrustedList = None,
    jwks: Jwks = None,
    json: Json = False,
) -> int:
    """Let a third party attest a record's date.

    It says since when the record exists; the bound that a claim needs stays
    1 in 2^128. Do it when you mark a model, before you publish it: what counts
    is that the record is older than the suspect. Only a digest of the record
    leaves this machine. Without an option it lists what the record has.

    Examples:

      mark3dgs attest my.record --tsa http://timestamp.example.org
      mark3dgs attest my.record --query my.tsq
      mark3dgs attest my.record --attestation my.tsr --tsa-certificates tsa.pem
    """
    from engine.records.attestation import attach, header_digest, read_attestations, stamp_of
    from engine.records.file import public_bytes
    from engine.records.timestamps import make_query, require_stamp
    from engine.records.witnessing import check_attestations

    console = Console(json)
    data = read_bytes(record, "record")
    public = public_bytes(data)
    before = len(read_attestations(data))
    if query is not None:
        refuse_same(record, query)
        check_target(query)
        with whole_file(query) as part:
            part.write_bytes(make_query(public))
    more = [read_attestation(path) for path in attestation or ()]
    if tsa is not None:
        more.append(stamp_of(require_stamp(tsa, public)))
    whole = attach(data, *more) if more else data
    witnesses, notes = check_attestations(whole, read_trust(tsa_certificates, jwks, trusted_list))
    if whole != data:
        with whole_file(record) as part:
            write_secret(part, whole)
            os.chmod(part, record.stat().st_mode & 0o777)
    report = {
        "record": str(record),
        "header_sha256": header_digest(data),
        "added": len(read_attestations(whole)) - before,
        "attestations": len(read_attestations(whole)),
        "witnesses": [{"at": each.at, "by": each.by} for each in witnesses],
        "notes": list(notes),
    }
    console.say(f"{record}: {report['attestations']} attestations, {report['added']} of them new")
    console.say(*(f"  registered by {each.at}, attested by {each.by}" for each in witnesses))
    console.say(*(f"  {note}" for note in notes))
    if query is not None:
        console.say(f"  the query about SHA-256 {report['header_sha256']} is in {query}")
    console.emit(report)
    return 0
