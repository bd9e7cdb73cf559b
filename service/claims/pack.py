"""The takedown pack: what is sent to a platform about a copy, as one ZIP. The same claim and words give the same bytes.

Pictures of an unmarked original have no place in it (`PICTURES`): it goes to third parties. Its texts are templates
beside this file. `statement.txt` has what a law requires of a notice: 17 U.S.C. 512(c)(3)(A)(i)-(vi), or article
16(2)(a)-(d) of Regulation (EU) 2022/2065 (DSA).
"""

import io
import re
import textwrap
import zipfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment
from PIL import Image, ImageDraw, ImageFont

from engine.present.html_pages import templates
from engine.present.numerals import PLAIN, when
from service.claims.document import document_words, no_pack
from service.claims.report import captions_of, timeline
from service.claims.schema import OwnerStatement
from service.problems import Problem
from service.trust.api_keys import FIRST_TENANT

PICTURES = ("suspect", "asset", "difference", "heatmap")
"""What a pack may show; `heatmap` where it is drawn over the `asset`, so not in claims of before."""
NAMES = {
    "suspect": "Suspect",
    "asset": "Registered model, marked",
    "difference": "Difference x5",
    "heatmap": "where.png",
}
PANEL, GAP, CAPTION = (480, 480), 8, 26
"""Largest picture in the comparison, and what lies between and above them, pixels."""
WIDTH = 110
_SINCE = (1980, 1, 1, 0, 0, 0)
"""Of every file in the ZIP: the first time that the format can say."""


def shown_in_pack(pictures: Mapping[str, Any]) -> list[str]:
    """Names of the pictures of a claim that third parties may see."""
    return [name for name in PICTURES if name in pictures and (name == "suspect" or "asset" in pictures)]


def make_pack(
    document: Mapping[str, Any], jws: str, pictures: Mapping[str, bytes], timestamp: bytes | None, given: OwnerStatement
) -> bytes:
    """The ZIP of a signed claim; `pictures`: PNG bytes of those that `shown_in_pack` names.

    "conflict" where the claim recognised nothing, or the owner's unmarked original: there is no copy to take down.
    """
    if reason := no_pack(document):
        raise Problem("conflict", f"{reason}, so there is nothing to take down")
    if pictures.keys() != set(shown_in_pack(pictures)):
        raise ValueError(f"not for third parties: {sorted(pictures)}")
    issuer, digests = document.get("issuer") or {}, document["pictures"]
    owner = (document.get("owner") or {}).get("name", "")
    address = issuer.get("address") or "[address of the service that issued the claim]"
    acquired = (document.get("acquisition") or {}).get("url")
    about: dict[str, Any] = {
        "claim": document,
        "words": document_words(document, PLAIN),
        "timeline": timeline(document, jws, timestamp),
        "owner": "[name of the owner]" if owner == FIRST_TENANT else owner,
        "issuer": f"{issuer.get('name') or 'Mark3DGS'}, {address}",
        "keys": f"{address.rstrip('/')}/.well-known/jwks.json",
        "stamped": timestamp is not None,
        "shown": list(pictures),
        "same_camera": "difference" in pictures,
        "names": NAMES,
        "captions": captions_of(document),
        "digests": [(name, digests[name]) for name in pictures],
        "given": given,
        "found_at": [*map(str, given.copy_url)] or ([acquired] if acquired else []),
        "note": [part for line in given.note.splitlines() for part in textwrap.wrap(line, WIDTH - 4) or [""]],
    }
    parts = _Parts()
    about |= {"parts": parts, "part": parts.write}
    names = ["finding", "notice", *(["statement"] if given.law is not None else [])]
    files = {f"{name}.txt": _texts().get_template(f"{name}.txt").render(about).encode() for name in names}
    files |= {f"signed/{name}.png": data for name, data in pictures.items()}
    if "asset" in pictures:
        files |= {"comparison.png": _side_by_side(pictures), "where.png": pictures["heatmap"]}
    files["claim.jws"] = jws.encode()
    if timestamp is not None:
        files["claim.jws.tst"] = timestamp
    return _zip(document["claim_id"], files)


class _Parts:
    """The parts of a statement as they are written, and of each what only a person can say: a blank in brackets."""

    _BLANK = re.compile(r"\[[^\]]+\]")

    def __init__(self) -> None:
        self.count, self.blank = 0, list[tuple[str, list[str]]]()

    def write(self, cite: str, asks: str, caller: Callable[[], str]) -> str:
        """A part: where the law asks for it, what for, and the paragraphs that answer it; an address is not folded."""
        lines = [line for line in caller().splitlines() if line]
        self.count += 1
        if blanks := [blank for line in lines for blank in self._BLANK.findall(line)]:
            self.blank.append((cite, blanks))
        answer = [f"    {line}" if line.startswith("At: ") else _fill(line, "    ") for line in lines]
        return "\n".join([_fill(f"{cite}: {asks}", "", "  "), *answer]) + "\n\n"


def _zip(folder: str, files: Mapping[str, bytes]) -> bytes:
    """Stored, not deflated: compressors differ from one version to the next."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_STORED) as archive:
        for name, data in sorted(files.items()):
            entry = zipfile.ZipInfo(f"{folder}/{name}", _SINCE)
            entry.create_system, entry.external_attr = 3, 0o644 << 16  # of no machine in particular
            archive.writestr(entry, data)
    return made.getvalue()


def _side_by_side(pictures: Mapping[str, bytes]) -> bytes:
    """One picture of all but the map, each under its name."""
    panels = [(NAMES[name], Image.open(io.BytesIO(pictures[name]))) for name in PICTURES[:3] if name in pictures]
    for _, panel in panels:
        panel.thumbnail(PANEL)
    width = len(panels) * (PANEL[0] + GAP) - GAP
    sheet = Image.new("RGB", (width, CAPTION + max(panel.height for _, panel in panels)), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=15)
    for column, (name, panel) in enumerate(panels):
        left = column * (PANEL[0] + GAP)
        pen.text((left + 2, 4), name, fill="black", font=font)
        sheet.paste(panel, (left, CAPTION))
    made = io.BytesIO()
    sheet.save(made, "PNG")
    return made.getvalue()


def _fill(text: str, first: str = "  ", then: str = "") -> str:
    return textwrap.fill(_line(text), WIDTH, initial_indent=first, subsequent_indent=then or " " * len(first))


def _line(value: Any) -> str:
    """Text that stays on its line and says what it seems to: no line breaks, no characters that turn text round."""
    return "".join(letter if letter.isprintable() else " " for letter in str(value))


@cache
def _texts() -> Environment:
    def plain(value: Any) -> Any:
        return value if isinstance(value, _Filled) else _line(value)

    environment = templates(Path(__file__).parent, keep_trailing_newline=True)
    environment.autoescape = False  # these are no pages; names from outside stay on their line
    environment.finalize = plain
    environment.filters.update(when=when, bare=_bare, fill=lambda *given: _Filled(_fill(*given)), verbatim=_Filled)
    return environment


class _Filled(str):
    """Lines whose breaks are our own."""


def _bare(text: Any) -> str:
    """Words from outside, made to look like no blank."""
    return str(text).replace("[", "(").replace("]", ")")
