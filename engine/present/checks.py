"""What was checked, one after the other, in codes for machines and in words for people."""

from collections.abc import Mapping, Sequence
from typing import Any

from engine.errors import RecordError, WrongKeyError
from engine.numerics.plain import Json
from engine.present.numerals import TYPOGRAPHIC
from engine.present.wording import derivation_text

CHECKS = {
    "record_intact": "Record",
    "owner_key": "Owner's key",
    "derived": "Derived from it",
    "mark": "Mark",
    "evidence": "Evidence",
}
"""Names of the checks, in the order in which they are made."""

NAMES = CHECKS | {"acquisition": "Acquisition"}
"""Names of all checks, the service's own one included."""

OUTCOMES = {True: "holds", False: "does not hold", None: "not decided"}

Check = Json
"""`code` for machines, `text` for people, and `ok`: null where it could not be checked or came to no answer."""

NO_RECORD: Check = {"code": "evidence", "ok": False, "text": "There is no registered asset to compare with."}


def checks_of(claim: Mapping[str, Any] | None, error: RecordError | None) -> list[Check]:
    """What was checked of one candidate, in the order of CHECKS.

    Parameters
    ----------
    claim : mapping or None
        Of `Claim.to_json`; None where the record could not be opened.
    error : RecordError or None
        Why it could not.
    """
    if claim is None:
        wrong_key = isinstance(error, WrongKeyError)
        unopened = "Not checked: the record could not be opened."
        return _checks(
            (True, "The record is whole.") if wrong_key else (False, f"The record cannot be used: {error}."),
            (False, "This owner key did not make the record.") if wrong_key else (None, "Not checked."),
            *[(None, unopened)] * 3,
        )
    derivation = claim["derivation"]
    # Where nothing was recognised nothing is known: there are ways to hide a model that no search undoes.
    derived = True if derivation["derived"] or claim["verdict"] == "marked" else None
    undecided = claim["verdict"] == "inconclusive"
    return _checks(
        (True, "The record is whole and unaltered."),
        (True, "The owner's key opens the record."),
        (derived, f"Derived from the asset: {derivation_text(derivation)}."),
        _mark(claim),
        (
            not undecided,
            f"The evidence is not sufficient: {claim['missing']}." if undecided else "The evidence is sufficient.",
        ),
    )


def named(checks: Sequence[Mapping[str, Any]]) -> list[Check]:
    """Checks with a `name` and an `outcome` for people, in addition to `code` and `ok`."""
    return [
        {**check, "name": NAMES.get(check["code"], check["code"]), "outcome": OUTCOMES[check["ok"]]} for check in checks
    ]


def _checks(*found: tuple[bool | None, str]) -> list[Check]:
    return [{"code": code, "ok": ok, "text": text} for code, (ok, text) in zip(CHECKS, found, strict=True)]


def _mark(claim: Mapping[str, Any]) -> tuple[bool | None, str]:
    if claim["verdict"] == "marked":
        bits = f"{claim['matching_bits']}/{claim['bits']} bits match"
        odds = TYPOGRAPHIC.odds(claim["log10_false_claim"])
        return (
            True,
            f"The watermark was found: {bits}; the false-claim probability is {odds}, corrected for all hypotheses.",
        )
    if claim["verdict"] == "inconclusive":
        return None, "Neither found nor excluded."
    return False, "The suspect equals the unmarked original, or a part of it; this watermark was not detected."
