"""Task `convert`: a model in another format."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from engine.cli.models import loss_note
from engine.formats import encode_model
from service.work.inputs import load_model
from service.work.process import Progress


def convert_model(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """Contract: docs/SERVICE.md."""
    kind = request["format"]
    progress("read", 0.0)
    model = load_model(request).model
    progress("write", 0.5)
    name = f"model.{kind}"
    (folder / name).write_bytes(encode_model(model, kind))
    return {"format": kind, "notes": loss_note(model, kind), "files": {"model": name}}
