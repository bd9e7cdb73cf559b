"""Mark3DGS: ownership watermarks for 3D Gaussian Splatting models.

The names below are the whole job in Python, from a file to a claim (docs/API.md). Each is loaded when it is first
asked for, so that importing the package costs nothing. How it is built: docs/DESIGN.md.
"""

import importlib as _importlib
import typing as _typing

if _typing.TYPE_CHECKING:
    from engine.errors import Mark3DGSError
    from engine.formats import read_cameras, read_model, write_cameras, write_model
    from engine.model import Camera, GaussianModel
    from engine.pipeline.embedding import embed, embed_copies
    from engine.pipeline.profiles import profile
    from engine.pipeline.rigs import make_rig
    from engine.pipeline.sealing import open_record
    from engine.pipeline.tracing import trace_images, trace_model
    from engine.pipeline.verification import VerifyConfig, verify_images, verify_model
    from engine.raster import render
    from engine.records.record import Record
    from engine.watermark.keys import OwnerKey

__all__ = [
    "Camera",
    "GaussianModel",
    "Mark3DGSError",
    "OwnerKey",
    "Record",
    "VerifyConfig",
    "embed",
    "embed_copies",
    "make_rig",
    "open_record",
    "profile",
    "read_cameras",
    "read_model",
    "render",
    "trace_images",
    "trace_model",
    "verify_images",
    "verify_model",
    "write_cameras",
    "write_model",
]

_HOMES = {
    "engine.errors": ("Mark3DGSError",),
    "engine.formats": ("read_cameras", "read_model", "write_cameras", "write_model"),
    "engine.model": ("Camera", "GaussianModel"),
    "engine.pipeline.embedding": ("embed", "embed_copies"),
    "engine.pipeline.profiles": ("profile",),
    "engine.pipeline.rigs": ("make_rig",),
    "engine.pipeline.sealing": ("open_record",),
    "engine.pipeline.tracing": ("trace_images", "trace_model"),
    "engine.pipeline.verification": ("VerifyConfig", "verify_images", "verify_model"),
    "engine.raster": ("render",),
    "engine.records.record": ("Record",),
    "engine.watermark.keys": ("OwnerKey",),
}
"""Where each name lives: what type checkers read above, for the interpreter (PEP 562)."""


def __getattr__(name: str) -> object:
    for home, names in _HOMES.items():
        if name in names:
            return getattr(_importlib.import_module(home), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
