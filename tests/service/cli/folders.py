"""What is done to data folders, and by whom."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from service.core import Service
from service.db.schema import uploads
from service.settings import Settings

UPLOAD = {"tenant": "acme", "created_at": "now", "name": "", "parts": "[]", "received": 5, "size": 5}


def put(folder: Path, name: str, content: bytes) -> Path:
    """A finished upload in a data folder; where its file lies."""
    service = Service.open(Settings(data_dir=folder))
    with service.blobs.new_file() as path:
        path.write_bytes(content)
        digest = service.blobs.put(path)
    with service.db.write() as connection:
        connection.execute(uploads.insert().values(UPLOAD | {"id": name, "state": "complete", "sha256": digest}))
    service.close()
    return folder / "blobs" / "blob" / digest[:2] / digest


def interrupting(real: Callable[..., Any], at: int) -> Callable[..., Any]:
    """A function that gets Ctrl-C during its call of this number."""
    calls: list[None] = []

    def call(*arguments: Any) -> Any:
        calls.append(None)
        if len(calls) == at:
            raise KeyboardInterrupt
        return real(*arguments)

    return call
