"""What was checked, one after the other, in codes for machines and in words for people."""

from collections.abc import Mapping, Sequence
from typing import Any

from engine.errors import RecordError, WrongKeyError
from engine.watermark.claim import ClaimConfig
from engine.watermark.wording import TYPOGRAPHIC, percent

CHECKS = {
    "record_intact": "Record",
    "owner_key": "Owner's key",
    "derived": "Same model",
    "mark": "Mark",
    "evidence": "Evidence",
}
"""Names of the checks, in the order in which they are made."""

OUTCOMES = {True: "holds", False: "does not hold", None: "not decided"}

Check = dict[str, Any]
"""`code` for machines, `text` for people, and `ok`: null where it could not be checked or came to no answer."""

NO_RECORD: Check = {"code": "evidence", "ok": False, "text": "There is no registered asset to compare with."}


def checks_of(claim: Mapping[str, Any] | None, error: RecordError | None, pictures: int) -> list[Check]:
    """What was checked of one candidate, in the order of CHECKS.

    Parameters
    ----------
    claim : mapping or None
        Of `Claim.to_json`; None where the record could not be opened.
    error : RecordError or None
        Why it could not.
    pictures : int
        How many were looked at; 0 for a model.
    """
    if claim is None:
        wrong_key = isinstance(error, WrongKeyError)
        unopened = "Not checked: the record could not be opened."
        return _checks(
            (True, "The record is whole.") if wrong_key else (False, f"The record cannot be used: {error}."),
            (False, "This owner key did not make the record.") if wrong_key else (None, "Not checked."),
            *[(None, unopened)] * 3,
        )
    derived = _derived_picture(claim, pictures) if pictures else _derived_model(claim)
    undecided = claim["verdict"] == "inconclusive"
    return _checks(
        (True, "The record is whole and unaltered."),
        (True, "The owner's key opens the record."),
        derived,
        _mark(claim, bool(derived[0])),
        (not undecided, f"The evidence does not decide: {claim['missing']}." if undecided else "The evidence decides."),
    )


def named(checks: Sequence[Mapping[str, Any]]) -> list[Check]:
    """Checks with a `name` and an `outcome` for people beside `code` and `ok`."""
    return [
        {**check, "name": CHECKS.get(check["code"], check["code"]), "outcome": OUTCOMES[check["ok"]]}
        for check in checks
    ]


def _checks(*found: tuple[bool | None, str]) -> list[Check]:
    return [{"code": code, "ok": ok, "text": text} for code, (ok, text) in zip(CHECKS, found, strict=True)]


def _derived_model(claim: Mapping[str, Any]) -> tuple[bool, str]:
    share = claim["derived_fraction"] or 0.0
    if claim["transform"] is None:
        return False, "No piece of the registered model was found in the suspect."
    if share < ClaimConfig().derived_least and claim["verdict"] != "marked":
        return False, f"Only {percent(share)} of the registered model was found in the suspect: too little to say so."
    return True, f"Of the registered model, {percent(share)} was found in the suspect."


def _derived_picture(claim: Mapping[str, Any], pictures: int) -> tuple[bool | None, str]:
    # each picture in which the asset was not found left a note that begins so
    showing = pictures - sum(note.startswith("picture ") for note in claim["notes"])
    if showing == 0:
        return None, "No view of the registered model was recognised in the pictures."
    return True, f"{showing} of {pictures} pictures show the registered model."


def _mark(claim: Mapping[str, Any], derived: bool) -> tuple[bool | None, str]:
    if claim["verdict"] == "marked":
        bits = f"{claim['matching_bits']} of {claim['bits']} bits agree"
        odds = TYPOGRAPHIC.odds(claim["log10_false_claim"])
        return True, f"The mark is there: {bits}, and the chance of a false claim is {odds}, all tries counted."
    if claim["verdict"] == "inconclusive":
        return None, "Neither shown nor ruled out."
    if derived:
        return False, "Derived from the asset, but without this mark: unmarked, or another copy's mark."
    return False, "The mark is not there."
