"""Tasks `picture` and `cameras`: what an upload that is no model is."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.work.inputs import load_cameras, load_pictures
from service.work.process import Progress


def look_at_picture(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """Contract: docs/SERVICE.md."""
    progress("read", 0.0)
    height, width = load_pictures([request["picture"]])[0].shape[:2]
    return {"width": width, "height": height}


def look_at_cameras(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """Contract: docs/SERVICE.md."""
    progress("read", 0.0)
    return {"cameras": len(load_cameras(request["cameras"]) or [])}
