"""Task `inspect`: what an upload is."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from engine.cli.models import repair_entries
from service.work.inputs import load_model
from service.work.process import Progress


def inspect_upload(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """Contract: docs/SERVICE.md."""
    progress("read", 0.0)
    loaded = load_model(request)
    return {
        "sha256": loaded.sha256,
        "format": loaded.format,
        "bytes": loaded.source_bytes,
        "gaussians": len(loaded.model),
        "sh_degree": loaded.model.sh_degree,
        "repairs": repair_entries(loaded.repairs),
    }
