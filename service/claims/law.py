"""What a law requires of a notice to a platform, filled from a claim; what only a person can say stays a blank.

17 U.S.C. 512(c)(3)(A)(i)-(vi), and article 16(2)(a)-(d) of Regulation (EU) 2022/2065 (DSA). A blank stands in brackets.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from engine.present.numerals import when

TITLES = {
    "dmca": "Notification of claimed infringement, 17 U.S.C. 512(c)(3)(A)",
    "dsa": "Notice of illegal content, Regulation (EU) 2022/2065 (DSA), article 16(2)",
}
_BLANK = re.compile(r"\[[^\]]+\]")
_INITIALS = "[your initials, if this is true]"


@dataclass(frozen=True)
class Element:
    """One thing that a notice must contain."""

    cite: str
    asks: str  # what the law asks for
    lines: tuple[str, ...]  # paragraphs that answer it

    @property
    def blanks(self) -> list[str]:
        """What is still to be filled in."""
        return [blank for line in self.lines for blank in _BLANK.findall(line)]


def elements(
    law: str, claim: Mapping[str, Any], finding: str, owner: str, found_at: Sequence[str], original_url: str
) -> list[Element]:
    """All elements of a notice under a law of TITLES.

    `finding` is the claim's verdict in words, `owner` the owner's name (or a blank), `found_at` where the copy is, and
    `original_url` where the original is, "" where that is not known.
    """
    original = claim["original"]
    work = (
        f"A 3D Gaussian Splatting model of {owner}, SHA-256 of its file {original['sha256']}, registered on"
        f" {when(original['registered_at'])} (asset {claim['asset']}).",
        "[title of the work]",
        f"At: {_bare(original_url)}" if original_url else "[where it is published, or: it is not published]",
    )
    material = (
        *((f"At: {_bare(url)}" for url in found_at) if found_at else ["At: [exact URL of the copy]"]),
        "Examined were the files with SHA-256 " + ", ".join(claim["subject"]["sha256"]) + ".",
    )
    found = f"The signed claim {claim['claim_id']} (claim.jws) tells its owner: {_bare(finding)}"
    if law == "dmca":
        return _dmca(work, material, found)
    why = (
        "[which right in the work is yours, and why this use of it is unlawful: for instance, that you gave no licence]"
    )
    return _dsa((*work, found, _bare(claim["meaning"]["does_not_say"]), why), material, owner)


def _dmca(work: tuple[str, ...], material: tuple[str, ...], found: str) -> list[Element]:
    cite = "17 U.S.C. 512(c)(3)(A)"
    belief = "I have a good faith belief that use of the material in the manner complained of is not authorized by the"
    accurate = "The information in this notification is accurate and, under penalty of perjury, I am authorized to act"
    return [
        Element(
            f"{cite}(i)",
            "signature of a person authorized to act on behalf of the owner of the exclusive right",
            ("[physical or electronic signature]", "[name of who signs, and for whom]"),
        ),
        Element(f"{cite}(ii)", "identification of the copyrighted work claimed to have been infringed", work),
        Element(
            f"{cite}(iii)",
            "identification of the material claimed to be infringing, and information to locate it",
            (*material, found),
        ),
        Element(
            f"{cite}(iv)",
            "information to contact the complaining party",
            ("[postal address]", "[telephone number]", "[e-mail address]"),
        ),
        Element(
            f"{cite}(v)",
            "statement of a good faith belief that the use is not authorized",
            (f"{_INITIALS} {belief} copyright owner, its agent, or the law.",),
        ),
        Element(
            f"{cite}(vi)",
            "statement of accuracy and, under penalty of perjury, of authority to act",
            (f"{_INITIALS} {accurate} on behalf of the owner of an exclusive right that is allegedly infringed.",),
        ),
    ]


def _dsa(reasons: tuple[str, ...], material: tuple[str, ...], owner: str) -> list[Element]:
    return [
        Element(
            "DSA article 16(2)(a)",
            "sufficiently substantiated explanation of why the information is alleged to be illegal content",
            reasons,
        ),
        Element("DSA article 16(2)(b)", "exact electronic location of that information, such as its URLs", material),
        Element(
            "DSA article 16(2)(c)",
            "name and e-mail address of who submits the notice",
            (f"[name of who submits, if it is not {owner.strip('[]')}]", "[e-mail address]"),
        ),
        Element(
            "DSA article 16(2)(d)",
            "statement confirming the bona fide belief that the notice is accurate and complete",
            (
                f"{_INITIALS} I believe in good faith that the information and allegations in this notice are accurate"
                " and complete.",
            ),
        ),
    ]


def _bare(text: str) -> str:
    """Words from outside look like no blank."""
    return str(text).replace("[", "(").replace("]", ")")
