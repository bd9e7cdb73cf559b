"""The report: a claim as one page to read, print and send. The same claim gives the same bytes."""

import base64
import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Template

from engine.present.checks import named
from engine.present.html_pages import templates
from engine.present.numerals import TYPOGRAPHIC, when
from engine.present.wording import ROUTES
from engine.records.timestamps import TimestampFault, stamped_at
from service.claims.document import document_reading, document_words

BITS_PER_LINE = 32
_LEFT, _CELL = 84, 20
_AXIS_LEFT, _AXIS_RIGHT, _AXIS_POWERS = 8, 700, 60
"""Where things stand in the two drawings, whose template is 724 wide."""

SIGNS = {True: ("pass", "✓"), False: ("fail", "✕"), None: ("open", "–")}
CAPTIONS = {
    "suspect": "The suspect.",
    "asset": "The registered model as it was delivered, with its mark.",
    "reference": "The registered original, without the mark.",  # in claims of before; no pack holds it
    "difference": "Suspect minus registered model, five times as large, on grey; white was not compared.",
    "heatmap": (
        "Where on the registered model the mark was found, by region: orange carries it; blue is there without it; grey"
        " was seen, but says too little; hatched was not seen. The legend says how many orange regions may be wrong. No"
        " region shows fewer than 30 secret positions, so none can be read off."
    ),
}

BEFORE = (
    "Where on the registered model the mark was found: orange is evidence for the mark, blue against it, grey neither."
    " Each patch sums many secret positions, so none can be read off."
)
"""Of the map in claims of before, which knew no regions."""


def captions_of(document: Mapping[str, Any]) -> dict[str, str]:
    """Captions of a claim's pictures."""
    return CAPTIONS if document.get("regions") is not None else CAPTIONS | {"heatmap": BEFORE}


def report_html(
    document: Mapping[str, Any], jws: str, pictures: Mapping[str, bytes], timestamp: bytes | None = None
) -> str:
    """One self-contained HTML page; pictures: PNG bytes, as `document["pictures"]` names them; timestamp: RFC 3161."""
    words, captions, reading = document_words(document), captions_of(document), document_reading(document)
    return template("report.html").render(
        claim=document,
        words=words,
        facts=[fact for fact in words.facts if fact.leading],
        odds=TYPOGRAPHIC.odds(document["log10_false_claim"]),
        reading=reading,
        bits=_bit_lines(reading) if reading["bits"] else None,
        scale=_bound_scale(document["log10_false_claim"], words.limits),
        pictures=[
            (name, captions.get(name, name), base64.b64encode(pictures[name]).decode())
            for name in (*captions, *sorted(set(pictures) - set(captions)))
            if name in pictures
        ],
        evidence=[(ROUTES.get(one["route"], one["route"]), one) for one in document["evidence"]],
        checks=[(*SIGNS[check["ok"]], check) for check in named(document["checks"])],
        timeline=timeline(document, jws, timestamp),
        jws=jws,
        timestamp=base64.b64encode(timestamp).decode() if timestamp else "",
        plain=_pretty(document),
    )


def timeline(document: Mapping[str, Any], jws: str, timestamp: bytes | None) -> list[tuple[str, str, str]]:
    """Time, what happened, and what proves it."""
    log = document["audit"]
    events = []
    if (original := document["original"]) is not None:
        copy = f"Copy for “{document['copy']}”" if document["copy"] else "Marked copy"
        entry = log["registration"]["entry"]["index"] if log["registration"] else "–"
        events += [
            (original["registered_at"], "Original registered", f"attested by the log; SHA-256 {original['sha256']}"),
            (document["registered_at"], f"{copy} made and delivered", f"attested by the log, entry {entry}"),
        ]
    events.append((document["created_at"], "This claim made and signed", f"attested by the log, entry {log['index']}"))
    if timestamp is not None:
        with suppress(TimestampFault):  # the page shows what is signed; `verify-report` names the fault
            stamped = stamped_at(timestamp, jws.encode())
            events.append((stamped, "Stamped by a time-stamping service", "RFC 3161, in this page"))
    return [(when(at), what, proof) for at, what, proof in events]


class _Bit(NamedTuple):
    number: int
    x: int
    registered: str
    read: str
    sure: float  # 0 (a coin) to 1 (certain)


class _Scale(NamedTuple):
    left: int
    right: int
    ticks: list[tuple[float, int]]  # place and power of ten
    bar: float
    beyond: bool  # the bound lies beyond the axis
    limits: list[tuple[float, str]]


def _bit_lines(reading: Mapping[str, Any]) -> list[list[_Bit]]:
    """The bits of a reading in lines, most significant first."""
    read, meant = reading["bits"]["string"], reading["registered_bits"]["string"]
    bits = [
        _Bit(k, _LEFT + _CELL * (k % BITS_PER_LINE), meant[k], read[k], max(0.0, 2.0 * sure - 1.0))
        for k, sure in enumerate(reading["reliability"])
    ]
    return [bits[k : k + BITS_PER_LINE] for k in range(0, len(bits), BITS_PER_LINE)]


def _bound_scale(log10_bound: float, limits: Sequence[tuple[float, str]]) -> _Scale:
    """The false-claim bound and its threshold on an axis from 1 (left) down to 10^-60 (right)."""
    return _Scale(
        left=_AXIS_LEFT,
        right=_AXIS_RIGHT,
        ticks=[(_place(power), power) for power in range(0, _AXIS_POWERS + 1, 10)],
        bar=_place(-log10_bound),
        beyond=-log10_bound > _AXIS_POWERS,
        limits=[(_place(-log10), text) for log10, text in limits],
    )


def _place(powers: float) -> float:
    return round(_AXIS_LEFT + (_AXIS_RIGHT - _AXIS_LEFT) * min(powers / _AXIS_POWERS, 1.0), 1)


def _pretty(document: Mapping[str, Any]) -> str:
    """JSON, lists of numbers on one line."""
    text = json.dumps(document, indent=2, ensure_ascii=False, sort_keys=True)
    return re.sub(r"\[[\s\d.,eE+-]+\]", lambda found: " ".join(found[0].split()), text)


def _plain(markdown: str) -> str:
    """A sentence without the signs of code and links."""
    return re.sub(r"\[([^\]]+)\]\([^)]+\)", r"\1", markdown).replace("`", "")


@cache
def template(name: str) -> Template:
    """A page of this folder."""
    environment = templates(Path(__file__).parent)
    environment.filters.update(power=partial(TYPOGRAPHIC.power, 10), when=when, plain=_plain)
    return environment.get_template(name)
