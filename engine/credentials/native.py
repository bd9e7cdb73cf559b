"""The library c2pa: calls of it, and what is kept of its results. An optional dependency, loaded on demand."""

from __future__ import annotations

import json
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

from engine.errors import InputError
from engine.numerics.plain import Json

SETTINGS: Json = {
    # A manifest may name addresses; none is contacted, so reading it stays private.
    "verify": {"remote_manifest_fetch": False, "ocsp_fetch": False, "verify_trust": True},
    "builder": {"thumbnail": {"enabled": False}},
}
MISSING = "Content Credentials need the library c2pa: pip install 'mark3dgs[c2pa]'"
MOST_ENTRIES = 16
"""Entries of a list in a manifest that are kept."""
MOST_CHARACTERS = 200


def require() -> None:
    """InputError that says how to get the library, where it is not installed; nothing of it is loaded."""
    if find_spec("c2pa") is None:
        raise InputError(MISSING)


def load() -> ModuleType:
    """The library; InputError as `require`."""
    try:
        return import_module("c2pa")
    except (ImportError, OSError, RuntimeError) as error:  # its native half may be missing, or not for this machine
        raise InputError(f"{MISSING} ({type(error).__name__})") from None


def parse(model: Path, media_type: str, store: bytes, anchors: str = "") -> Json:
    """What a manifest store says of a model, and whether that holds.

    Native code reads what may be hostile: see `engine.credentials.reading`. `anchors` are certificates (PEM) whose
    signers count as trusted. InputError if it is no manifest store.

    Returns `state` (Invalid, Valid or Trusted), `failures` (codes of C2PA), `id` and `generator` of the active
    manifest, `signer`, `issuer`, `algorithm` and `signed_at` (a time stamp's, else ""), `actions`, `bindings` ([alg,
    value]).
    """
    c2pa = load()
    settings = SETTINGS | ({"trust": {"user_anchors": anchors}} if anchors else {})
    try:
        with (
            c2pa.Context.from_dict(settings) as context,
            model.open("rb") as opened,
            c2pa.Reader(media_type, opened, store, context) as reader,
        ):
            return _told(json.loads(reader.json()))
    except c2pa.C2paError as error:
        raise InputError(f"the manifest cannot be read: {_plain(str(error))}") from None


def _told(found: Json) -> Json:
    name = found.get("active_manifest") or ""
    manifest = found.get("manifests", {}).get(name, {})
    signature = manifest.get("signature_info") or {}
    failures = (found.get("validation_results") or {}).get("activeManifest", {}).get("failure") or []
    assertions = [(str(each.get("label")), each.get("data")) for each in manifest.get("assertions") or []]
    actions = [a for label, data in assertions if label.startswith("c2pa.actions") for a in _rows(data, "actions")]
    bindings = [
        [data.get("alg"), block.get("value")]
        for label, data in assertions
        if label.startswith("c2pa.soft-binding") and isinstance(data, dict)
        for block in _rows(data, "blocks")
    ]
    kept = {
        "state": found.get("validation_state") or "Invalid",
        "failures": [each.get("code") for each in failures],
        "id": name,
        "generator": " ".join(
            str(part)
            for each in (manifest.get("claim_generator_info") or [])[:1]
            for part in (each.get("name"), each.get("version"))
            if part
        ),
        "signer": signature.get("common_name"),
        "issuer": signature.get("issuer"),
        "algorithm": signature.get("alg"),
        "signed_at": signature.get("time"),
        "actions": [each.get("action") for each in actions],
        "bindings": bindings,
    }
    return {key: _plain(value) for key, value in kept.items()}


def _rows(data: Any, name: str) -> list[Json]:
    rows = data.get(name) if isinstance(data, dict) else None
    return [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []


def _plain(value: Any) -> Any:
    """A value as text that harms no terminal, shortened; lists as lists of such."""
    if isinstance(value, list):
        return [_plain(each) for each in value[:MOST_ENTRIES]]
    text = "" if value is None else str(value)
    return "".join(c if c.isprintable() else "?" for c in text[:MOST_CHARACTERS])
