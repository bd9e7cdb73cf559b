"""What a manifest of ours says, and where one lies: in the ZIP of a .sog, or in a sidecar file of any other model.

C2PA Technical Specification 2.4: 18.10 (soft binding), 18.15 (actions), 11.4 (external manifests), A.6 (ZIP). It has
no place for a manifest in a GLB, a PLY, a .splat or an SPZ; a chunk of a GLB is a working draft, so these get a file.
"""

import base64
import binascii
from importlib.metadata import version
from pathlib import Path

from engine.errors import InputError
from engine.formats.sog.archive import ZipArchive
from engine.numerics.plain import Json

ALG = "io.github.mark3dgs.1"
"""Our algorithm's name for a soft binding, by the rules of the Soft Binding Algorithm List, on which it does not stand.

Its value is the record's id, 16 bytes in base64 (which c2pa writes as text, where the standard has a byte string): a
keyed hash, from which nothing follows. Only with the record can the mark be read (extraction is informed), and so the
id: it cannot be extracted from a model alone.
"""

EMBEDS = "sog"
"""The format that takes a manifest up."""
EMBEDDED = "META-INF/content_credential.c2pa"
SIDECAR = ".c2pa"
MEDIA_TYPE = "application/c2pa"
MOST_BYTES = 1 << 20
"""Of a manifest store that is looked at; one of ours has 4 kB."""

_MODEL_TYPES = {"sog": "application/x-zip", "glb": "model/gltf-binary"}
_PARENT = "unmarked"


def model_type(kind: str) -> str:
    """Media type of a model file; most formats have none of their own."""
    return _MODEL_TYPES.get(kind, "application/octet-stream")


def binding_value(record_id: str) -> str:
    """Value of the soft binding of a record (its id, 32 hexadecimal digits)."""
    return base64.b64encode(bytes.fromhex(record_id)).decode()


def bound_record(value: str) -> str:
    """Id of the record that a value stands for; "" if it is none. Both alphabets of base64 are read: it stands in
    addresses."""
    try:
        found = base64.b64decode(value.translate(_STANDARD).rstrip("=") + "==", validate=True)
    except (binascii.Error, ValueError):
        return ""
    return found.hex() if len(found) == 16 else ""


_STANDARD = str.maketrans("-_ ", "+/+")  # an unescaped plus sign comes out of an address as a space


def describe(record_id: str, manifest_id: str = "") -> Json:
    """Definition of a manifest, as c2pa's builder takes it: an unmarked model was opened, and marked.

    Nothing of recipient, label or original is in it. `manifest_id` ("urn:c2pa:" and a UUID) is drawn where it is "".
    """
    agent = {"name": "Mark3DGS", "version": version("mark3dgs")}
    block = {"scope": {}, "value": binding_value(record_id)}
    label = {"label": manifest_id} if manifest_id else {}
    return label | {
        "claim_version": 2,
        "claim_generator_info": [agent],
        "ingredients": [
            {
                "title": "unmarked model",
                "format": "application/octet-stream",
                "relationship": "parentOf",
                "label": _PARENT,
            }
        ],
        "assertions": [
            {
                "label": "c2pa.actions.v2",
                "data": {
                    "actions": [
                        {"action": "c2pa.opened", "parameters": {"ingredientIds": [_PARENT]}},
                        {"action": "c2pa.watermarked.bound", "softwareAgent": agent},
                    ]
                },
            },
            {
                "label": "c2pa.soft-binding",
                "data": {
                    "alg": ALG,
                    "name": "Ownership watermark; the owner's record is needed to read it",
                    "blocks": [block],
                },
            },
        ],
    }


def embedded_manifest(data: bytes, file: str) -> bytes | None:
    """The manifest store inside a model file, None where there is none.

    FormatError where it is damaged, or has more than `MOST_BYTES`.
    """
    if not data.startswith(b"PK"):
        return None
    archive = ZipArchive(data, file=file)
    return archive.read(EMBEDDED, MOST_BYTES) if archive.has(EMBEDDED) else None


def sidecar_manifest(model: Path) -> bytes | None:
    """The manifest store in a model's sidecar file: same name, ending .c2pa. InputError if it is too large."""
    path = model.with_suffix(SIDECAR)
    if path == model or not path.is_file():
        return None
    with path.open("rb") as opened:
        found = opened.read(MOST_BYTES + 1)
    if len(found) > MOST_BYTES:
        raise InputError(f"{str(path)!r} has more than {MOST_BYTES:,} bytes: a manifest has a few thousand")
    return found
