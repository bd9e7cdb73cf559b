"""What a model's manifest says, read in a process of its own with limits: the file may be hostile.

Our own bounded readers find the manifest and refuse a large one, before native code sees any of it. What the process
does, a crash included, leaves the reader of the model alone.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from engine.credentials.manifest import (
    ALG,
    EMBEDS,
    SIDECAR,
    bound_record,
    embedded_manifest,
    model_type,
    sidecar_manifest,
)
from engine.credentials.process import SECONDS
from engine.errors import InputError
from engine.numerics.plain import Json

_COMMAND = (sys.executable, "-P", "-m", "engine.credentials.process")
"""-P: the folder that one stands in may be anybody's, too; no module is taken from there."""


@dataclass(frozen=True)
class Credentials:
    """A manifest as it was found. `state` is C2PA's validation state, or Unread with the `reason`."""

    place: str  # embedded, or the name of the sidecar file
    state: str  # Invalid: altered, or not of this file. Valid: holds. Trusted: and the signer is one you trust. Unread
    reason: str = ""
    failures: tuple[str, ...] = ()  # codes of C2PA; signingCredential.untrusted where no trusted authority vouches
    id: str = ""
    generator: str = ""
    signer: str = ""
    issuer: str = ""
    algorithm: str = ""
    signed_at: str = ""  # as a time stamp says; empty without one
    actions: tuple[str, ...] = ()
    bindings: tuple[tuple[str, str], ...] = ()  # soft bindings: algorithm, value

    @property
    def record_ids(self) -> list[str]:
        """Records of ours that the manifest names: its signer's statement, no evidence."""
        found = (bound_record(value) for alg, value in self.bindings if alg == ALG)
        return [record for record in found if record]

    def to_json(self) -> Json:
        """Plain values."""
        return asdict(self) | {"record_ids": self.record_ids}


def read_credentials(path: Path, kind: str, anchors: str = "") -> Credentials | None:
    """The manifest in a model file, else in its sidecar; None where there is none. Never raises for its sake.

    Parameters
    ----------
    path : Path
        Model that was read already; a folder has no manifest.
    kind : str
        Its format.
    anchors : str
        Certificates (PEM) whose signers count as trusted.
    """
    if not path.is_file():
        return None
    place = "embedded"
    try:
        store = embedded_manifest(path.read_bytes(), str(path)) if kind == EMBEDS else None
        if store is None:
            place = path.with_suffix(SIDECAR).name
            store = sidecar_manifest(path)
        if store is None:
            return None
        found = _ask({"model": str(path), "media_type": model_type(kind), "store": store.hex(), "anchors": anchors})
    except (InputError, OSError) as error:
        return Credentials(place, "Unread", " ".join(str(error).split()))
    if "reason" in found:
        return Credentials(place, "Unread", found["reason"])
    lists: Json = {name: tuple(found.pop(name)) for name in ("failures", "actions")}
    bindings = tuple((alg, value) for alg, value in found.pop("bindings"))
    return Credentials(place, bindings=bindings, **lists, **found)


def _ask(request: dict[str, str]) -> Json:
    """The answer of the process; InputError where it gave none."""
    try:
        done = subprocess.run(
            _COMMAND, input=json.dumps(request).encode(), capture_output=True, timeout=SECONDS, check=False
        )
        answer = json.loads(done.stdout)
        if isinstance(answer, dict):
            return answer
    except (subprocess.TimeoutExpired, ValueError):
        pass
    raise InputError("the manifest was not read within its limits of time and memory")
