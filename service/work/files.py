"""The short tasks: what an upload is, and a model in another format. Contracts: docs/SERVICE.md."""

from dataclasses import asdict
from pathlib import Path

from engine.scenes.scene_files import encode_scene, notes_of, written_as
from service.work.inputs import load_cameras, load_model, picture_sizes
from service.work.process import Progress, Reply, Request


def inspect(request: Request, folder: Path, progress: Progress) -> Reply:
    """What a model file holds."""
    progress("read", 0.0)
    loaded = load_model(request)
    return {
        "sha256": loaded.sha256,
        "format": loaded.format,
        "bytes": loaded.source_bytes,
        "gaussians": len(loaded.model),
        "sh_degree": loaded.model.sh_degree,
        "repairs": [asdict(repair) for repair in loaded.noticed],
    }


def look_at_pictures(request: Request, folder: Path, progress: Progress) -> Reply:
    """Sizes of pictures, as their headers say."""
    progress("read", 0.0)
    return {"pictures": [{"width": width, "height": height} for width, height in picture_sizes(request["pictures"])]}


def look_at_cameras(request: Request, folder: Path, progress: Progress) -> Reply:
    """Number of cameras."""
    progress("read", 0.0)
    return {"cameras": len(load_cameras(request["cameras"]) or [])}


def convert(request: Request, folder: Path, progress: Progress) -> Reply:
    """A model in another format."""
    kind = request["format"]
    progress("read", 0.0)
    loaded = load_model(request)
    written_as(loaded, kind)
    progress("write", 0.5)
    name = f"model.{kind}"
    (folder / name).write_bytes(encode_scene(loaded.scene, kind))
    return {"format": kind, "notes": notes_of(loaded.scene, kind), "files": {"model": name}}
