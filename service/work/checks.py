"""What was checked, one after the other, in codes for machines and in words for people.

`ok` is true or false where the check was made, and null where it could not be made or came to no answer.
"""

from typing import Any

from engine.errors import RecordError, WrongKeyError
from engine.watermark.claim import Claim, ClaimConfig, Verdict

Check = dict[str, Any]

NO_RECORD: Check = {"code": "evidence", "ok": False, "text": "There is no registered asset to compare with."}


def checks_of(claim: Claim | None, error: RecordError | None, pictures: int) -> list[Check]:
    """The five checks of one candidate, in the order in which they are made.

    Parameters
    ----------
    claim : Claim or None
        None where the record could not be opened.
    error : RecordError or None
        Why it could not.
    pictures : int
        Number of pictures looked at; 0 for a model.

    Returns
    -------
    list of dict
        `record_intact`, `owner_key`, `derived`, `mark`, `evidence`: each with `code`, `ok` and `text`.
    """
    if claim is None:
        return _unopened(error)
    derived = _derived_picture(claim, pictures) if pictures else _derived_model(claim)
    return [
        _check("record_intact", True, "The record is whole and unaltered."),
        _check("owner_key", True, "The owner's key opens the record."),
        derived,
        _mark(claim, derived["ok"]),
        _evidence(claim),
    ]


def _check(code: str, ok: bool | None, text: str) -> Check:
    return {"code": code, "ok": ok, "text": text}


def _unopened(error: RecordError | None) -> list[Check]:
    wrong_key = isinstance(error, WrongKeyError)
    return [
        _check("record_intact", True, "The record is whole.")
        if wrong_key
        else _check("record_intact", False, f"The record cannot be used: {error}."),
        _check("owner_key", False, "This owner key did not make the record.")
        if wrong_key
        else _check("owner_key", None, "Not checked."),
        *(
            _check(code, None, "Not checked: the record could not be opened.")
            for code in ("derived", "mark", "evidence")
        ),
    ]


def _derived_model(claim: Claim) -> Check:
    share = claim.derived_fraction or 0.0
    if claim.transform is None:
        return _check("derived", False, "No piece of the asset was found in the model.")
    if share < ClaimConfig().derived_least and claim.verdict is not Verdict.MARKED:
        return _check("derived", False, f"Only {share:.2%} of the asset was found: too little to say so.")
    return _check("derived", True, f"The model holds {share:.0%} of the asset's Gaussians.")


def _derived_picture(claim: Claim, pictures: int) -> Check:
    # Each picture in which the asset was not found left one note.
    showing = pictures - len(claim.notes)
    if showing == 0:
        return _check("derived", None, "No view of the asset was recognised in the pictures.")
    return _check("derived", True, f"{showing} of {pictures} pictures show the asset.")


def _mark(claim: Claim, derived: bool | None) -> Check:
    if claim.verdict is Verdict.MARKED:
        return _check(
            "mark",
            True,
            f"The mark is there: {claim.matching_bits} of {claim.bits} bits agree, and the chance of a false"
            f" claim is at most 10^{claim.log10_false_claim:.1f} (tries counted: {claim.tries}).",
        )
    if claim.verdict is Verdict.INCONCLUSIVE:
        return _check("mark", None, "Neither shown nor ruled out.")
    if derived:
        return _check("mark", False, "Derived from the asset, but without this mark: unmarked, or another copy's mark.")
    return _check("mark", False, "The mark is not there.")


def _evidence(claim: Claim) -> Check:
    if claim.verdict is Verdict.INCONCLUSIVE:
        return _check("evidence", False, f"The evidence does not decide: {claim.missing}.")
    return _check("evidence", True, "The evidence decides.")
