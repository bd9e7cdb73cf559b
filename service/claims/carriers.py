"""The three files that carry a signed claim: the bare JWS, the claim as JSON, and the HTML report."""

import base64
import binascii
import json
from dataclasses import dataclass, field
from html.parser import HTMLParser
from typing import Any

from service.claims.schema import Document

MOST_BYTES = 64 << 20
_MEMBERS = {"document", "jws", "timestamp", "summary"}


class UnreadableError(ValueError):
    """A file that carries no claim; the text says why."""


@dataclass(frozen=True)
class Carried:
    """What was found in a file."""

    kind: str  # jws, json or html
    jws: str
    document: Document | None = None  # as a JSON claim spells it out, and `summary` too
    summary: Any = None
    timestamp: bytes | None = None
    pictures: dict[str, bytes] = field(default_factory=dict)  # of a report, by name


def unpack(data: bytes) -> Carried:
    """Find the claim in a file, or raise UnreadableError."""
    if len(data) > MOST_BYTES:
        raise UnreadableError(f"a claim has at most {MOST_BYTES} bytes, this file has {len(data)}")
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise UnreadableError("this is neither a signed claim, nor a claim as JSON, nor a report") from None
    if text.startswith("<"):
        return _from_html(text)
    if text.startswith("{"):
        return _from_json(text)
    return Carried("jws", text.strip())


def strict_json(text: str | bytes) -> Any:
    """JSON in which no name stands twice (readers disagree about which counts) and no number is NaN, or ValueError."""
    return json.loads(text, object_pairs_hook=_each_once, parse_constant=_refuse)


def _from_json(text: str) -> Carried:
    try:
        claim = strict_json(text)
        document, jws, stamp = claim["document"], claim["jws"], claim.get("timestamp")
        if not (isinstance(document, dict) and isinstance(jws, str) and set(claim) <= _MEMBERS):
            raise UnreadableError("a claim as JSON has no members but `document`, `jws`, `timestamp` and `summary`")
        stamped = _decode(stamp) if stamp is not None else None
        return Carried("json", jws, document, claim.get("summary"), stamped)
    except (KeyError, RecursionError) as error:
        raise UnreadableError(f"this JSON is no claim: {error or 'too deep'}") from None
    except UnreadableError:
        raise
    except ValueError as error:
        raise UnreadableError(f"this is no JSON: {error}") from None


def _from_html(text: str) -> Carried:
    reader = _ReportReader()
    reader.feed(text)
    reader.close()
    if "jws" not in reader.texts:
        raise UnreadableError("this page is no report: it holds no signed claim")
    stamp = reader.texts.get("timestamp")
    pictures = {name: _decode(data) for name, data in reader.pictures.items()}
    return Carried(
        "html", reader.texts["jws"], timestamp=_decode(stamp) if stamp is not None else None, pictures=pictures
    )


class _ReportReader(HTMLParser):
    """Texts of <pre id=...>, and pictures by their data-name."""

    _PREFIX = "data:image/png;base64,"

    def __init__(self) -> None:
        super().__init__()
        self.texts: dict[str, str] = {}
        self.pictures: dict[str, str] = {}
        self._inside = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        name = given.get("id") or ""
        if tag == "pre" and name:
            if name in self.texts:
                raise UnreadableError(f"this page holds {name!r} twice")
            self._inside, self.texts[name] = name, ""
        elif tag == "img" and (given.get("src") or "").startswith(self._PREFIX):
            self.pictures[given.get("data-name") or ""] = (given["src"] or "").removeprefix(self._PREFIX)

    def handle_endtag(self, tag: str) -> None:
        if tag == "pre":
            self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.texts[self._inside] += data


def _decode(text: Any) -> bytes:
    try:
        return base64.b64decode(text, validate=True)
    except (TypeError, ValueError, binascii.Error):
        raise UnreadableError("a picture or time stamp in it is not written in base64") from None


def _each_once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a name occurs twice in one object")
    return found


def _refuse(text: str) -> Any:
    raise ValueError(f"{text} is no JSON number")
