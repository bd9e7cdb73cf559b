"""`mark3dgs verify-report`: is this claim what the service signed?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from engine.cli.console import Console
from engine.cli.failures import OK
from engine.cli.options import Json
from engine.cli.trust_options import TrustedList, TsaCertificates, read_trust

NOT_VALID = 3
_SIGNS = {"pass": "ok  ", "fail": "FAIL", "not_checked": "-   "}


def verify_report(
    file: Annotated[Path, typer.Argument(help="Claim: .jws, .json, or the HTML report.")],
    jwks: Annotated[Path, typer.Option("--jwks", help="The service's public keys, from /.well-known/jwks.json.")],
    tsa_certificates: TsaCertificates = None,
    other: Annotated[
        list[Path] | None, typer.Option("--other", help="Another claim of the service: is its log the same one?")
    ] = None,
    trusted_list: TrustedList = None,
    json: Json = False,
) -> int:
    """Check a claim offline: signature, document, place in the audit log, report.

    Needs no service, no account and no network; only the service's public
    keys, from a source you trust.

    Exit codes: 0 everything holds, 3 something does not, 2 wrong usage.

    Examples:

      mark3dgs verify-report claim.jws --jwks jwks.json
      mark3dgs verify-report report.html --jwks jwks.json --json
      mark3dgs verify-report claim.jws --jwks jwks.json --other last-year.jws
    """
    from engine.present.numerals import PLAIN
    from service.claims import offline
    from service.claims.carriers import MOST_BYTES
    from service.claims.document import document_words

    console = Console(json)
    trust = read_trust(tsa_certificates, jwks, trusted_list)
    data, *others = (_read(path, MOST_BYTES + 1) for path in (file, *(other or ())))
    found = offline.verify_report(data, trust.jwks, trust.certificates, others, trust.listed)
    for check in found.checks:
        console.say(f"{_SIGNS[check.status]} {check.code}: {check.text}")
    if found.document is not None:
        claim = found.document
        console.say("")
        console.say(f"Signed claim {claim['claim_id']} of {claim['created_at'][:19]}Z")
        words = document_words(claim, PLAIN)
        console.say(f"{words.headline}. {words.finding}")
        for fact in words.facts:
            console.say(f"  {fact.label:<16}{fact.text}")
    console.say("")
    unchecked = [check.code for check in found.checks if check.status == "not_checked"]
    so_far = f", as far as it was checked (not: {', '.join(unchecked)})" if unchecked else ""
    console.say(f"VALID{so_far}" if found.valid else "NOT VALID")
    console.emit({"file": str(file), **found.to_json()})
    return OK if found.valid else NOT_VALID


def _read(path: Path, most: int) -> bytes:
    with path.open("rb") as opened:
        return opened.read(most)
