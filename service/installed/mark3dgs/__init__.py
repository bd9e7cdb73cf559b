"""Mark3DGS: ownership watermarks for 3D Gaussian Splatting models.

The names below are the public API, the whole job from a file to a claim (docs/API.md). Each is loaded when it is first
used, so that the import costs nothing. `mark3dgs.client` talks to a service and needs httpx alone. How it is built:
docs/DESIGN.md.
"""

import importlib as _importlib
import typing as _typing

if _typing.TYPE_CHECKING:
    from engine.errors import Mark3DGSError
    from engine.flows.embed.embedding import embed, embed_copies
    from engine.flows.embed.profiles import profile
    from engine.flows.records.opened_record import open_record
    from engine.flows.trace.tracing import trace_images, trace_model
    from engine.flows.verify.search import VerifyConfig, verify_images, verify_model
    from engine.flows.views.camera_rig import make_rig
    from engine.formats import read_cameras, read_model, write_cameras, write_model
    from engine.model import Camera, GaussianModel
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
    "engine.flows.embed.embedding": ("embed", "embed_copies"),
    "engine.flows.embed.profiles": ("profile",),
    "engine.flows.views.camera_rig": ("make_rig",),
    "engine.flows.records.opened_record": ("open_record",),
    "engine.flows.trace.tracing": ("trace_images", "trace_model"),
    "engine.flows.verify.search": ("VerifyConfig", "verify_images", "verify_model"),
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
