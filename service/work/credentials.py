"""Task `sign`: a model of ours as it is delivered, with its Content Credentials. Contract: docs/SERVICE.md."""

from pathlib import Path
from uuid import uuid4

from engine.credentials.manifest import EMBEDS
from engine.credentials.signer import Signer
from engine.credentials.signing import sign_into, sign_sidecar
from engine.formats.gltf.metadata import Metadata, annotate_glb
from service.work.process import Progress, Reply, Request


def sign_model(request: Request, folder: Path, progress: Progress) -> Reply:
    """The manifest, and the model with it inside where its format takes one up; a .glb with its address, and rights."""
    progress("write", 0.0)
    signer = Signer(request["certificates"].encode(), request["key"].encode())
    model, kind, record_id = Path(request["model"]), request["format"], request["record_id"]
    files = {"manifest": "manifest.c2pa"}
    if kind == EMBEDS:
        files["model"] = f"model.{kind}"
        made = sign_into(model, folder / files["model"], record_id, signer)
    else:
        name, address = f"urn:c2pa:{uuid4()}", request["public_url"]
        metadata = Metadata(request["rights"], f"{address}/v1/manifests/{name}" if address else "")
        if kind == "glb" and metadata:
            files["model"] = f"model.{kind}"
            pieces = annotate_glb(model.read_bytes(), metadata)
            model = folder / files["model"]
            model.write_bytes(b"".join(pieces))
        made = sign_sidecar(model, kind, record_id, signer, name)
    (folder / files["manifest"]).write_bytes(made.store)
    return {"manifest_id": made.id, "files": files}
