"""A manifest of a marked model, signed: in the model where its format has a place for it, else for a sidecar file."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, BinaryIO

from engine.credentials.manifest import EMBEDS, describe, embedded_manifest, model_type
from engine.credentials.native import SETTINGS, load, parse
from engine.credentials.signer import Signer
from engine.errors import InputError
from engine.numerics.plain import Json

if TYPE_CHECKING:
    from types import ModuleType


@dataclass(frozen=True)
class Manifest:
    """A signed manifest store."""

    id: str  # of the active manifest: urn:c2pa:...
    store: bytes


def sign_into(source: Path, target: Path, record_id: str, signer: Signer) -> Manifest:
    """Write `target`: a copy of `source`, a marked .sog file that holds no manifest yet, with one in it that names the
    record of its mark.

    InputError if the source is no .sog file or holds a manifest already, or the certificate is not one that C2PA
    takes, or c2pa is not installed.
    """
    data = source.read_bytes()
    if not data.startswith(b"PK"):
        raise InputError(f"{str(source)!r} is no .{EMBEDS} file")
    if embedded_manifest(data, str(source)) is not None:
        raise InputError(f"{str(source)!r} holds a manifest already: another would replace it")
    with target.open("w+b") as out:
        store = _sign(io.BytesIO(data), out, EMBEDS, describe(record_id), signer, embed=True)
    return _checked(target, EMBEDS, store)


def sign_sidecar(source: Path, kind: str, record_id: str, signer: Signer, manifest_id: str = "") -> Manifest:
    """The manifest of a model of any format but .sog, for a sidecar file (same name, ending .c2pa).

    `manifest_id` is given where the model names it already. InputError as `sign_into`.
    """
    with source.open("rb") as opened, TemporaryFile() as copy:  # c2pa writes the model once more, unchanged
        store = _sign(opened, copy, kind, describe(record_id, manifest_id), signer, embed=False)
    return _checked(source, kind, store)


def _sign(source: BinaryIO, out: BinaryIO, kind: str, said: Json, signer: Signer, *, embed: bool) -> bytes:
    c2pa = load()
    try:
        with _signer(c2pa, signer) as by, c2pa.Context.from_dict(SETTINGS) as context:
            builder = c2pa.Builder(json.dumps(said), context)
            if not embed:
                builder.set_no_embed()
            store: bytes = builder.sign(by, model_type(kind), source, out)
            return store
    except c2pa.C2paError as error:
        raise InputError(f"signing failed: {error}") from None


def _signer(c2pa: ModuleType, signer: Signer) -> Any:
    info = c2pa.C2paSignerInfo(signer.algorithm, signer.chain, signer.key, None)
    return c2pa.Signer.from_info(info)


def _checked(model: Path, kind: str, store: bytes) -> Manifest:
    """The manifest, read again as others will: nothing is delivered that they would find invalid."""
    found = parse(model, model_type(kind), store)
    if found["state"] == "Invalid" or not found["id"]:
        raise InputError(f"what was signed does not hold: {', '.join(found['failures'])}")
    return Manifest(found["id"], store)
