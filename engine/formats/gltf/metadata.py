"""What a glTF asset says of its rights and its provenance: the extension KHR_xmp_json_ld, read and written.

Specification: KhronosGroup/glTF, extensions/2.0/Khronos/KHR_xmp_json_ld (ratified): XMP (ISO 16684-1) as JSON,
in packets, of which `asset` names the one that holds for the whole file. `dcterms:provenance` is where C2PA's
specification has the address of a manifest that lies elsewhere. It is a statement, which anyone can change.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from engine.errors import InputError
from engine.formats.gltf.container import pack_glb, unpack
from engine.formats.wrappings import unwrapped

EXTENSION = "KHR_xmp_json_ld"
MOST_CHARACTERS = 1000
"""Of a text that is written, or shown."""

_CONTEXT = {
    "dc": "http://purl.org/dc/elements/1.1/",
    "dcterms": "http://purl.org/dc/terms/",
    "rdf": "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
}
_LANGUAGE = "x-default"
"""XMP's own, of a text that names none."""


@dataclass(frozen=True)
class Metadata:
    """Statements about a whole file; "" where there is none.

    Raises
    ------
    InputError
        If one has more than `MOST_CHARACTERS`, or characters that are not printable.
    """

    rights: str = ""  # dc:rights
    provenance: str = ""  # dcterms:provenance: address of a C2PA manifest

    def __post_init__(self) -> None:
        for name in ("rights", "provenance"):
            text = getattr(self, name)
            if len(text) > MOST_CHARACTERS or not text.isprintable():
                wanted = f"at most {MOST_CHARACTERS} printable characters"
                raise InputError(f"{name} must be {wanted}, got {ascii(text)[:80]}")

    def __bool__(self) -> bool:
        return bool(self.rights or self.provenance)


def annotate_glb(data: bytes, metadata: Metadata) -> list[bytes]:
    """The pieces of a .glb that states this of itself, in place of what it stated; its binary chunk is unchanged.

    FormatError if `data` is no .glb.
    """
    asset = unpack(data, file="the model")
    packet: dict[str, Any] = {"@context": _CONTEXT}
    if metadata.rights:
        text = {"@language": _LANGUAGE, "@value": metadata.rights}
        packet["dc:rights"] = {"@type": "rdf:Alt", "rdf:_1": text}
    if metadata.provenance:
        packet["dcterms:provenance"] = metadata.provenance
    said = dict(asset.json)
    said["asset"] = _extended(asset.json.get("asset"), {"packet": 0})
    used = [name for name in asset.rows("extensionsUsed") if name != EXTENSION]
    parsed = _extended(said, {"packets": [packet]}) | {"extensionsUsed": [*used, EXTENSION]}
    return pack_glb(parsed, [bytes(asset.binary)])


def read_metadata(data: bytes, *, file: str) -> Metadata | None:
    """What a .glb or .gltf states of itself; None where it states neither. What is not printable becomes "?".

    FormatError if the asset cannot be read at all.
    """
    with unwrapped(data, None, file=file) as (content, _, _):
        asset = unpack(content, file=file)
    index = _extension(asset.json.get("asset")).get("packet")
    packets = _extension(asset.json).get("packets")
    if not isinstance(packets, list) or type(index) is not int or not 0 <= index < len(packets):
        return None
    packet = packets[index] if isinstance(packets[index], dict) else {}
    return Metadata(_text(packet.get("dc:rights")), _text(packet.get("dcterms:provenance"))) or None


def _extended(holder: Any, content: Mapping[str, Any]) -> dict[str, Any]:
    """An object of the JSON with this as its extension."""
    known = dict(holder) if isinstance(holder, dict) else {}
    others = known.get("extensions")
    return known | {"extensions": (others if isinstance(others, dict) else {}) | {EXTENSION: content}}


def _extension(holder: Any) -> Mapping[str, Any]:
    """The extension of an object of the JSON; empty where there is none."""
    for key in ("extensions", EXTENSION):
        holder = holder.get(key) if isinstance(holder, dict) else None
    return holder if isinstance(holder, dict) else {}


def _text(value: Any) -> str:
    """A text, the first of its languages where it has several, or the first of a list."""
    for _ in range(3):  # a list in an object, of objects
        if isinstance(value, dict):
            value = value.get("rdf:_1", value.get("@list", value.get("@set", value.get("@value"))))
        elif isinstance(value, list):
            value = value[0] if value else None
    if not isinstance(value, str):
        return ""
    return "".join(letter if letter.isprintable() else "?" for letter in value[:MOST_CHARACTERS])
