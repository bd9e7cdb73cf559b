"""A pytest plugin: keeps every input that the readers refuse, so that the service can be fed the same.

`python -m pytest tests/formats -p tests.service.refused_inputs` with MARK3DGS_REFUSED_DIR set.
"""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from engine.errors import FormatError
from engine.formats import model_reading as reading
from engine.formats.gltf import scene as gltf
from engine.formats.kinds import ksplat, splat
from engine.formats.ply import compressed as compressed_ply
from engine.formats.ply import gaussians as ply
from engine.formats.sog import bundle as sog
from engine.formats.spz import stream as spz

MOST_BYTES = 64 << 20


def pytest_configure() -> None:
    """Wrap the readers before any test takes hold of them."""
    folder = Path(os.environ["MARK3DGS_REFUSED_DIR"])

    def wrapped(read: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(read)
        def recording(data: Any, *arguments: Any, **named: Any) -> Any:
            try:
                return read(data, *arguments, **named)
            except FormatError:
                if isinstance(data, (bytes, bytearray)) and 0 < len(data) <= MOST_BYTES:
                    (folder / hashlib.sha256(data).hexdigest()).write_bytes(data)
                raise

        return recording

    for module, name in (
        (ply, "read_ply"),
        (compressed_ply, "read_compressed_ply"),
        (splat, "read_splat"),
        (spz, "read_spz"),
        (sog, "read_sog"),
        (gltf, "read_gltf"),
        (ksplat, "read_ksplat"),
        (reading, "_decode"),
    ):
        setattr(module, name, wrapped(getattr(module, name)))
